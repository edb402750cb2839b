"""What the instrument measures on rows that no fit has seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from calib.core.arrays import FloatArray
from calib.instrument.validation import ValidationResult, normalised_error, spread_by_group
from calib.report.blocks import Block, Cell, Chapter, Paragraph, Table, Text, number, table, words
from calib.report.context import ReportContext
from calib.report.figures.validation import draw_agreement, draw_consistency
from calib.report.numbers import (
    bounds,
    decimals,
    digits,
    estimate,
    given,
    percent,
    places,
    rounded_up,
    with_sign,
)
from calib.report.plotting import picture
from calib.report.sections.pick import contrasted, instrument_of_record, shown_rows
from calib.results.calibration import Calibration
from calib.results.wording import LENGTHS_NOTE
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.format import significant
from calib.uncertainty.lengths import LengthError


def validation(c: Calibration, context: ReportContext) -> Chapter | None:
    """Write the validation."""
    if c.gaze is None or c.gaze.validation is None or c.gaze.comparison is None:
        return None
    v = c.gaze.validation
    names = {"reference": context.validation_reference or "the reference"}
    blocks: list[Block] = [
        Paragraph(_summary(v, names, instrument_of_record(c.gaze))),
        _agreement(v, names),
        picture(
            "validation",
            draw_agreement(v, names),
            "Error of each measured depth against each reference; bars are the 95 % intervals of "
            "the measurement, without the reference's own uncertainty. Errors of one sign "
            "throughout mean that validation and calibration rest on different references; errors "
            "that grow with depth, a wrong baseline or encoder zero.",
        ),
        *_consistency(v, tuple(fit.model for fit in contrasted(c.gaze))),
        _rows(v, names),
        *_lengths(c.gaze.evidence),
    ]
    return Chapter("validation", "Validation", tuple(blocks))


def _summary(v: ValidationResult, names: Mapping[str, str], by: Markup) -> Text:
    shared = any(i != k for i, k in enumerate(v.depth_of))
    borrowed = (
        " Some rows use the measured depth of another row, as the table asks (depth_row)."
        if shared
        else ""
    )
    told = "; ".join(
        f"against {names.get(e.name, e.name)}, {significant(100 * e.rms_rel, digits=2)} % root "
        f"mean square and {with_sign(100 * e.mean_rel)} % on average"
        for e in v.errors
    )
    return Markup(
        "{} rows that no fit has seen were measured with {}.{} Errors of depth: {}. A "
        "calibration inherits its reference: where two references disagree with each other, it can "
        "agree with one only."
    ).format(len(v.ids), by, borrowed, told)


def _agreement(v: ValidationResult, names: Mapping[str, str]) -> Table:
    rows = [
        (
            words(names.get(e.name, e.name)),
            number(str(int(np.isfinite(e.error_rel).sum())), float(np.isfinite(e.error_rel).sum())),
            percent(e.rms_rel),
            percent(e.mean_rel),
        )
        for e in v.errors
    ]
    heads = ("Reference", "Rows", "Root mean square error / %", "Mean error / %")
    return table("Agreement with each reference", heads, rows)


def _consistency(v: ValidationResult, models: tuple[str, ...]) -> list[Block]:
    """Return the spread of depth over each group, by each row's own angle."""
    groups = spread_by_group(v)
    if not groups or not models:
        return []
    rows = [
        (
            words(g.group),
            number(str(g.count), g.count),
            decimals(g.depth_mm, 0),
            *(digits(g.spread_mm[model], 2) for model in models),
        )
        for g in groups
    ]
    heads = ["Group", "Rows", "Reference depth / mm"]
    heads += [f"spread under {model} / mm" for model in models]
    return [
        Paragraph(
            "A test of the geometry that needs no absolute reference: each row of a group measured "
            "by its own angle. The rows of a group share one placement of the board, so depth less "
            "reference should come out the same for all of them."
        ),
        table(
            "Spread within groups, each row by its own angle",
            heads,
            rows,
            note="Standard deviation of (depth by own angle − reference) over the rows of a group.",
        ),
        picture(
            "consistency",
            draw_consistency(v, models),
            "Depth by each row's own angle less its reference. Within a group the points of a good "
            "model lie level; a slope from one side of the board to the other is a misplaced yaw "
            "axis.",
        ),
    ]


def _lengths(evidence: Evidence | None) -> list[Block]:
    """Return errors of measured lengths, where reference lengths are known."""
    if evidence is None or not evidence.lengths:
        return []
    rows = [
        (
            words(e.name),
            given(e.reference_mm, e.standard_uncertainty_mm),
            given(e.measured_mm, e.standard_uncertainty_mm),
            estimate(e.error_mm, e.standard_uncertainty_mm, mark=_beyond(e)),
            rounded_up(e.expanded_uncertainty_mm),
        )
        for e in evidence.lengths
    ]
    heads = ("Length", "reference / mm", "measured / mm", "error ± u / mm", "U of the error / mm")
    limit = evidence.length_limit
    told = LENGTHS_NOTE
    if limit is not None:
        told += (
            f" Here A = {rounded_up(limit.constant_mm).text} mm and "
            f"K = {rounded_up(limit.slope).text}."
        )
    return [table("Lengths between two measured points", heads, rows, note=told, sortable=True)]


def _beyond(error: LengthError) -> str:
    return "bad" if abs(error.error_mm) > error.expanded_uncertainty_mm else ""


def _rows(v: ValidationResult, names: Mapping[str, str]) -> Table:
    picked, note = shown_rows(len(v.ids))
    heads = ["Row", "Group", "x / mm", "y / mm", "z measured ± u / mm", "95 % interval of z / mm"]
    for e in v.errors:
        name = names.get(e.name, e.name)
        heads += [f"{name} / mm", f"error against {name} / %"]
    scores = {e.name: normalised_error(v.prediction, e) for e in v.errors}
    rows = [_row(v, scores, i) for i in picked]
    if v.groups == v.ids:
        heads.remove("Group")
    told = (
        "Marked: |error| above the expanded uncertainty of the difference, the reference's own as "
        "stated included (E_n > 1)."
    )
    return table("Validation rows", heads, rows, note=f"{told} {note}".strip(), sortable=True)


def _row(v: ValidationResult, scores: Mapping[str, FloatArray], i: int) -> tuple[Cell, ...]:
    p, (x, y, _) = v.prediction, v.position_mm[i]
    cells = [
        words(v.ids[i]),
        *(() if v.groups == v.ids else (words(v.groups[i]),)),
        decimals(x, 1),
        decimals(y, 1),
        estimate(p.z_mm[i], p.u_mm[i]),
        bounds(p.low95_mm[i], p.high95_mm[i], p.u_mm[i]),
    ]
    for e in v.errors:
        apart = scores[e.name][i] > 1
        count = places(100 * e.error_rel)
        error = decimals(100 * e.error_rel[i], count, mark="bad" if apart else "")
        cells += [given(e.reference_mm[i], p.u_mm[i]), error]
    return tuple(cells)
