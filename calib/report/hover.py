"""Values of a figure's points, for the pointer: where each is drawn and what it stands for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from calib.core.arrays import FloatArray

MOST_POINTS = 160
"""Points of a figure that tell their values; more would make the page large, and lie too close."""

NEAR_TICK = 0.3
"""Points beside a tick of named things, moved aside so as not to hide each other, are of it."""

_MATHEMATICS = re.compile(r"\\[,;!]|\\mathrm|[${}\\]")


def hover_points(figure: Figure) -> str:
    """Return marked points of a figure as JSON: place from left and top, from 0 to 1, and words.

    The figure must have been drawn, or saved, for its layout to stand.
    """
    found = [point for axes in figure.axes for point in _points(axes)]
    step = max(1, -(-len(found) // MOST_POINTS))
    width, height = figure.bbox.width, figure.bbox.height
    return json.dumps(
        [
            [round(x / width, 4), round(1 - y / height, 4), text]
            for x, y, text in found[::step]
            if 0 <= x <= width and 0 <= y <= height
        ],
        ensure_ascii=False,
        separators=(",", ":"),
    )


def _points(axes: Axes) -> Iterator[tuple[float, float, str]]:
    for line in axes.get_lines():
        if line.get_marker() in (None, "None", "", " "):
            continue
        if not all(line.get_transform().contains_branch_seperately(axes.transData)):
            continue
        yield from _of_line(axes, line)


def _of_line(axes: Axes, line: Line2D) -> Iterator[tuple[float, float, str]]:
    try:
        values = np.stack(
            [np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)]
        )
    except (TypeError, ValueError):
        return
    places: FloatArray = line.get_transform().transform(values.T)
    label = str(line.get_label())
    head = "" if label.startswith("_") else f"{_words(label)}\n"
    for (x, y), (px, py) in zip(values.T, places, strict=True):
        if np.isfinite([px, py]).all():
            yield float(px), float(py), f"{head}{_said(axes.xaxis, x)}\n{_said(axes.yaxis, y)}"


def _said(axis: Axis, value: float) -> str:
    """Return a value under the label of its axis; the tick's own words where it has some."""
    name = _words(axis.get_label_text().partition("\n")[0])
    if isinstance(axis.get_major_locator(), FixedLocator):
        ticks = np.asarray(axis.get_majorticklocs(), float)
        near = ticks[np.abs(ticks - value) < NEAR_TICK]
        label = axis.get_major_formatter()(float(near[0]), 0) if len(near) else ""
        if label:
            return f"{name}: {_words(label)}" if name else _words(label)
    return f"{name}: {value:.5g}" if name else f"{value:.5g}"


def _words(text: str) -> str:
    """Return a label without matplotlib's mathematics."""
    return _MATHEMATICS.sub("", text).replace("_", "").strip()
