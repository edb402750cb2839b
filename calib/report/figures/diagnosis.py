"""Residuals without and with a diagnosed cause."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.findings import Cause
from calib.report.plotting import (
    BLACK,
    Drawing,
    cloud,
    in_house_style,
    label_rows,
    legend,
    new_figure,
    plot_style,
)

BEFORE, AFTER = "base", "axis-offset"
"""Styles of the two."""


@in_house_style
def draw_cause(cause: Cause) -> Drawing:
    """Draw the residual of each row without the cause and with it as a parameter."""
    figure = new_figure(height_in=3.0)
    axes = figure.subplots()
    place = np.arange(len(cause.ids), dtype=float)
    before, after = cause.residual_mrad
    labels = ("model alone", f"with {cause.name}")
    for residual, style, label in zip((before, after), (BEFORE, AFTER), labels, strict=True):
        cloud(axes, place, residual, plot_style(style), label=label)
    axes.axhline(0, color=BLACK, lw=0.8)
    label_rows(axes, cause.ids, what="row")
    axes.set_ylabel("residual / mrad")
    legend(figure, axes)
    return Drawing(
        figure,
        f"Residuals of {len(cause.ids)} rows: root mean square {_rms(before):.2g} mrad by the "
        f"model alone, {_rms(after):.2g} mrad with {cause.name}.",
        {"id": cause.ids, "before_mrad": before, "after_mrad": after},
    )


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual**2)))
