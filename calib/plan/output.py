"""The advice as a table and as a picture."""

from __future__ import annotations

import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.plan.advise import Advice, RankedTargets
from calib.plan.prepare import PlanStart

INK, MUTED, BLUE, RED = "#1b1b1b", "#6b6b6b", "#0072B2", "#D55E00"

_LOOKS = {"G": (BLUE, "o", 60), "D": (RED, "s", 26)}
_AIM = {"G": "best for depth", "D": "best for parameters"}
_MEANING = {
    "G": "least u(z) at the asked depths",
    "D": "least uncertainty of all parameters together",
}

MANY_TIMES = 10.0
"""Ratio of the largest to the smallest u(z) beyond which a linear axis shows the small ones no
more."""

_STYLE: Any = {
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "calib",
    "svg.fonttype": "path",
}

CREATOR = "calib plan"
"""In the metadata of its pictures: a later run knows them for its own."""


def picture_format(path: Path) -> str:
    """Return "svg" or "png".

    Raises
    ------
    UsageError
        If the name asks for anything else.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("svg", "png"):
        raise UsageError(f"--out {path}: give a name that ends in .svg or .png")
    return kind


def text(advice: Advice, start: PlanStart) -> str:
    """Return the advice as a table for the terminal, with what it rests on."""
    so_far = len(start.points_mm)
    near, far = start.between_mm
    low, high = np.rad2deg(start.field.yaw_rad)
    lines = [
        f"model {advice.model}, {so_far or 'no'} row{'s' * (so_far != 1)} so far; "
        f"targets from {near:.0f} to {far:.0f} mm, readings from {low:.0f} to {high:.0f} deg",
        *(f"note: {note}" for note in start.notes),
        "",
        "u(z), mm, from the parameters alone, root mean square across C1's field",
        f"{'':10s}" + "".join(f"{f'u({z:g})':>12s}" for z in advice.depths_mm),
        _line("now", advice.before_rel, advice),
    ]
    count = len(next(iter(advice.targets.values())).points_mm)
    lines.append(_line(f"{count} random", advice.random_rel, advice))
    lines += [
        _line(f"{count} {name}-opt.", targets.u_rel[-1], advice)
        for name, targets in advice.targets.items()
    ]
    for name, targets in advice.targets.items():
        lines += ["", f"{name}-optimal targets, {_MEANING[name]}; u(z) after each, mm"]
        lines.append(
            f"{'':4s}{'x_mm':>8s}{'y_mm':>8s}{'z_mm':>8s}{'x1c':>9s}{'alpha2_deg':>12s}"
            + "".join(f"{f'u({z:g})':>12s}" for z in advice.depths_mm)
        )
        lines += _targets(advice, targets)
    return "\n".join(lines) + "\n"


def document(advice: Advice, start: PlanStart) -> dict[str, Any]:
    """Return the advice as a JSON object: depths and places in mm, u(z) relative to the depth."""
    return {
        "model": advice.model,
        "rows_so_far": len(start.points_mm),
        "notes": list(start.notes),
        "failed_gates": [asdict(gate) for gate in start.failed_gates],
        "depths_mm": advice.depths_mm.tolist(),
        "u_rel_now": advice.before_rel.tolist(),
        "u_rel_random": advice.random_rel.tolist(),
        "targets": {
            name: [
                {
                    "x_mm": float(x),
                    "y_mm": float(y),
                    "z_mm": float(z),
                    "x1c": float(targets.x1c[i]),
                    "alpha2_deg": float(np.rad2deg(targets.alpha2_rad[i])),
                    "u_rel_after": targets.u_rel[i].tolist(),
                }
                for i, (x, y, z) in enumerate(targets.points_mm)
            ]
            for name, targets in advice.targets.items()
        },
    }


def _line(name: str, u_rel: FloatArray, advice: Advice) -> str:
    return f"{name:10s}" + _figures(u_rel, advice)


def _figures(u_rel: FloatArray, advice: Advice) -> str:
    """Return u(z) of each asked depth, mm, or that it is not known where it exceeds the depth."""
    return "".join(
        f"{u * z:12.3g}" if u < 1 else f"{'unknown':>12s}"
        for u, z in zip(u_rel, advice.depths_mm, strict=True)
    )


def _targets(advice: Advice, targets: RankedTargets) -> list[str]:
    lines = []
    for i, (x, y, z) in enumerate(targets.points_mm):
        angle = np.rad2deg(targets.alpha2_rad[i])
        # Python's z: a place a hair left of the axis is 0, not -0.
        place = f"{i + 1:<4d}{x:z8.0f}{y:z8.0f}{z:8.0f}{targets.x1c[i]:z9.3f}{angle:12.2f}"
        lines.append(place + _figures(targets.u_rel[i], advice))
    return lines


def picture(advice: Advice, rows_mm: FloatArray, *, kind: str) -> bytes:
    """Return the advice drawn: where the targets stand, and what u(z) each leaves.

    Parameters
    ----------
    rows_mm
        Targets of the rows so far, frame C1, shape (n, 3).
    kind
        "svg" or "png".
    """
    buffer = io.BytesIO()
    with rc_context(_STYLE):
        figure = Figure((7.2, 3.6), layout="constrained")
        plan, progress = figure.subplots(1, 2)
        _from_above(plan, advice, rows_mm)
        _by_count(progress, advice)
        metadata = {"Date": None, "Creator": CREATOR} if kind == "svg" else {"Software": CREATOR}
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    return buffer.getvalue()


def _from_above(axes: Axes, advice: Advice, rows_mm: FloatArray) -> None:
    """Draw the targets as seen from above."""
    candidates = advice.candidates_mm
    axes.plot(candidates[:, 0], candidates[:, 2], ".", ms=1.5, color="#c8c8c8", label="possible")
    if len(rows_mm):
        axes.plot(rows_mm[:, 0], rows_mm[:, 2], "x", ms=4, color=INK, label="rows so far")
    for name, targets in advice.targets.items():
        colour, marker, size = _LOOKS[name]
        x, z = targets.points_mm[:, 0], targets.points_mm[:, 2]
        axes.scatter(x, z, s=size, marker=marker, facecolors="none", edgecolors=colour,
                     label=f"{_AIM[name]} ({name}-optimal)")  # fmt: skip
    _number(axes, advice.targets["G"])
    for i, depth in enumerate(advice.depths_mm):
        axes.axhline(depth, color=MUTED, lw=0.7, ls=":", label=None if i else "asked depth")
    axes.set_xlabel("X of C1, mm")
    axes.set_ylabel("Z of C1, mm")
    axes.legend(loc="best", fontsize=7)


def _number(axes: Axes, targets: RankedTargets) -> None:
    """Write the numbers of targets beside them, those of one place together."""
    places: dict[tuple[float, float], list[str]] = {}
    for i, (x, _, z) in enumerate(targets.points_mm):
        places.setdefault((float(x), float(z)), []).append(str(i + 1))
    for place, numbers in places.items():
        axes.annotate(
            ", ".join(numbers), place, xytext=(5, 4), textcoords="offset points",
            fontsize=7, color=_LOOKS["G"][0],
        )  # fmt: skip


def _by_count(axes: Axes, advice: Advice) -> None:
    """Draw the greatest relative u(z) at the asked depths against the number of new targets."""
    for name, targets in advice.targets.items():
        greatest = np.concatenate([[advice.before_rel.max()], targets.u_rel.max(axis=1)])
        colour, marker, _ = _LOOKS[name]
        shown = 100 * np.where(greatest < 1, greatest, np.nan)
        axes.plot(shown, marker + "-", ms=4, color=colour, label=f"{_AIM[name]} ({name}-optimal)")
    count = len(next(iter(advice.targets.values())).points_mm)
    random = advice.random_rel.max()
    if random < 1:
        axes.plot(count, 100 * random, "*", color=MUTED, label="random, median")
    axes.set_xlim(-0.04 * count, 1.04 * count)
    known = [u for t in advice.targets.values() for u in t.u_rel.max(axis=1) if u < 1]
    if known and max(known) > MANY_TIMES * min(known):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("new targets")
    axes.set_ylabel("greatest u(z) / z at the asked depths, %")
    axes.legend(loc="best", fontsize=7)
