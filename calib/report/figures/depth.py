"""Depth uncertainty over the range."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from calib.core.arrays import FloatArray
from calib.instrument.calibrated import DepthTable
from calib.report.plotting import (
    BLUE,
    GREY,
    LIGHT,
    SKY,
    VERMILLION,
    Drawing,
    in_house_style,
    legend,
    new_figure,
)
from calib.uncertainty.montecarlo import NORMAL_FACTOR

WIDEST = 100.0
"""Half-widths beyond 100 % of the depth are drawn at it: the depth is not known at all."""


@in_house_style
def draw_depth_uncertainty(table: DepthTable, calibrated_mm: FloatArray) -> Drawing:
    """Draw the 95 % interval of a depth, in per cent, with the linear law beside it."""
    figure = new_figure(height_in=3.4)
    axes = figure.subplots()
    z, p = table.depth_mm, table.prediction
    low, high = (100 * (x / z - 1) for x in (p.low95_mm, p.high95_mm))
    linear = 100 * NORMAL_FACTOR * p.gum_u_mm / z
    drawn = np.clip(np.nan_to_num(high, posinf=np.inf), None, WIDEST)
    axes.fill_between(z, np.maximum(low, -WIDEST), drawn, color=SKY, alpha=0.35, lw=0)
    axes.plot(z, np.maximum(low, -WIDEST), color=BLUE)
    axes.plot(z, drawn, color=BLUE, label="95 % interval, posterior predictive")
    for sign in (-1, 1):
        axes.plot(
            z,
            sign * np.minimum(linear, WIDEST),
            color=VERMILLION,
            ls="--",
            label="±1.96 u, linear law" if sign > 0 else None,
        )
    axes.axhline(0, color=GREY, lw=0.8)
    _mark_extrapolated(axes, z, calibrated_mm)
    axes.set(xlabel="depth z / mm", ylabel="(measured depth − z) / % of z", xlim=(z[0], z[-1]))
    legend(figure, axes)
    return Drawing(
        figure,
        f"95 % interval of a measured depth: {low[0]:+.2g} to {high[0]:+.2g} % at {z[0]:.0f} mm, "
        f"{low[-1]:+.2g} to {high[-1]:+.2g} % at {z[-1]:.0f} mm; the linear law gives "
        f"±{linear[0]:.2g} % and ±{linear[-1]:.2g} %. Calibrated from {calibrated_mm[0]:.0f} to "
        f"{calibrated_mm[1]:.0f} mm.",
        {
            "z_mm": z,
            "u_mm": p.u_mm,
            "low95_mm": p.low95_mm,
            "high95_mm": p.high95_mm,
            "gum_u_mm": p.gum_u_mm,
            "gum_valid": p.gum_valid.astype(int),
            "extrapolated": table.extrapolated.astype(int),
        },
    )


def _mark_extrapolated(axes: Axes, z: FloatArray, calibrated_mm: FloatArray) -> None:
    """Hatch the depths outside those of the calibration rows."""
    named = False
    for left, right in ((z[0], calibrated_mm[0]), (calibrated_mm[1], z[-1])):
        if right > left:
            axes.axvspan(
                left,
                right,
                fc="none",
                ec=LIGHT,
                hatch="///",
                lw=0,
                zorder=0,
                label=None if named else "extrapolated",
            )
            named = True
