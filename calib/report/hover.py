"""Values of a figure's points, for the pointer: where each is drawn and what it stands for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
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
    found = [points for axes in figure.axes for points in _lines(axes)]
    step = max(1, -(-sum(map(len, found)) // MOST_POINTS))
    width, height = figure.bbox.width, figure.bbox.height
    told, before = [], 0
    for points in found:
        # Every `step`-th of all; words only of these, as a long table has a million points.
        for i in range(-before % step, len(points), step):
            x, y = points.places[i].tolist()
            if 0 <= x <= width and 0 <= y <= height:
                told.append([round(x / width, 4), round(1 - y / height, 4), points.said(i)])
        before += len(points)
    return json.dumps(told, ensure_ascii=False, separators=(",", ":"))


@dataclass(frozen=True)
class _Points:
    """The points of a line: values and where these are drawn, shape (n, 2)."""

    axes: Axes
    head: str
    values: FloatArray
    places: FloatArray

    def __len__(self) -> int:
        return len(self.places)

    def said(self, i: int) -> str:
        """Return a point's values in words."""
        x, y = self.values[i]
        return f"{self.head}{_said(self.axes.xaxis, x)}\n{_said(self.axes.yaxis, y)}"


def _lines(axes: Axes) -> Iterator[_Points]:
    for line in axes.get_lines():
        if line.get_marker() in (None, "None", "", " "):
            continue
        if not all(line.get_transform().contains_branch_seperately(axes.transData)):
            continue
        try:
            values = np.stack(
                [np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)], axis=1
            )
        except (TypeError, ValueError):
            continue
        places: FloatArray = line.get_transform().transform(values)
        drawn = np.isfinite(places).all(axis=1)
        label = str(line.get_label())
        head = "" if label.startswith("_") else f"{_words(label)}\n"
        yield _Points(axes, head, values[drawn], places[drawn])


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
