"""The set-up from above: what the symbols mean, and where the targets stood."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Polygon
from matplotlib.transforms import Affine2D

from calib.core.arrays import FloatArray
from calib.geometry.parameters import INDEX
from calib.report.numbers import plain_symbol, signed
from calib.report.plotting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LIGHT,
    VERMILLION,
    Drawing,
    Margins,
    in_house_style,
    new_figure,
    thinned,
)
from calib.rows.observations import Observations

SKETCH_AXIS = (1.45, 0.55)
"""|X| and |Z| of the yaw axis in the sketch."""

SKETCH_ECCENTRICITY = 0.3

SKETCH_TARGET = (0.5, 2.45)
"""|X| and Z."""

RAYS = 40
"""Rays drawn at most; more hide each other."""


@in_house_style
def draw_setup(
    rows: Observations, theta: FloatArray, free: tuple[str, ...], *, effective: str = ""
) -> Drawing:
    """Draw the symbols of the model, and the targets to scale.

    Parameters
    ----------
    theta, free
        The selected model: parameter vector, shape (COUNT,), and its free parameters.
    effective
        L_b + e with its 95 % interval, as printed everywhere; empty without an eccentricity, where
        L_b is the same.
    """
    figure = new_figure(height_in=4.5, margins=Margins(left=0.2, bottom=0.8, top=0.3, between=0.25))
    sketch, plan = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _sketch(sketch, theta, free, effective)
    _plan(plan, rows, theta)
    low, high = rows.z_mm.min(), rows.z_mm.max()
    x = rows.x1c * rows.z_mm
    return Drawing(
        figure,
        "Two views from above, X to the right and Z away from the cameras. Left, a sketch with the "
        "symbols: C1 in the origin, the yaw axis of C2 to the "
        f"{'left' if _side(theta) < 0 else 'right'} of it, C2's gaze plane through the target. "
        f"Right, to scale: {len(rows)} targets between X = {x.min():.0f} and {x.max():.0f} mm and "
        f"Z = {low:.0f} and {high:.0f} mm.",
        {"id": rows.ids, "group": rows.groups, "x_mm": x, "z_reference_mm": rows.z_mm},
    )


def _sketch(axes: Axes, theta: FloatArray, free: tuple[str, ...], effective: str) -> None:
    """Draw the symbols, not to scale; signs of Z_a and e as found."""
    z_axis = _sign(theta, "axis_z_mm", free) * SKETCH_AXIS[1]
    offset = _sign(theta, "eccentricity_mm", free) * SKETCH_ECCENTRICITY
    side = _side(theta)
    axis = np.array([side * SKETCH_AXIS[0], z_axis])
    target = np.array([side * SKETCH_TARGET[0], SKETCH_TARGET[1]])
    angle = _gaze_angle(target - axis, offset)
    along = np.array([-np.cos(angle), np.sin(angle)])
    foot = axis + offset * np.array([np.sin(angle), np.cos(angle)])
    end = target + 0.5 * along
    axes.set_title("Symbols (not to scale)")
    axes.annotate("", (0, 3.1), (0, -0.3), arrowprops=_AXIS_ARROW)
    head, tail = (2.3, -0.3) if side > 0 else (0.75, -2.3)
    axes.annotate("", (head, 0), (tail, 0), arrowprops=_AXIS_ARROW)
    axes.annotate("X", (head, -0.2), color=GREY, ha="right", fontsize=8)
    axes.annotate("Z", (-0.07, 3.0), color=GREY, ha="right", fontsize=8)
    axes.plot(*np.stack([np.zeros(2), target]).T, color=VERMILLION)
    axes.plot(*np.stack([foot - 0.5 * along, end]).T, color=BLUE)
    _camera(axes, (0.0, 0.0), 0.0, "C1", (-0.32 * side, -0.2))
    outside = side * offset > 0
    beside = (0.42 * side, 0.02) if outside else (-0.3 * side, -0.28)
    _camera(axes, _xy(foot), np.pi / 2 - angle, "C2", beside)
    axes.plot(*axis, "o", color=BLACK, ms=6, zorder=4)
    away, towards = ("left", "right") if side > 0 else ("right", "left")
    x, y = {1.0: (-8, -11), -1.0: (8, -11), 0.0: (10, 5)}[np.sign(side * offset)]
    ends = towards if outside else away
    axes.annotate("yaw axis", _xy(axis), (side * x, y), ha=ends, **_BESIDE)
    axes.plot(*target, "*", color=BLACK, ms=11)
    axes.annotate("target", _xy(target), (side * 10, -2), ha=away, **_BESIDE)
    axes.annotate("gaze plane", _xy(end), (side * 8, -3), ha=away, color=BLUE, **_BESIDE)
    _angles(axes, foot, target, angle)
    _measures(axes, axis=axis, foot=foot, target=target, free=free)
    axes.set(
        xlim=(-0.85, 2.9) if side > 0 else (-2.9, 0.85),
        ylim=(-1.4, 3.15),
        aspect="equal",
        xticks=[],
        yticks=[],
    )
    # L_b and e alone are often known far less well than their sum.
    summed = () if not effective else ("baseline_mm", "eccentricity_mm")
    found = [
        f"{plain_symbol(name)} = {_mm(theta, name)}"
        for name in _DRAWN
        if name in free and name not in summed
    ]
    lines = [effective, ", ".join(found), "$α = α_2 + δ_2$, $α_2$ read by the encoder"]
    axes.set_xlabel("\n".join(line for line in lines if line))
    axes.grid(visible=False)
    for edge in ("left", "bottom"):
        axes.spines[edge].set_visible(False)


def _side(theta: FloatArray) -> float:
    """Return 1 where C2 stands at +X of C1, -1 where it stands at -X."""
    return -1.0 if theta[INDEX["baseline_mm"]] < 0 else 1.0


def _gaze_angle(arm: FloatArray, offset: float) -> float:
    """Return alpha of the plane that holds the end of `arm` and passes its start at `offset`."""
    return float(np.pi - np.arctan2(arm[1], arm[0]) - np.arcsin(offset / np.hypot(*arm)))


_DRAWN = ("baseline_mm", "axis_z_mm", "eccentricity_mm")
_AXIS_ARROW = {"arrowstyle": "-|>", "color": LIGHT, "lw": 1.0}
_BESIDE: Any = {"textcoords": "offset points", "fontsize": 8}


def _xy(point: FloatArray) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _sign(theta: FloatArray, name: str, free: tuple[str, ...]) -> float:
    """Return the sign to draw a parameter with, 0 where the model does not have it."""
    if name not in free:
        return 0.0
    return 1.0 if theta[INDEX[name]] >= 0 else -1.0


def _camera(
    axes: Axes, place: tuple[float, float], turn: float, name: str, label: tuple[float, float]
) -> None:
    """Draw a camera whose centre is at `place`, looking along Z turned by `turn` towards -X."""
    body = Polygon(
        [(0, 0), (-0.13, -0.26), (0.13, -0.26)], closed=True, fc="white", ec=BLACK, lw=1.2
    )
    body.set_transform(Affine2D().rotate(turn).translate(*place) + axes.transData)
    body.set_zorder(3)
    axes.add_patch(body)
    axes.annotate(name, (place[0] + label[0], place[1] + label[1]), weight="bold", ha="center")


def _angles(axes: Axes, foot: FloatArray, target: FloatArray, angle: float) -> None:
    """Mark alpha (from -X to the gaze plane) and alpha1 (from Z to C1's ray)."""
    gaze = float(np.rad2deg(np.pi - angle))
    axes.plot([foot[0] - 0.8, foot[0]], [foot[1]] * 2, color=GREY, lw=0.8, ls=":")
    axes.add_patch(Arc(_xy(foot), 1.2, 1.2, theta1=gaze, theta2=180, color=BLUE))
    axes.annotate("$α$", (foot[0] - 0.34, foot[1] + 0.2), color=BLUE)
    ray = float(np.rad2deg(np.arctan2(target[1], target[0])))
    low, high = sorted((ray, 90.0))
    axes.add_patch(Arc((0, 0), 3.0, 3.0, theta1=low, theta2=high, color=VERMILLION))
    x, where = (0.08, "left") if ray < 90 else (-0.08, "right")
    axes.annotate("$α_1$", (x, 1.58), color=VERMILLION, fontsize=8, ha=where)


def _measures(
    axes: Axes,
    *,
    axis: FloatArray,
    foot: FloatArray,
    target: FloatArray,
    free: tuple[str, ...],
) -> None:
    """Draw the lengths L_b, Z_a, e and z."""
    level, out = -1.2, float(np.sign(axis[0]))
    for x, top in ((0.0, 0.0), (axis[0], axis[1])):
        axes.plot([x, x], [top, level], **_HELPER)
    _length(axes, (0, level), (axis[0], level), "$L_b$", (0, 7))
    if "axis_z_mm" in free:
        side = 2.45 * out
        axes.plot([axis[0], side], [axis[1]] * 2, **_HELPER)
        _length(axes, (side, 0), (side, axis[1]), "$Z_a$", (4 * out, 0))
    if "eccentricity_mm" in free:
        axes.plot(*np.stack([axis, foot]).T, color=GREEN, lw=2.4, zorder=3)
        outside = out * (foot[0] - axis[0]) > 0
        middle, shift = (axis + foot) / 2, (-0.02, -0.24) if outside else (0.0, 0.1)
        axes.annotate("$e$", _xy(middle + np.array(shift)), color=GREEN)
    _length(axes, (-0.5 * out, 0), (-0.5 * out, target[1]), "$z$", (-5 * out, 0))
    axes.plot([-0.5 * out, target[0]], [target[1]] * 2, **_HELPER)


_HELPER: Any = {"color": GREY, "lw": 0.6, "ls": "--"}


def _mm(theta: FloatArray, name: str) -> str:
    return signed(f"{theta[INDEX[name]]:.1f} mm")


def _length(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    text: str,
    shift: tuple[float, float],
) -> None:
    """Draw a dimension line with its text beside the middle."""
    axes.annotate(
        "",
        end,
        start,
        arrowprops={"arrowstyle": "<|-|>", "color": GREY, "lw": 0.9, "shrinkA": 0, "shrinkB": 0},
    )
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    upright = start[0] == end[0]
    axes.annotate(
        text,
        middle,
        shift,
        textcoords="offset points",
        ha="center" if not upright else "right" if shift[0] < 0 else "left",
        va="center",
        fontsize=8,
    )


def _plan(axes: Axes, rows: Observations, theta: FloatArray) -> None:
    """Draw targets, rays of C1 and lines from the yaw axis, to scale."""
    axis = np.array([theta[INDEX["baseline_mm"]], theta[INDEX["axis_z_mm"]]])
    places = np.stack([rows.x1c * rows.z_mm, rows.z_mm], axis=1)
    for x, z in places[thinned(len(rows), RAYS)]:
        axes.plot([0, x], [0, z], color=VERMILLION, lw=0.7, alpha=0.6)
        axes.plot([axis[0], x], [axis[1], z], color=BLUE, lw=0.7, alpha=0.6)
    many = len(rows) > RAYS
    axes.plot(*places.T, "*", color=BLACK, ms=4 if many else 8, rasterized=many)
    axes.plot(0, 0, "^", color=VERMILLION, ms=8)
    axes.plot(*axis, "o", color=BLUE, ms=6)
    side = _side(theta)
    away, towards = ("left", "right") if side > 0 else ("right", "left")
    axes.annotate("C1", (0, 0), (-7 * side, -3), textcoords="offset points", ha=towards)
    axes.annotate(
        "yaw axis", _xy(axis), (7 * side, -3), textcoords="offset points", fontsize=8, ha=away
    )
    axes.set_title("Targets of the gaze rows (to scale)")
    axes.set(xlabel="X / mm", ylabel="Z / mm", aspect="equal", adjustable="datalim")
    axes.margins(0.12, 0.06)
