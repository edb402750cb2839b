"""Intrinsics of one camera: coverage, uncertainty, differences, residuals, cross-validation."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from calib.arrays import BoolArray, FloatArray
from calib.images.intrinsics import Intrinsics
from calib.images.intrinsics_maps import LensDifference
from calib.report.plotting import (
    BLACK,
    BLUE,
    GREY,
    MANY_POINTS,
    Drawing,
    Margins,
    from_zero,
    in_house_style,
    legend,
    look,
    new_figure,
    thinned,
)

MAPS = Margins(left=0.55, right=0.3, top=0.3, between=0.25)

ARROWS = 400
"""Residual arrows drawn at most; more make a carpet."""

ARROW_SHARE = 0.03
"""Share of the imager's width that an arrow of the root mean square length takes."""

WELL_FITTED = "viridis"
"""Perceptually even, and readable in grey."""


@in_house_style
def draw_coverage(i: Intrinsics, corners: FloatArray) -> Drawing:
    """Draw where corners were, and how uncertain the projection is over the imager.

    Parameters
    ----------
    corners
        Of the used views, px, shape (..., 2); NaN where missing.
    """
    figure = new_figure(height_in=2.9, margins=MAPS)
    seen, sure = figure.subplots(1, 2)
    at = corners[np.isfinite(corners).all(axis=-1)]
    width, height = i.camera.image_size
    counts = i.coverage.counts
    empty = np.ma.masked_greater(counts, 0)
    seen.imshow(
        empty,
        cmap=ListedColormap(["#f3d3bd"]),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        interpolation="nearest",
    )
    seen.plot(*at.T, ".", color=BLUE, ms=1.6, rasterized=len(at) > MANY_POINTS)
    seen.set_title("Corners used; cells without any shaded")
    m = i.uncertainty
    _map(figure, sure, m.pixels, m.std_px, m.covered, "standard deviation / px")
    sure.set_title("Projection uncertainty")
    for axes in (seen, sure):
        _imager(axes, i)
    sure.set_ylabel("")
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
    figure = new_figure(height_in=2.9, margins=MAPS)
    axes, scaled = figure.subplots(1, 2)
    d = difference
    length = np.linalg.norm(d.difference_px, axis=-1)
    _map(figure, axes, d.pixels, length, d.covered, "length / px")
    axes.quiver(
        *d.pixels[d.covered].T,
        *d.difference_px[d.covered].T,
        color="white",
        angles="xy",
        pivot="mid",
        width=0.004,
    )
    axes.set_title("Difference")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = length / d.expected_px
    _map(figure, scaled, d.pixels, ratio, d.covered, "difference / expected", top=3.0)
    scaled.set_title("Difference over expected")
    for a in (axes, scaled):
        _imager(a, i)
    scaled.set_ylabel("")
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
    figure = new_figure(height_in=3.1, margins=MAPS)
    arrows, cloud = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    kept = np.isfinite(i.selected.residuals).all(axis=-1)
    at, off = corners[kept], i.selected.residuals[kept]
    picked = thinned(len(at), ARROWS)
    scale = max(i.selected.rms_px, 1e-6) / (ARROW_SHARE * i.camera.image_size[0])
    arrows.quiver(
        *at[picked].T,
        *off[picked].T,
        color=BLUE,
        angles="xy",
        scale_units="xy",
        scale=scale,
        width=0.0025,
    )
    arrows.set_title(f"Residuals, {1 / scale:.0f} times enlarged")
    _imager(arrows, i)
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
    place = np.arange(len(i.images))
    for lens, rms in zip(v.lenses, v.view_rms_px, strict=True):
        style = look(lens)
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
            "image": i.images,
            **{f"{lens}_px": rms for lens, rms in zip(v.lenses, v.view_rms_px, strict=True)},
        },
    )


def _imager(axes: Axes, i: Intrinsics) -> None:
    width, height = i.camera.image_size
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axes.set(xlabel="u / px", ylabel="v / px")
    axes.grid(visible=False)


def _map(
    figure: Figure,
    axes: Axes,
    pixels: FloatArray,
    values: FloatArray,
    covered: BoolArray,
    label: str,
    *,
    top: float | None = None,
) -> None:
    """Draw values at nodes of the imager; nodes without corners nearby are crossed out.

    The colours span what is found where corners are, unless `top` says where they end.
    """
    inside = values[covered & np.isfinite(values)]
    limit = top if top is not None else float(inside.max()) if len(inside) else 1.0
    low = 0.0 if top is not None else float(inside.min()) if len(inside) else 0.0
    half = (pixels[-1, -1] - pixels[0, 0]) / (2 * np.array(values.shape[::-1]) - 2)
    left, top_edge = pixels[0, 0] - half
    right, bottom = pixels[-1, -1] + half
    mesh: Any = axes.imshow(
        np.ma.masked_invalid(values),
        cmap=WELL_FITTED,
        vmin=low,
        vmax=max(limit, low + 1e-9),
        extent=(left, right, bottom, top_edge),
        interpolation="nearest",
    )
    axes.plot(*pixels[~covered].T, "x", color="white", ms=3, mew=0.8)
    beyond = bool((np.nan_to_num(values, nan=-np.inf) > limit).any())
    bar = figure.colorbar(mesh, ax=axes, shrink=0.9, extend="max" if beyond else "neither")
    bar.set_label(label, fontsize=8)
    bar.outline.set_edgecolor(GREY)


def _columns(
    pixels: FloatArray, covered: BoolArray, values: dict[str, FloatArray]
) -> dict[str, Any]:
    return {
        "u_px": pixels[..., 0].ravel(),
        "v_px": pixels[..., 1].ravel(),
        "corners_near": covered.ravel().astype(int),
        **{name: value.ravel() for name, value in values.items()},
    }
