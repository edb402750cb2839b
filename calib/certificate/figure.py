"""The figure of the certificate: 95 % interval of the depth, relative to depth, over depth.

Drawn in black on white with lines, dashes and hatching: it says the same in print without colour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.sax.saxutils import escape

from calib.certificate.data import Figure
from calib.uncertainty.certified import CertifiedDepth
from calib.uncertainty.conformity import ToleranceRule
from calib.uncertainty.format import fixed, plain

WIDTH, HEIGHT = 640, 215
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 14, 44
CAP = 5


class _Plane:
    """Maps depth (mm) and relative deviation (%) to points of the picture."""

    def __init__(self, *, low: float, high: float, reach: float) -> None:
        margin = 0.06 * (high - low or high)
        self.low, self.high = low - margin, high + margin
        self.reach = reach

    def x(self, depth: float) -> float:
        return LEFT + (depth - self.low) / (self.high - self.low) * (WIDTH - LEFT - RIGHT)

    def y(self, percent: float) -> float:
        middle = (HEIGHT - BOTTOM + TOP) / 2
        return middle - percent / self.reach * (HEIGHT - BOTTOM - TOP) / 2


def depth_figure(
    depths: Sequence[CertifiedDepth],
    *,
    calibrated_mm: tuple[float, float],
    tolerance: ToleranceRule | None,
) -> Figure | None:
    """Return the figure; None without depths."""
    if not depths:
        return None
    ends = [
        (
            d.result.z_mm,
            100 * (d.result.interval.low / d.result.z_mm - 1),
            100 * (d.result.interval.high / d.result.z_mm - 1),
        )
        for d in depths
    ]
    limit = None if tolerance is None else 100 * tolerance.depth_rel
    widest = max(max(abs(low), abs(high)) for _, low, high in ends)
    plane = _Plane(
        low=min(ends[0][0], calibrated_mm[0]),
        high=max(ends[-1][0], calibrated_mm[1]),
        reach=1.15 * max(widest, limit or 0.0),
    )
    parts = [
        *_outside(plane, calibrated_mm),
        *_axes(plane),
        *([] if limit is None else _limits(plane, limit)),
        *(part for z, low, high in ends for part in _bar(plane, z, low, high)),
    ]
    body = "\n".join(parts)
    alternative = _alternative(ends, limit)
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'width="{WIDTH}" height="{HEIGHT}" role="img" '
        'font-family="DejaVu Sans, Liberation Sans, Arial, sans-serif" font-size="11">'
        f"<title>{escape(alternative)}</title>"
        '<defs><pattern id="hatch" width="6" height="6" patternUnits="userSpaceOnUse">'
        '<path d="M0 6L6 0" stroke="#888" stroke-width="0.6"/></pattern></defs>'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>{body}</svg>'
    )
    legend = "Bars: 95 % interval of the depth about its estimate."
    if limit is not None:
        legend += f" Dashed: tolerance ±{plain(limit)} %."
    return Figure(svg=svg, alternative=alternative, caption=f"{legend} Hatched: not calibrated.")


def _alternative(ends: Sequence[tuple[float, float, float]], limit: float | None) -> str:
    bars = "; ".join(
        f"{plain(z)} mm: {fixed(low, 2)} % to +{fixed(high, 2)} %" for z, low, high in ends
    )
    text = f"95 % interval of the measured depth relative to depth. {bars}."
    return text if limit is None else f"{text} Tolerance ±{plain(limit)} %."


def _line(x1: float, y1: float, x2: float, y2: float, style: str = 'stroke-width="1"') -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#000" fill="none" {style}/>'


def _text(x: float, y: float, words: str, anchor: str = "middle", extra: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {extra}>{escape(words)}</text>'


def _outside(plane: _Plane, calibrated_mm: tuple[float, float]) -> list[str]:
    low, high = (plane.x(z) for z in calibrated_mm)
    left, right = plane.x(plane.low), plane.x(plane.high)
    return [
        f'<rect x="{a:.1f}" y="{TOP}" width="{b - a:.1f}" height="{HEIGHT - BOTTOM - TOP}" '
        'fill="url(#hatch)"/>'
        for a, b in ((left, low), (high, right))
        if b > a
    ]


def _axes(plane: _Plane) -> list[str]:
    left, right = plane.x(plane.low), plane.x(plane.high)
    bottom = HEIGHT - BOTTOM
    parts = [
        f'<rect x="{left:.1f}" y="{TOP}" width="{right - left:.1f}" height="{bottom - TOP}" '
        'fill="none" stroke="#000"/>',
        _line(left, plane.y(0), right, plane.y(0), 'stroke-width="0.6"'),
        _text((left + right) / 2, HEIGHT - 8, "depth z / mm"),
        _text(14, (TOP + bottom) / 2, "deviation / %", extra=_upright(14, (TOP + bottom) / 2)),
    ]
    for z in _ticks(plane.low, plane.high):
        parts += [
            _line(plane.x(z), bottom, plane.x(z), bottom + CAP),
            _text(plane.x(z), bottom + 17, f"{z:g}"),
        ]
    for percent in _ticks(-plane.reach, plane.reach):
        sign = "+" if percent > 0 else "−" if percent < 0 else ""
        parts += [
            _line(left - CAP, plane.y(percent), left, plane.y(percent)),
            _text(left - 8, plane.y(percent) + 4, f"{sign}{abs(percent):g}", "end"),
        ]
    return parts


def _upright(x: float, y: float) -> str:
    return f'transform="rotate(-90 {x:.1f} {y:.1f})"'


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers between low and high, four to nine of them."""
    raw = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw)
    first, last = math.ceil(low / step), math.floor(high / step)
    return [round(i * step, 12) for i in range(first, last + 1)]


def _limits(plane: _Plane, limit: float) -> list[str]:
    left, right = plane.x(plane.low), plane.x(plane.high)
    dashed = 'stroke-width="1.2" stroke-dasharray="7 4"'
    return [_line(left, plane.y(p), right, plane.y(p), dashed) for p in (-limit, limit)]


def _bar(plane: _Plane, z: float, low: float, high: float) -> list[str]:
    x, bottom, top = plane.x(z), plane.y(low), plane.y(high)
    thick = 'stroke-width="2"'
    return [
        _line(x, bottom, x, top, thick),
        _line(x - CAP, bottom, x + CAP, bottom, thick),
        _line(x - CAP, top, x + CAP, top, thick),
        f'<circle cx="{x:.1f}" cy="{plane.y(0):.1f}" r="3.2" fill="#000"/>',
    ]
