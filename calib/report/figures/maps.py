"""What is known over a camera's imager: maps with their scale, and fields of arrows."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from calib.core.arrays import BoolArray, FloatArray
from calib.report.plotting import BLACK, Margins, new_figure

WELL_FITTED = "viridis"
"""Perceptually even, and readable in grey."""

MAP_IN = 2.45
"""Width of a map."""

TALLEST_IN = 3.2

_MARGINS = Margins(left=0.58, right=0.82, top=0.3, between=0.45)

TICKS = 5
"""Intervals along an edge of the imager at most."""

BAR = (1.03, 0.0, 0.045, 1.0)
"""Left, bottom, width and height of a map's scale, in widths and heights of the map."""

LONGEST = 2.0
"""Arrows of a field are drawn up to this length, in cells: longer ones would cross others."""


def map_figure(image_size: tuple[int, int]) -> Figure:
    """Return a figure with room for two maps of an imager of a size, px, and their scales."""
    width, height = image_size
    room = min(MAP_IN * height / width, TALLEST_IN)
    return new_figure(height_in=room + _MARGINS.top + _MARGINS.bottom, margins=_MARGINS)


def imager(axes: Axes, image_size: tuple[int, int], *, first: bool = True) -> None:
    """Let a panel show an imager of a size, px, and no more; only the first names its rows."""
    width, height = image_size
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axes.xaxis.set_major_locator(MaxNLocator(TICKS, steps=[1, 2, 2.5, 5, 10]))
    axes.set_xlabel("u / px")
    if first:
        axes.yaxis.set_major_locator(MaxNLocator(TICKS, steps=[1, 2, 2.5, 5, 10]))
        axes.set_ylabel("v / px")
    else:
        axes.set_yticks([])
    axes.grid(visible=False)


def draw_map(
    axes: Axes,
    pixels: FloatArray,
    values: FloatArray,
    covered: BoolArray,
    *,
    top: float | None = None,
) -> None:
    """Draw values at nodes of the imager; nodes without corners nearby are crossed out.

    The colours span what is found where corners are, unless `top` says where they end.
    """
    inside = values[covered & np.isfinite(values)]
    limit = top if top is not None else float(inside.max()) if len(inside) else 1.0
    low = 0.0 if top is not None else float(inside.min()) if len(inside) else 0.0
    norm = Normalize(low, max(limit, low + 1e-9))
    half = (pixels[-1, -1] - pixels[0, 0]) / (2 * np.array(values.shape[::-1]) - 2)
    left, top_edge = pixels[0, 0] - half
    right, bottom = pixels[-1, -1] + half
    picture = axes.imshow(
        np.ma.masked_invalid(values),
        cmap=WELL_FITTED,
        norm=norm,
        extent=(left, right, bottom, top_edge),
        interpolation="none",
    )
    for colour, size, width in ((BLACK, 3.6, 1.6), ("white", 3.0, 0.8)):
        axes.plot(*pixels[~covered].T, "x", color=colour, ms=size, mew=width)
    beyond = bool((np.nan_to_num(values, nan=-np.inf) > limit).any())
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("the panel belongs to no figure")
    bar = axes.inset_axes(BAR)
    figure.colorbar(picture, cax=bar, extend="max" if beyond else "neither")
    bar.tick_params(labelsize=8)


def draw_field(axes: Axes, pixels: FloatArray, field: FloatArray, covered: BoolArray) -> None:
    """Draw a field of vectors, px, shape (rows, columns, 2), at the covered nodes of the imager.

    A cell's width stands for the length that one vector in twenty exceeds.
    """
    cell = float(np.min(np.abs(pixels[1, 1] - pixels[0, 0])))
    vectors = field[covered]
    length = np.linalg.norm(vectors, axis=-1)
    known = np.isfinite(length)
    if not known.any():
        return
    unit = max(float(np.quantile(length[known], 0.95)), 1e-12)
    shorter = np.minimum(1, LONGEST * unit / np.maximum(length[known], 1e-12))
    shown = vectors[known] * shorter[:, None]
    draw_arrows(
        axes, pixels[covered][known], shown, enlarged=cell / unit, pivot="mid", colour="white"
    )


def draw_arrows(
    axes: Axes,
    at: FloatArray,
    vectors: FloatArray,
    *,
    enlarged: float,
    colour: str,
    pivot: Literal["tail", "mid"] = "tail",
) -> None:
    """Draw vectors, px, at points, px, shapes (n, 2), so many times enlarged."""
    axes.quiver(
        *at.T,
        *vectors.T,
        color=colour,
        angles="xy",
        scale_units="xy",
        scale=1 / enlarged,
        pivot=pivot,
        width=0.004,
    )
