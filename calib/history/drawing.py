"""A rig's control charts as SVG, one small drawing each, so that a page lays them out by its width.

Drawn without matplotlib: a fleet has a page a rig and eighteen charts a page, and its import alone
would take longer than a page may. Colours are those of Okabe and Ito; alarms are squares as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta
from html import escape
from textwrap import wrap

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.history.quantities import Series
from calib.results.wording import printable
from calib.uncertainty.charts import (
    CUSUM_LIMIT,
    EWMA_LIMIT,
    SHEWHART_LIMIT,
    Chart,
    charts,
    reference,
)

BLACK, GREY, PALE, BLUE, VERMILLION = "#1b1b1b", "#6b6b6b", "#e6e6e6", "#0072B2", "#D55E00"

WIDTH, HEIGHT = 330, 160
_HEADLINE, _LINE = 30, 15
CAPTION_CHARACTERS = 140
"""A line over three charts, in letters of common width."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 42.0, 322.0, 26.0, 136.0

MANY = 300
"""Points beyond which they have no hover text, which takes a hundred bytes each."""

LABELS = 5
"""Dates under a chart, at most."""

APART_PX = 12.0
"""Two labels of the vertical axis do not come closer."""


def chart_rows(found: Sequence[Series], *, accepted: int) -> list[list[str]]:
    """Return the charts as SVG elements, a row a quantity.

    Statistics are those of what came after acceptance, over their dates.
    """
    rows = []
    for one in found:
        at = reference(one.values[:accepted], one.std[:accepted])
        after = slice(accepted, None)
        drawn = charts(one.values[after], one.std[after], at)
        rows.append([_chart(one.name, chart, one.dates[after]) for chart in drawn])
    return rows


def legend(*, accepted: int, of: str) -> str:
    """Return what the charts show, in words.

    Parameters
    ----------
    accepted, of
        How many make the reference, and what they are: calibrations or sessions.
    """
    first = f"mean of the first {accepted} {of}" if accepted > 1 else f"first of the {of}"
    return (
        f"Deviations from the reference (weighted {first}) of all that followed, in standard "
        f"uncertainties. Dashed: limits, {SHEWHART_LIMIT:g} (Shewhart), {EWMA_LIMIT:g} (EWMA, in "
        f"its own standard deviation) and {CUSUM_LIMIT:g} (CUSUM). Red squares are outside."
    )


def one_drawing(rows: Sequence[Sequence[str]], *, title: str, caption: str) -> str:
    """Return all charts as one SVG document with a title and a caption."""
    lines = wrap(printable(caption), CAPTION_CHARACTERS)
    width, top = max(map(len, rows)) * WIDTH, _HEADLINE + _LINE * len(lines)
    height = top + len(rows) * HEIGHT
    font = f'font-family="DejaVu Sans, sans-serif" fill="{BLACK}"'
    placed = [
        f'<text x="6" y="20" font-size="15" font-weight="bold" {font}>'
        f"{escape(printable(title))}</text>",
        *(
            f'<text x="6" y="{_HEADLINE + _LINE * k + 8}" font-size="11" {font}>'
            f"{escape(line)}</text>"
            for k, line in enumerate(lines)
        ),
    ]
    placed += [
        f'<g transform="translate({column * WIDTH} {top + line * HEIGHT})">\n{chart}\n</g>'
        for line, row in enumerate(rows)
        for column, chart in enumerate(row)
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">\n<rect width="{width}" height="{height}" fill="#fff"/>\n'
        + "\n".join(placed)
        + "\n</svg>\n"
    )


def _chart(name: str, chart: Chart, dates: Sequence[str]) -> str:
    title = f"{name}: {chart.name}"
    seconds = np.array([_moment(text).timestamp() for text in dates])
    first, last = float(seconds[0]), float(seconds[-1])
    span = last - first
    x = _LEFT + (_RIGHT - _LEFT) * ((seconds - first) / span if span else np.full(len(dates), 0.5))
    farthest = float(np.max(np.abs(chart.statistic), initial=chart.limit))
    half = (_BOTTOM - _TOP) / 2 / (1.12 * farthest)
    middle = (_TOP + _BOTTOM) / 2
    out = np.abs(chart.statistic) > chart.limit
    y = middle - half * chart.statistic
    parts = [
        f'<text x="6" y="15" font-weight="bold">{escape(title)}</text>',
        *_dates(_moment(dates[0]), _moment(dates[-1])),
        *_levels(chart.limit, farthest, middle, half),
        _line(x, y),
        *_points(x, y, out, chart, dates),
    ]
    said = "in control" if not out.any() else f"outside the limits {int(out.sum())} times"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}, {said}" '
        f'font-family="DejaVu Sans, sans-serif" font-size="11" fill="{BLACK}">\n'
        + "\n".join(parts)
        + "\n</svg>"
    )


