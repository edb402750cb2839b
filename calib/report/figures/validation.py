"""What the instrument measures on rows that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from calib.instrument.validation import ValidationResult
from calib.report.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILLION,
    Column,
    Drawing,
    Margins,
    PlotStyle,
    cloud,
    in_house_style,
    label_rows,
    legend,
    new_figure,
    plain,
    plot_style,
)

REFERENCES = (
    PlotStyle(BLUE, "o"),
    PlotStyle(VERMILLION, "s"),
    PlotStyle(GREEN, "^"),
    PlotStyle(PURPLE, "D"),
)

MOST_BARS = 200
"""Rows beyond which intervals would run into each other."""


@in_house_style
def draw_agreement(validation: ValidationResult, names: Mapping[str, str]) -> Drawing:
    """Draw (measured - reference) / reference of each row, against each reference.

    Parameters
    ----------
    names
        What to call each reference, by its name in the results.
    """
    figure = new_figure(height_in=3.5, margins=Margins(bottom=0.75))
    axes = figure.subplots()
    v, place = validation, np.arange(len(validation.ids))
    data: dict[str, Column] = {"id": v.ids, "group": v.groups, "z_mm": v.prediction.z_mm}
    for k, agreement in enumerate(v.errors):
        style = REFERENCES[k % len(REFERENCES)]
        x = place + 0.24 * (k - (len(v.errors) - 1) / 2)
        ends = np.stack([v.prediction.low95_mm, v.prediction.high95_mm]) / agreement.reference_mm
        known = np.isfinite(ends).all(axis=0)
        if len(place) <= MOST_BARS:
            low, high = 100 * (ends[:, known] - 1)
            axes.vlines(x[known], low, high, color=style.colour, lw=1)
        name = names.get(agreement.name, agreement.name)
        label = f"against {plain(name, agreement.name)}"
        cloud(axes, x, 100 * agreement.error_rel, style, label=label)
        data[f"reference_{agreement.name}_mm"] = agreement.reference_mm
        data[f"error_against_{agreement.name}_percent"] = 100 * agreement.error_rel
    axes.axhline(0, color=BLACK, lw=0.8)
    _divide(axes, v.groups)
    label_rows(axes, v.ids, what="validation row")
    axes.set_ylabel("(measured − reference) / %")
    legend(figure, axes)
    told = "; against ".join(
        f"{names.get(e.name, e.name)} the root mean square is {100 * e.rms_rel:.2g} % and the mean "
        f"{100 * e.mean_rel:+.2g} %"
        for e in v.errors
    )
    return Drawing(figure, f"Errors of {len(place)} measured depths: against {told}.", data)


@in_house_style
def draw_consistency(validation: ValidationResult, models: Sequence[str]) -> Drawing:
    """Draw depth by each row's own angle less its reference, for each model."""
    figure = new_figure(height_in=3.3, margins=Margins(bottom=0.75))
    axes = figure.subplots()
    v, place = validation, np.arange(len(validation.ids))
    data: dict[str, Column] = {"id": v.ids, "group": v.groups, "reference_mm": v.reference_mm}
    spans = []
    for k, model in enumerate(models):
        error = v.own_depth_mm[model] - v.reference_mm
        cloud(
            axes, place + 0.24 * (k - (len(models) - 1) / 2), error, plot_style(model), label=model
        )
        data[f"{model}_own_depth_mm"] = v.own_depth_mm[model]
        spans.append(f"{model} from {np.nanmin(error):+.1f} to {np.nanmax(error):+.1f} mm")
    axes.axhline(0, color=BLACK, lw=0.8)
    _divide(axes, v.groups)
    label_rows(axes, v.ids, what="validation row")
    axes.set_ylabel("(depth by own angle − reference) / mm")
    legend(figure, axes)
    return Drawing(
        figure, f"Depth by each row's own angle less its reference: {'; '.join(spans)}.", data
    )


def _divide(axes: Axes, groups: Sequence[str]) -> None:
    """Draw a line between neighbouring groups of more than one row."""
    if len(set(groups)) == len(groups):
        return
    for i in range(1, len(groups)):
        if groups[i] != groups[i - 1]:
            axes.axvline(i - 0.5, color=GREY, lw=0.8, ls=":")
