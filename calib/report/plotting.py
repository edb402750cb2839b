"""House style of the figures, and their way onto the page: SVG and CSV as data URIs.

Figures are drawn with matplotlib's objects, without pyplot's global state. Clouds of points are
rasterised inside the SVG. Colours are those of Okabe and Ito, which colour-blind readers tell
apart; models also differ in their markers, for print in black and white.
"""

from __future__ import annotations

import base64
import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeAlias, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib.report.blocks import Picture, Text
from calib.report.hover import hover_points

BLACK, GREY, LIGHT = "#1b1b1b", "#6b6b6b", "#d9d9d9"
BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, VERMILLION, PURPLE = "#E69F00", "#D55E00", "#CC79A7"

CSS_PX_PER_INCH = 96

RASTER_DPI = 120
"""Of clouds and pictures inside the figures: sharp on paper, small in the file."""

MANY_POINTS = 600
"""Points beyond which a cloud is rasterised: an SVG point takes some 60 bytes."""

DATA_ROWS = 2000
"""Rows of a figure's data file; more are thinned evenly, `results.h5` has them all."""

LABEL_LENGTH = 8
LEGEND_LENGTH = 36
MANY_LABELS = 40


@dataclass(frozen=True)
class PlotStyle:
    """How a model or fit is drawn."""

    colour: str
    marker: str


PLOT_STYLES: Mapping[str, PlotStyle] = {
    "base": PlotStyle(VERMILLION, "s"),
    "axis-offset": PlotStyle(BLUE, "o"),
    "axis-tilt": PlotStyle(GREEN, "^"),
    "encoder": PlotStyle(PURPLE, "D"),
}

_OTHERS = (PlotStyle(BLACK, "v"), PlotStyle(ORANGE, "P"), PlotStyle(SKY, "X"), PlotStyle(GREY, "<"))


def plot_style(name: str) -> PlotStyle:
    """Return how a model is drawn: always the same way."""
    return PLOT_STYLES.get(name) or _OTHERS[sum(name.encode()) % len(_OTHERS)]


_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    # Given, not found from the boxes of all labels; no panel here has ticks above it.
    "axes.titley": 1.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.5,
    "lines.markersize": 5.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    # Each picture as coarse as it is; the browser enlarges it.
    "image.composite_image": False,
    "figure.dpi": 100.0,
    # The same results give the same bytes, and letters look the same on every machine.
    "svg.hashsalt": "calib",
    "svg.fonttype": "path",
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw and save in house style within this context."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


Column: TypeAlias = Sequence[object] | NDArray[Any]


@dataclass(frozen=True)
class Drawing:
    """A figure before it is put on a page.

    Parameters
    ----------
    figure
        Drawn in house style.
    alternative
        What it shows, in words with figures.
    data
        Columns of its data file by their head, all of one length.
    """

    figure: Figure
    alternative: str
    data: Mapping[str, Column]


P = ParamSpec("P")
R = TypeVar("R")


def in_house_style(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function draw in house style."""

    @wraps(function)
    def styled(*args: P.args, **kwargs: P.kwargs) -> R:
        with house_style():
            return function(*args, **kwargs)

    return styled


@dataclass(frozen=True)
class Margins:
    """Room about the panels, in; `between` them in widths of a panel.

    Fixed, because matplotlib's layout engines draw every figure twice.
    """

    left: float = 0.72
    right: float = 0.15
    bottom: float = 0.5
    top: float = 0.38
    between: float = 0.3


DEFAULT_MARGINS = Margins()


def empty_figure(*, height_in: float, width_in: float) -> Figure:
    """Return an empty figure, free of pyplot."""
    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def new_figure(
    *, height_in: float, width_in: float = 7.4, margins: Margins = DEFAULT_MARGINS
) -> Figure:
    """Return a figure with room for its panels."""
    figure = empty_figure(height_in=height_in, width_in=width_in)
    figure.subplots_adjust(
        left=margins.left / width_in,
        right=1 - margins.right / width_in,
        bottom=margins.bottom / height_in,
        top=1 - margins.top / height_in,
        wspace=margins.between,
    )
    return figure


def legend(figure: Figure, axes: Axes) -> None:
    """Name what a panel shows in one line above the figure's panels."""
    handles, labels = axes.get_legend_handles_labels()
    drawn = figure.legend(
        handles, labels, loc="upper right", ncols=max(len(labels), 1), borderaxespad=0.3
    )
    for text in drawn.get_texts():
        text.set_parse_math(False)


def picture(key: str, drawing: Drawing, caption: Text) -> Picture:
    """Return a drawing as a block of the page."""
    drawn = data_uri("image/svg+xml", svg(drawing.figure))
    return Picture(
        key=key,
        image=drawn,
        points=hover_points(drawing.figure),
        width_px=round(drawing.figure.get_figwidth() * CSS_PX_PER_INCH),
        alternative=drawing.alternative,
        caption=caption,
        data=data_uri("text/csv", csv_text(drawing.data).encode()) if drawing.data else "",
    )


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="svg", dpi=RASTER_DPI, metadata=_NO_METADATA)
    text = buffer.getvalue().decode()
    # Prologue, comments and indentation say nothing; a hundredth of a point is beyond any printer.
    text = re.sub(r"<!--.*?-->|\n\s*", " ", text[text.index("<svg") :], flags=re.DOTALL)
    return _LONG_COORDINATE.sub(r"\1", text).encode()


