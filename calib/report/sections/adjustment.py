"""The adjustment of all pictures, beside what lenses, pairs, sweep and rows give one by one."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.images.adjustment.result import AdjustedModel, Adjustment
from calib.instrument.adjusted import ADJUSTMENT
from calib.instrument.calibrated import DepthTable
from calib.report.blocks import (
    EMPTY,
    Block,
    Cell,
    Chapter,
    DefinitionList,
    Items,
    Notice,
    Paragraph,
    Table,
    facts,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.numbers import (
    decimals,
    digits,
    estimate,
    factor,
    meaning,
    plus_minus,
    symbol,
    unit,
)
from calib.results.calibration import Calibration, GazeResult
from calib.uncertainty.format import fixed

_KINDS = {"lens": "for the lens", "pair": "in pairs", "row": "of rows", "sweep": "of the sweep"}


def adjustment(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the adjustment."""
    if c.not_adjusted is not None:
        reason = Notice("bad", "There is none", c.not_adjusted)
        return Chapter("adjustment", "Adjustment of all pictures", (reason,))
    found = c.adjustment
    if found is None:
        return None
    blocks: list[Block] = [
        Paragraph(
            "All pictures of the board in one least squares: both lenses, one deformation of the "
            "board, a pose of it for each view, the yaw axis, C2's place on it, the encoder and "
            "the error of each reading. A pair is two pictures of one board with C2 at its "
            "reading, a picture of the sweep is C2 alone at a reading, a gaze row with both "
            "pictures is a pair at its own reading."
        ),
    ]
    gaze = c.gaze
    if gaze is not None and gaze.choice is not None:
        blocks.append(_choice(gaze))
    blocks.append(_parameters(found.complete, gaze))
    if gaze is not None and gaze.by_rows is not None and gaze.by_adjustment is not None:
        blocks.append(_depths(gaze.by_rows.depths, gaze.by_adjustment.depths))
    blocks.append(_facts(found))
    if found.contradicted:
        blocks += [
            Paragraph("Models that hold parameters at zero and that the pictures contradict:"),
            Items(tuple(f"{name}: {why}" for name, why in found.contradicted.items())),
        ]
    blocks += [
        Notice("bad", f"Failed: {gate.name}", gate.detail)
        for gate in found.gates
        if not gate.passed
    ]
    return Chapter("adjustment", "Adjustment of all pictures", tuple(blocks))


def _choice(gaze: GazeResult) -> Paragraph:
    choice = gaze.choice
    by = "" if choice is None else choice.method
    reason = "" if choice is None else choice.reason
    what = "this adjustment" if by == ADJUSTMENT else "the gaze rows"
    return Paragraph(
        Markup(
            "The instrument, and with it what is certified and validated, is taken from "
            "<strong>{}</strong>: {}. The rule: from the adjustment where its gates pass and the "
            "rows agree with it. <code>--method</code> of "
            "<code>calib calibrate</code> chooses, <code>--model rows</code> or <code>adjustment"
            "</code> of <code>calib measure</code> measures with either."
        ).format(what, reason)
    )


def _parameters(record: AdjustedModel, gaze: GazeResult | None) -> Table:
    """Return the parameters beside those of the rows' selected model."""
    rows: dict[str, tuple[float, float]] = {}
    selected = None if gaze is None or gaze.comparison is None else gaze.comparison.selected
    if gaze is not None and selected is not None:
        p = gaze.posterior[selected]
        u = np.sqrt(np.diag(p.covariance))
        rows = {n: (float(v), float(s)) for n, v, s in zip(p.names, p.mean, u, strict=True)}
    std = np.sqrt(np.diag(record.covariance))
    lines = []
    for name, value, u in zip(record.names, record.values, std, strict=True):
        own = estimate(float(value), float(u), factor=factor(name))
        beside: tuple[Cell, Cell, Cell] = (EMPTY, EMPTY, EMPTY)
        if name in rows:
            other, other_u = rows[name]
            together = (float(value) - other) / float(np.hypot(u, other_u))
            beside = (
                estimate(other, other_u, factor=factor(name)),
                decimals(together, 1),
                digits(other_u / float(u), 2),
            )
        lines.append((words(symbol(name)), words(meaning(name)), own, *beside, words(unit(name))))
    return table(
        "Parameters by the adjustment and by the rows",
        (
            "Symbol",
            "Meaning",
            "Adjustment ± u",
            f"Rows{f', {selected}' if selected else ''} ± u",
            "Difference / u",
            "u rows / u adjustment",
            "Unit",
        ),
        lines,
    )


