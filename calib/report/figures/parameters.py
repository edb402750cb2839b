"""Estimates of all fits side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.report.plotting import (
    GREY,
    Drawing,
    Margins,
    PlotStyle,
    in_house_style,
    new_figure,
    plot_style,
)
from calib.uncertainty.montecarlo import NORMAL_FACTOR


@dataclass(frozen=True)
class FitEstimate:
    """What one fit says of the two parameters that all fits have.

    Parameters
    ----------
    fit
        ``model/estimator``.
    baseline_mm, delta2_mrad
        Value and standard uncertainty; the baseline as seen at 90 deg, L_b + e.
    """

    fit: str
    baseline_mm: tuple[float, float]
    delta2_mrad: tuple[float, float]


@in_house_style
def draw_estimates(estimates: Sequence[FitEstimate]) -> Drawing:
    """Draw baseline and encoder zero of every fit with 95 % intervals."""
    figure = new_figure(
        height_in=0.75 + 0.28 * len(estimates), margins=Margins(left=1.6, top=0.15, between=0.06)
    )
    panels = figure.subplots(1, 2, sharey=True)
    baseline = np.array([e.baseline_mm for e in estimates])
    delta2 = np.array([e.delta2_mrad for e in estimates])
    names = ("baseline seen at 90° / mm", "encoder zero $δ_2$ / mrad")
    for axes, values, name in zip(panels, (baseline, delta2), names, strict=True):
        for y, (e, (value, u)) in enumerate(zip(estimates, values, strict=True)):
            style = _style(e.fit)
            axes.errorbar(
                value,
                y,
                xerr=NORMAL_FACTOR * u,
                fmt=style.marker,
                color=style.colour,
                capsize=3,
                mfc="white" if e.fit.endswith("/posterior") else style.colour,
            )
        axes.set_xlabel(name)
        axes.grid(visible=False, axis="y")
    panels[0].set_yticks(range(len(estimates)), [e.fit for e in estimates])
    panels[0].set_ylim(len(estimates) - 0.5, -0.5)
    told = "; ".join(
        f"{e.fit} {e.baseline_mm[0]:.2f} mm, {e.delta2_mrad[0]:.2f} mrad" for e in estimates
    )
    return Drawing(
        figure,
        f"Baseline seen at 90 degrees and encoder zero by each fit, with 95 % intervals: {told}.",
        {
            "fit": [e.fit for e in estimates],
            "baseline_mm": baseline[:, 0],
            "u_baseline_mm": baseline[:, 1],
            "delta2_mrad": delta2[:, 0],
            "u_delta2_mrad": delta2[:, 1],
        },
    )


def _style(fit: str) -> PlotStyle:
    model, _, estimator = fit.partition("/")
    return plot_style(model) if estimator in ("robust", "posterior") else PlotStyle(GREY, "d")