_NO_METADATA: Any = dict.fromkeys(("Creator", "Date", "Format", "Type"))

_LONG_COORDINATE = re.compile(r"(?<![\d.])([1-9]\d*\.\d\d)\d+")


def data_uri(kind: str, content: bytes) -> str:
    """Return content as a data URI."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def csv_text(data: Mapping[str, Column]) -> str:
    """Return columns as CSV, thinned to `DATA_ROWS` rows.

    Raises
    ------
    ValueError
        If the columns are not of one length.
    """
    lengths = {len(column) for column in data.values()}
    if len(lengths) != 1:
        raise ValueError(f"columns of lengths {sorted(lengths)} do not make a table")
    picked = thinned(lengths.pop(), DATA_ROWS)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(data)
    writer.writerows(zip(*(_entries(column, picked) for column in data.values()), strict=True))
    return buffer.getvalue()


def _entries(column: Column, picked: NDArray[np.intp]) -> list[object]:
    """Return values as they are written: floats to seven digits, what does not exist empty."""
    values = (
        column[picked].tolist() if isinstance(column, np.ndarray) else [column[i] for i in picked]
    )
    return [
        value if not isinstance(value, float) else "" if math.isnan(value) else f"{value:.7g}"
        for value in values
    ]


def from_zero(axes: Axes) -> None:
    """Let the y axis of positive values begin at 0, with room above the largest."""
    axes.set_ylim(0, 1.05 * axes.get_ylim()[1])


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` places of `count`, evenly spread."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.intp)


def cloud(axes: Axes, x: NDArray[Any], y: NDArray[Any], look_: PlotStyle, **style: Any) -> None:
    """Draw points, rasterised and smaller where they are many."""
    many = len(x) > MANY_POINTS
    settings = {"markersize": 2.0 if many else 5.0, "rasterized": many} | style
    axes.plot(x, y, linestyle="none", marker=look_.marker, color=look_.colour, **settings)


def plain(text: str, otherwise: str) -> str:
    """Return a text of others as it may stand on a figure, or what to write instead."""
    fits = text.isascii() and text.isprintable() and len(text) <= LEGEND_LENGTH
    return text if fits else otherwise


def label_rows(axes: Axes, ids: Sequence[str], *, what: str) -> None:
    """Label the x axis with the ids of rows at 0, 1, ..., or with their numbers.

    Ids of others go onto a figure only where they are short and plain; else the reader finds
    them in the table, by number.
    """
    plain = all(i.isascii() and i.isprintable() and len(i) <= LABEL_LENGTH for i in ids)
    if plain and len(ids) <= MANY_LABELS:
        crowded = sum(map(len, ids)) > 60
        axes.set_xticks(range(len(ids)), ids, parse_math=False, rotation=90 if crowded else 0)
        axes.set_xlabel(what)
    else:
        axes.set_xlabel(f"{what}, by its place in the table, from 0")
    axes.set_xlim(-0.6, len(ids) - 0.4)
