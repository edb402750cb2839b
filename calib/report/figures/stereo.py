"""The stereo reference: residuals of the pairs, and the targets' depths checked."""

from __future__ import annotations

import numpy as np

from calib.images.stereo.reference import StereoReference
from calib.report.plotting import (
    BLACK,
    BLUE,
    GREEN,
    VERMILLION,
    Column,
    Drawing,
    Margins,
    PlotStyle,
    from_zero,
    in_house_style,
    label_rows,
    legend,
    new_figure,
)
from calib.uncertainty.montecarlo import NORMAL_FACTOR

_STYLES = (
    PlotStyle(BLUE, "o"),
    PlotStyle(VERMILLION, "s"),
    PlotStyle(BLACK, "v"),
    PlotStyle(GREEN, "D"),
)


@in_house_style
def draw_pairs(stereo: StereoReference) -> Drawing:
    """Draw the residual of each pair in both cameras, by each solve."""
    figure = new_figure(height_in=2.9, margins=Margins(bottom=0.75))
    axes = figure.subplots()
    place = np.arange(len(stereo.stems))
    data: dict[str, Column] = {"pair": stereo.stems}
    for k, solve in enumerate(stereo.solves):
        style, name = _STYLES[k % len(_STYLES)], f"{solve.backend}, lenses {solve.intrinsics}"
        for camera, rms in zip(("C1", "C2"), _rms(solve.residuals), strict=True):
            axes.plot(
                place + 0.16 * (k - (len(stereo.solves) - 1) / 2),
                rms,
                linestyle="none",
                marker=style.marker,
                color=style.colour,
                mfc=style.colour if camera == "C1" else "white",
                label=name if camera == "C1" else None,
            )
            data[f"{solve.backend}_{solve.intrinsics}_{camera}_rms_px"] = rms
    label_rows(axes, stereo.stems, what="pair")
    axes.set_ylabel("rms residual / px (hollow: C2)")
    from_zero(axes)
    legend(figure, axes)
    told = "; ".join(
        f"{s.backend}, lenses {s.intrinsics}, {s.rms_px:.3f} px" for s in stereo.solves
    )
    return Drawing(figure, f"Root mean square residual of {len(place)} stereo pairs: {told}.", data)


def _rms(residuals: np.ndarray) -> np.ndarray:
    """Return the root mean square per camera and pair, shape (2, pairs)."""
    known = np.isfinite(residuals)
    count = known.sum(axis=(2, 3))
    total = np.where(known, residuals, 0.0) ** 2
    rms: np.ndarray = np.sqrt(total.sum(axis=(2, 3)) / np.where(count > 0, count, np.nan))
    return rms


@in_house_style
def draw_targets(stereo: StereoReference) -> Drawing:
    """Draw depth by the board's pose in C1 alone less triangulated depth, against depth."""
    figure = new_figure(height_in=2.9)
    axes = figure.subplots()
    t = stereo.targets
    z, by_board = t.triangulated.position_mm[:, 2], t.by_board.position_mm[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.abs((by_board - z) / t.board_sigmas)
    bar = np.where(np.isfinite(u), NORMAL_FACTOR * u, 0.0)
    axes.errorbar(z, by_board - z, yerr=bar, fmt="o", color=BLUE, capsize=2, elinewidth=1)
    order = np.argsort(z)
    for sign in (-1, 1):
        axes.plot(
            z[order],
            sign * NORMAL_FACTOR * t.depth_std_mm[order],
            color=VERMILLION,
            ls="--",
            label="±1.96 u of the triangulated depth" if sign > 0 else None,
        )
    axes.axhline(0, color=BLACK, lw=0.8)
    axes.set(xlabel="triangulated depth / mm", ylabel="(by board − triangulated) / mm")
    legend(figure, axes)
    return Drawing(
        figure,
        f"Depth of {len(z)} targets by the board's pose in C1 less their triangulated depth: from "
        f"{np.min(by_board - z):+.2f} to {np.max(by_board - z):+.2f} mm, at most "
        f"{np.max(np.abs(t.board_sigmas)):.1f} standard deviations.",
        {
            "pair": t.stems,
            "z_triangulated_mm": z,
            "u_mm": t.depth_std_mm,
            "z_by_board_mm": by_board,
            "difference_in_standard_deviations": t.board_sigmas,
        },
    )
