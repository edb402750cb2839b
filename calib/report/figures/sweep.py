"""The yaw sweep: residuals, readings, and where the axis stands in C2's frame."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.images.sweep.yaw_axis import SweepResult
from calib.report.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    Drawing,
    Margins,
    PlotStyle,
    cloud,
    from_zero,
    in_house_style,
    new_figure,
)


@in_house_style
def draw_sweep(sweep: SweepResult) -> Drawing:
    """Draw the residual of each image and the error of each reading against the reading."""
    figure = new_figure(height_in=2.9)
    left, right = figure.subplots(1, 2)
    degrees = np.rad2deg(sweep.readings_rad)
    rms = np.sqrt(np.nanmean(sweep.residuals.reshape(len(degrees), -1) ** 2, axis=1))
    style = PlotStyle(BLUE, "o")
    cloud(left, degrees, rms, style)
    left.axhline(sweep.rms_px, color=GREY, lw=1, ls="--")
    left.set(xlabel="α2 / °", ylabel="rms residual / px")
    from_zero(left)
    cloud(right, degrees, 1e3 * sweep.reading_errors_rad, style)
    right.axhline(0, color=BLACK, lw=0.8)
    right.set(xlabel="α2 / °", ylabel="error of the reading / mrad")
    errors = 1e3 * sweep.reading_errors_rad
    return Drawing(
        figure,
        f"{len(degrees)} images of the sweep at readings from {degrees.min():.1f} to "
        f"{degrees.max():.1f} degrees: residuals of {sweep.rms_px:.3f} px root mean square; errors "
        f"of the readings from {errors.min():+.2f} to {errors.max():+.2f} mrad.",
        {
            "image": sweep.images,
            "alpha2_rad": sweep.readings_rad,
            "rms_px": rms,
            "reading_error_rad": sweep.reading_errors_rad,
        },
    )


@in_house_style
def draw_axis(sweep: SweepResult) -> Drawing:
    """Draw the foot of the yaw axis in C2's frame, from above, with its 95 % region."""
    figure = new_figure(height_in=3.4, margins=Margins(top=0.15, right=2.2))
    axes = figure.subplots()
    x, _, z = sweep.axis_foot_c2_mm
    block = sweep.axis_covariance[2:, 2:]
    ring = _ellipse(block) + np.array([x, z])
    axes.axvline(0, color=BLUE, label="gaze plane")
    axes.plot([0, x], [z, z], color=GREEN, lw=2, label="e")
    axes.plot(*ring.T, color=BLACK, lw=1, ls="--", label="95 % region")
    axes.plot(x, z, "o", color=BLACK, label="yaw axis")
    axes.plot(0, 0, "^", color=BLACK, mfc="white", ms=9, label="C2's centre")
    axes.set(xlabel="X of C2 / mm", ylabel="Z of C2 / mm", aspect="equal", adjustable="datalim")
    axes.margins(0.25)
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
    e, u = sweep.eccentricity_mm, sweep.eccentricity_std_mm
    return Drawing(
        figure,
        f"The yaw axis in C2's frame, from above: it passes C2's centre at X = {x:.2f} mm, "
        f"Z = {z:.2f} mm; the gaze plane misses it by e = {e:.2f} mm with a standard uncertainty "
        f"of {u:.2f} mm.",
        {"x_mm": [x], "z_mm": [z], "u_x_mm": [block[0, 0] ** 0.5], "u_z_mm": [block[1, 1] ** 0.5]},
    )


CHI2_95 = 5.991464547107979
"""0.95 quantile of chi squared with 2 degrees of freedom."""


def _ellipse(covariance: FloatArray) -> FloatArray:
    """Return the outline of the 95 % region of a point, shape (n, 2)."""
    value, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    outline: FloatArray = circle * np.sqrt(CHI2_95 * np.maximum(value, 0)) @ vectors.T
    return outline
