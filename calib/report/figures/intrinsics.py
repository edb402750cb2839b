"""Intrinsics of one camera: coverage, uncertainty, differences, residuals, cross-validation."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.ticker import MaxNLocator

from calib.core.arrays import BoolArray, FloatArray
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.intrinsics.maps import LensDifference
from calib.report.figures.maps import draw_arrows, draw_field, draw_map, imager, map_figure
from calib.report.plotting import (
    BLACK,
    BLUE,
    MANY_POINTS,
    Drawing,
    Margins,
    from_zero,
    in_house_style,
    legend,
    new_figure,
    plot_style,
    thinned,
)

CLOUD = Margins(left=0.58, right=0.3, top=0.3, between=0.25)

ARROWS = 400
"""Residual arrows drawn at most; more make a carpet."""

ARROW_SHARE = 0.03
"""Share of the imager's width that an arrow of the root mean square length takes."""


@in_house_style
def draw_coverage(i: Intrinsics, corners: FloatArray) -> Drawing:
    """Draw where corners were, and how uncertain the projection is over the imager.

    Parameters
    ----------
    corners
        Of the used views, px, shape (..., 2); NaN where missing.
    """
    figure = map_figure(i.camera.image_size)
    seen, sure = figure.subplots(1, 2)
    at = corners[np.isfinite(corners).all(axis=-1)]
    width, height = i.camera.image_size
    counts = i.coverage.counts
    empty = np.ma.masked_greater(counts, 0)
    seen.imshow(
        empty,
        cmap=ListedColormap(["#f3d3bd"]),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        interpolation="none",
    )
    seen.plot(*at.T, ".", color=BLUE, ms=1.6, rasterized=len(at) > MANY_POINTS)
    seen.set_title("Corners used; cells without any shaded")
    m = i.uncertainty
    draw_map(sure, m.pixels, m.std_px, m.covered)
    sure.set_title("Projection uncertainty / px")
    imager(seen, i.camera.image_size)
    imager(sure, i.camera.image_size, first=False)
    covered = m.std_px[m.covered & np.isfinite(m.std_px)]
    return Drawing(
        figure,
        f"Camera {i.name.upper()}: {len(at)} corners in {100 * i.coverage.share:.0f} % of the "
        f"cells, the outermost at {100 * i.coverage.reach:.0f} % of the half diagonal. Projection "
        f"uncertainty where corners are: median {np.median(covered):.3f} px, at most "
        f"{covered.max():.3f} px.",
        _columns(m.pixels, m.covered, {"std_px": m.std_px}),
    )


@in_house_style
def draw_difference(i: Intrinsics, difference: LensDifference) -> Drawing:
    """Draw how two calibrations of the camera differ over the imager."""
    figure = map_figure(i.camera.image_size)
    axes, scaled = figure.subplots(1, 2)
    d = difference
    length = np.linalg.norm(d.difference_px, axis=-1)
    draw_map(axes, d.pixels, length, d.covered)
    draw_field(axes, d.pixels, d.difference_px, d.covered)
    axes.set_title("Length of the difference / px")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = length / d.expected_px
    draw_map(scaled, d.pixels, ratio, d.covered, top=3.0)
    scaled.set_title("Difference over expected")
    imager(axes, i.camera.image_size)
    imager(scaled, i.camera.image_size, first=False)
    return Drawing(
        figure,
        f"Camera {i.name.upper()}: {d.second} less {d.first}. Where corners are, the difference is "
        f"{d.rms_px:.3f} px root mean square and {d.max_px:.3f} px at most; both stated "
        f"uncertainties together lead to expect {d.expected_rms_px:.3f} px.",
        _columns(
            d.pixels,
            d.covered,
            {
                "du_px": d.difference_px[..., 0],
                "dv_px": d.difference_px[..., 1],
                "expected_px": d.expected_px,
            },
        ),
    )


@in_house_style
def draw_residuals(i: Intrinsics, corners: FloatArray) -> Drawing:
    """Draw residuals as arrows over the imager, and as a cloud.

    Parameters
    ----------
    corners
        Of the used views, px, shape (views, corners, 2).
    """
    figure = new_figure(height_in=3.1, margins=CLOUD)
    arrows, cloud = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    kept = np.isfinite(i.selected.residuals).all(axis=-1)
    at, off = corners[kept], i.selected.residuals[kept]
    picked = thinned(len(at), ARROWS)
    enlarged = ARROW_SHARE * i.camera.image_size[0] / max(i.selected.rms_px, 1e-6)
    draw_arrows(arrows, at[picked], off[picked], enlarged=enlarged, colour=BLUE)
    arrows.set_title(f"Residuals, {enlarged:.0f} times enlarged")
    imager(arrows, i.camera.image_size)
    _cloud(cloud, off, i.selected.rms_px)
    return Drawing(
        figure,
        f"Camera {i.name.upper()}: residuals of {len(at)} corners, {i.selected.rms_px:.3f} px root "
        f"mean square per coordinate; the largest has {np.linalg.norm(off, axis=1).max():.2f} px.",
        {
            "view": np.nonzero(kept)[0],
            "u_px": at[:, 0],
            "v_px": at[:, 1],
            "du_px": off[:, 0],
            "dv_px": off[:, 1],
        },
    )


def _cloud(axes: Axes, off: FloatArray, rms_px: float) -> None:
    """Draw residuals, px, shape (n, 2), as points."""
    axes.plot(*off.T, ".", color=BLUE, ms=2, alpha=0.5, rasterized=True)
    turn = np.linspace(0, 2 * np.pi, 100)
    for times in (1, 2):
        ring = times * rms_px
        axes.plot(ring * np.cos(turn), ring * np.sin(turn), color=BLACK, lw=0.9, ls="--")
    axes.set(aspect="equal", adjustable="datalim", xlabel="du / px", ylabel="dv / px")
    axes.set_title("Cloud; rings at 1 and 2 rms")


@in_house_style
def draw_cross_validation(i: Intrinsics) -> Drawing:
    """Draw the error of each view when it was left out, under each lens model."""
    figure = new_figure(height_in=2.6)
    axes = figure.subplots()
    v = i.validation
    place = np.arange(len(i.validation.images))
    for lens, rms in zip(v.lenses, v.view_rms_px, strict=True):
        style = plot_style(lens)
        chosen = lens == v.chosen
        axes.plot(
            place,
            rms,
            linestyle="none",
            marker="o" if chosen else "x",
            color=BLUE if chosen else style.colour,
            label=f"{lens}, chosen" if chosen else lens,
        )
    axes.set(xlabel="view, by its place among the images, from 0", ylabel="left-out rms / px")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    from_zero(axes)
    legend(figure, axes)
    told = "; ".join(f"{n} {r:.3f} px" for n, r in zip(v.lenses, v.rms_px, strict=True))
    return Drawing(
        figure,
        f"Camera {i.name.upper()}: root mean square residual of views that were left out: {told}.",
        {
            "image": i.validation.images,
            **{f"{lens}_px": rms for lens, rms in zip(v.lenses, v.view_rms_px, strict=True)},
        },
    )


def _columns(
    pixels: FloatArray, covered: BoolArray, values: dict[str, FloatArray]
) -> dict[str, Any]:
    return {
        "u_px": pixels[..., 0].ravel(),
        "v_px": pixels[..., 1].ravel(),
        "corners_near": covered.ravel().astype(int),
        **{name: value.ravel() for name, value in values.items()},
    }