def _levels(limit: float, farthest: float, middle: float, half: float) -> list[str]:
    """Return the lines of zero and limits, and labels as far as there is room."""
    found = []
    for level, style in ((0.0, ""), (limit, ' stroke-dasharray="5 3"')):
        for sign in (1, -1) if level else (1,):
            y = middle - half * sign * level
            found.append(
                f'<path d="M{_LEFT:.0f} {y:.1f}H{_RIGHT:.0f}" stroke="{GREY}"{style} fill="none"/>'
            )
    labels = [farthest, limit] if half * (farthest - limit) > APART_PX else [limit]
    for level in (0.0, *(one for one in labels if half * one > APART_PX)):
        for sign in (1, -1) if level else (1,):
            y = middle - half * sign * level
            found.append(
                f'<text x="{_LEFT - 5:.0f}" y="{y + 4:.1f}" text-anchor="end" font-size="10">'
                f"{_number(sign * level)}</text>"
            )
    return found


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}")


def _line(x: FloatArray, y: FloatArray) -> str:
    points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<path d="M{points}" stroke="{BLUE}" stroke-width="1.3" fill="none"/>'


def _points(
    x: FloatArray, y: FloatArray, out: BoolArray, chart: Chart, dates: Sequence[str]
) -> list[str]:
    """Return the points, those outside the limits as larger squares in red."""
    # Shapes with an area: renderers differ in what a line without length looks like.
    found = []
    for which, colour, shape in ((~out, BLUE, _DISC), (out, VERMILLION, _SQUARE)):
        places = list(map(int, np.flatnonzero(which)))
        drawn = [f"M{x[i]:.1f} {y[i]:.1f}{shape}" for i in places]
        if len(x) > MANY:
            found += [f'<path d="{"".join(drawn)}" fill="{colour}"/>'] * bool(drawn)
            continue
        found += [
            f'<path d="{mark}" fill="{colour}"><title>{dates[i]}: {chart.statistic[i]:+.2f}'
            "</title></path>"
            for i, mark in zip(places, drawn, strict=True)
        ]
    return found


_DISC = "m-2.4 0a2.4 2.4 0 1 0 4.8 0a2.4 2.4 0 1 0 -4.8 0z"
_SQUARE = "m-3 -3h6v6h-6z"


def _dates(first: datetime, last: datetime) -> list[str]:
    """Return the dates under a chart with their lines."""
    span = (last - first).total_seconds()
    found = [
        f'<path d="M{_LEFT:.0f} {_BOTTOM:.0f}H{_RIGHT:.0f}" stroke="{GREY}" fill="none"/>',
    ]
    for moment, label in _ticks(first, last):
        share = (moment - first).total_seconds() / span if span else 0.5
        x = _LEFT + (_RIGHT - _LEFT) * share
        # What would be cut off at the rim ends or begins there.
        anchor = "start" if x < _LEFT + 20 else "end" if x > _RIGHT - 20 else "middle"
        found.append(
            f'<path d="M{x:.1f} {_TOP:.0f}V{_BOTTOM + 4:.0f}" stroke="{PALE}" fill="none"/>'
            f'<text x="{x:.1f}" y="{_BOTTOM + 16:.0f}" text-anchor="{anchor}" font-size="10">'
            f"{label}</text>"
        )
    return found


def _ticks(first: datetime, last: datetime) -> list[tuple[datetime, str]]:
    """Return at most `LABELS` dates with their labels: years, months or days, whichever fit."""
    for months in (1, 3, 6, 12, 24, 60, 120, 240, 600, 1200, 2400, 12000):
        ticks = _months(first, last, months)
        if 2 <= len(ticks) <= LABELS:
            return [(t, f"{t:%Y}" if months >= 12 else f"{t:%Y-%m}") for t in ticks]
    days = max(1, -(-(last.date() - first.date()).days // (LABELS - 1)))
    count = (last.date() - first.date()).days // days + 1
    some = [first + timedelta(days=days * k) for k in range(count)]
    return [(t, f"{t:%Y-%m-%d}" if k == 0 else f"{t:%m-%d}") for k, t in enumerate(some)]


def _months(first: datetime, last: datetime, step: int) -> list[datetime]:
    """Return the first days of every `step`-th month within a time, one more than fit at most."""
    found: list[datetime] = []
    month = -(-(12 * first.year + first.month - 1) // step) * step
    while len(found) <= LABELS and month // 12 <= date.max.year:
        at = datetime(month // 12, month % 12 + 1, 1, tzinfo=UTC)
        if at > last:
            break
        if at >= first:
            found.append(at)
        month += step
    return found


def _moment(text: str) -> datetime:
    """Return a date as a point of the axis; which zone it is of does not matter there."""
    return datetime.fromisoformat(text).replace(tzinfo=UTC)