_SHOWN_DEPTHS = 5


def _depths(rows: DepthTable, adjusted: DepthTable) -> Table:
    """Return the depth uncertainty by both, and what of it is the calibration's own part."""
    count = min(len(rows.depth_mm), len(adjusted.depth_mm))
    lines = []
    for i in np.unique(np.linspace(0, count - 1, _SHOWN_DEPTHS).round().astype(int)):
        own = [_calibration_part(found, int(i)) for found in (rows, adjusted)]
        lines.append(
            (
                decimals(float(adjusted.depth_mm[i]), 0),
                digits(float(rows.prediction.u_mm[i]), 2),
                digits(float(adjusted.prediction.u_mm[i]), 2),
                digits(own[0], 2),
                digits(own[1], 2),
                digits(own[1] / own[0], 2),
            )
        )
    return table(
        "What the adjustment gains in depth",
        (
            "Depth, mm",
            "u by rows, mm",
            "u by adjustment, mm",
            "calibration's part, rows",
            "calibration's part, adjustment",
            "ratio",
        ),
        lines,
    )


_READING = ("x1c", "y1c", "alpha2", "gaze residual")


def _calibration_part(found: DepthTable, i: int) -> float:
    """Return what parameters, lenses and pose contribute to u(z), without the reading's errors."""
    parts = [u[i] for name, u in found.sources_mm.items() if name.partition(",")[0] not in _READING]
    return float(np.sqrt(np.sum(np.square(parts))))


def _facts(a: Adjustment) -> DefinitionList:
    counts = [
        f"{sum(1 for x, k in zip(a.camera, a.kinds, strict=True) if x == c and k == kind)} {text}"
        for c in (0, 1)
        for kind, text in _KINDS.items()
        if any(x == c and k == kind for x, k in zip(a.camera, a.kinds, strict=True))
    ]
    first = sum(
        1
        for kind in _KINDS
        if any(k == kind and x == 0 for x, k in zip(a.camera, a.kinds, strict=True))
    )
    record = a.complete
    shift = record.pose_12[3:]
    distance = float(np.linalg.norm(shift))
    u = float(np.sqrt(shift @ record.pose_covariance[3:, 3:] @ shift)) / distance
    warp = ", ".join(decimals(b, 2).text for b in record.board_warp_mm)
    left = f"; left out: {', '.join(a.left_out)}" if a.left_out else ""
    return facts(
        ("Pictures of C1", ", ".join(counts[:first])),
        ("Pictures of C2", ", ".join(counts[first:])),
        (
            "rms residual",
            f"{fixed(a.rms_px, 3)} px; {int(a.rejected.sum())} corners rejected{left}",
        ),
        (
            "Error of a reading",
            f"{digits(np.degrees(a.reading_std_rad), 2).text}° as the pictures show it, "
            f"{digits(np.degrees(a.stated_reading_rad), 2).text}° stated",
        ),
        (
            f"Distance of the centres at {np.degrees(record.reading_rad):.1f}°",
            f"{plus_minus(distance, u)} mm",
        ),
        ("Deformation of the board", f"{warp} mm"),
        (
            "Views contradict each other",
            f"by {np.sqrt(record.factors[2]):.2f} times what corner noise explains, in the rig",
        ),
    )
