"""The annex of the uncertainty budgets: a summary by source, then a table for each depth."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calib.certificate.budget_lines import budget_lines, count
from calib.certificate.data import NONE, Annex, AnnexTable, BudgetLine
from calib.certificate.numbers import depth_line
from calib.geometry.parameters import GAZED_BASELINE
from calib.results.wording import CAMERA_LINES, GROUP_LINE
from calib.uncertainty.budget import Budget
from calib.uncertainty.certified import CertifiedDepth
from calib.uncertainty.depth import DepthUncertainty
from calib.uncertainty.format import fixed, with_uncertainty
from calib.uncertainty.measurement import PARAMETERS_LABEL

SLIGHT_PERCENT = 0.05
"""Inputs with a smaller share, which would print as 0.0, are summed in one row."""


def budgets(
    depths: Sequence[CertifiedDepth], *, mean_gaze_rad: float, cameras: bool, groups: bool
) -> Annex | None:
    """Return the budgets.

    Parameters
    ----------
    mean_gaze_rad
        Reading at which the effective baseline is taken.
    cameras, groups
        Whether intrinsics or pose, and reference depths of several rows, have a line in them.
    """
    if not depths:
        return None
    introduction = (
        "JCGM 100. Sensitivities are derivatives of depth at the stated ray; shares add up to "
        "100 % before rounding. "
        f"{_combined(depths[0].result.budget, mean_gaze_rad)}"
    )
    freedoms = dict.fromkeys(_freedom(d.result.budget) for d in depths)
    said = [introduction, *([CAMERA_LINES] if cameras else []), *([GROUP_LINE] if groups else [])]
    # What holds for all depths is said once.
    said += freedoms if len(freedoms) == 1 else []
    notes = [_freedom(d.result.budget) if len(freedoms) > 1 else "" for d in depths]
    return Annex(
        title="Uncertainty budgets",
        introduction=" ".join(said),
        tables=(
            _sources(depths),
            *(_budget(d.result, note) for d, note in zip(depths, notes, strict=True)),
        ),
    )


def _combined(b: Budget, mean_gaze_rad: float) -> str:
    """Return in which combinations the parameters enter."""
    names = [row.input.name for row in b.rows]
    first = ""
    if GAZED_BASELINE in names:
        first = (
            f"the effective baseline at the mean gaze of the calibration rows, "
            f"α = {fixed(math.degrees(mean_gaze_rad), 1)}°, and "
        )
    return (
        "The parameters enter by quantities that are independent of each other: "
        f"{first}what remains uncertain of each parameter once the lines above it are known; the "
        "sensitivity is that along such a quantity, which those below it follow. The "
        "parameters as such have their covariance in the annex of the parameters."
    )


def _sources(depths: Sequence[CertifiedDepth]) -> AnnexTable:
    """Return what each source contributes at each depth."""
    lines = [depth_line(d) for d in depths]
    found = [{e.label: e.value for e in line.contributions} for line in lines]
    names = dict.fromkeys(name for column in found for name in column)
    together = [with_uncertainty(0.0, d.result.budget.standard_uncertainty) for d in depths]
    return AnnexTable(
        title="Contributions to u(z), mm",
        columns=("Source", *(f"at {line.depth.value} mm" for line in lines)),
        rows=(
            *((name, *(column.get(name, NONE) for column in found)) for name in names),
            ("together", *(u.uncertainty for u in together)),
        ),
        note="The sources are independent of each other and add up in quadrature.",
    )


def _budget(r: DepthUncertainty, note: str) -> AnnexTable:
    b = r.budget
    rows = _rows(budget_lines(b))
    u = with_uncertainty(b.estimate, b.standard_uncertainty)
    rows.append(("depth z", f"{u.value} mm", f"{u.uncertainty} mm", *[NONE] * 5, "100.0"))
    return AnnexTable(
        title=f"Depth {u.value} mm at x1c = {fixed(r.x1c, 3)}",
        columns=(
            "Quantity", "Estimate", "u", "Type", "Distribution", "ν", "Sensitivity",
            "|c| u / mm", "Share / %",
        ),
        rows=tuple(rows),
        note=f"{_together(b)} {note}".strip(),
        words=(0, 3, 4),
    )  # fmt: skip


def _rows(lines: Sequence[BudgetLine]) -> list[tuple[str, ...]]:
    """Return a row a line; those without weight share one, unless they are parameters."""
    slight = [li for li in lines if li.share_percent < SLIGHT_PERCENT and not li.of_parameters]
    rows = [_row(line) for line in lines if line not in slight]
    if slight:
        words = f"{len(slight)} further input{'s' * (len(slight) > 1)}"
        share = sum(line.share_percent for line in slight)
        rows.append((words, *[NONE] * 7, fixed(share, 1)))
    return rows


def _row(line: BudgetLine) -> tuple[str, ...]:
    unit = "" if line.unit == "1" else f" {line.unit}"
    per = "mm" if line.unit == "1" else f"mm/{line.unit}"
    return (
        line.quantity,
        line.estimate + unit,
        line.standard_uncertainty + unit,
        line.evaluation,
        line.distribution,
        line.freedom,
        f"{line.sensitivity} {per}",
        line.contribution,
        line.share,
    )


def _together(b: Budget) -> str:
    """Return the share of the parameters as a whole."""
    part = dict(b.sources).get(PARAMETERS_LABEL, 0.0)
    share = fixed(100 * (part / b.standard_uncertainty) ** 2, 1)
    return f"The parameters together: {share} %."


def _freedom(b: Budget) -> str:
    if b.coverage_factor is None or b.degrees_of_freedom is None:
        return (
            f"Effective degrees of freedom {b.freedom_note}: they give no coverage factor; that of "
            "the results is from the Monte Carlo distribution."
        )
    return (
        f"Effective degrees of freedom {count(b.degrees_of_freedom)} ({b.freedom_note}); "
        f"k = {fixed(b.coverage_factor, 2)} for 95 %."
    )
