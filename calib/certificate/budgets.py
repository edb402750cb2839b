"""The annex of the uncertainty budgets: a summary by source, then a table for each depth."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calib.certificate.data import NONE, Annex, Table
from calib.certificate.numbers import depth_line, symbol
from calib.geometry.parameters import INDEX
from calib.results.wording import CAMERA_LINES, GROUP_LINE
from calib.uncertainty.budget import Budget, BudgetRow, CorrelationRow
from calib.uncertainty.certified import CertifiedDepth
from calib.uncertainty.depth import DepthUncertainty
from calib.uncertainty.format import SHOWN, fixed, significant, with_uncertainty
from calib.uncertainty.measurement import PARAMETERS_LABEL

NEARLY_ONE = 0.99
"""Correlations beyond it are printed with more digits."""

SLIGHT_PERCENT = 0.05
"""Inputs and pairs with a smaller share, which would print as 0.0, are summed in one row."""


def budgets(depths: Sequence[CertifiedDepth], *, cameras: bool, groups: bool) -> Annex | None:
    """Return the budgets.

    Parameters
    ----------
    cameras, groups
        Whether intrinsics or pose, and reference depths of several rows, have a line in them.
    """
    if not depths:
        return None
    introduction = (
        "JCGM 100. Sensitivities are derivatives of depth at the stated ray. A correlated pair has "
        "a row of its own, negative where errors cancel. Shares add up to 100 % before rounding."
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


def _sources(depths: Sequence[CertifiedDepth]) -> Table:
    """Return what each source contributes at each depth."""
    lines = [depth_line(d) for d in depths]
    found = [{e.label: e.value for e in line.contributions} for line in lines]
    names = dict.fromkeys(name for column in found for name in column)
    together = [with_uncertainty(0.0, d.result.budget.standard_uncertainty) for d in depths]
    return Table(
        title="Contributions to u(z), mm",
        columns=("Source", *(f"at {line.depth.value} mm" for line in lines)),
        rows=(
            *((name, *(column.get(name, NONE) for column in found)) for name in names),
            ("together", *(u.uncertainty for u in together)),
        ),
        note="The sources are independent of each other and add up in quadrature.",
    )


def _budget(r: DepthUncertainty, note: str) -> Table:
    b = r.budget
    rows = [*_input_rows(b.rows), *_pair_rows(b.correlations)]
    u = with_uncertainty(b.estimate, b.standard_uncertainty)
    rows.append(("depth z", f"{u.value} mm", f"{u.uncertainty} mm", *[NONE] * 5, "100.0"))
    return Table(
        title=f"Depth {u.value} mm at x1c = {fixed(r.x1c, 3)}",
        columns=(
            "Quantity", "Estimate", "u", "Type", "Distribution", "ν", "Sensitivity",
            "|c| u / mm", "Share / %",
        ),
        rows=tuple(rows),
        note=f"{_together(b)} {note}".strip(),
        words=(0, 3, 4),
    )  # fmt: skip


def _input_rows(inputs: Sequence[BudgetRow]) -> list[tuple[str, ...]]:
    """Return a row an input; those without weight share one, unless they are parameters."""
    weighty = [r.share_percent >= SLIGHT_PERCENT or r.input.name in INDEX for r in inputs]
    rows = [_budget_row(r) for r, shown in zip(inputs, weighty, strict=True) if shown]
    rest = [r.share_percent for r, shown in zip(inputs, weighty, strict=True) if not shown]
    return [*rows, *_further(rest, "input")]


def _further(shares: Sequence[float], what: str) -> list[tuple[str, ...]]:
    """Return one row for all that is too slight for its own, if there is any."""
    if not shares:
        return []
    words = f"{len(shares)} further {what}{'s' * (len(shares) > 1)}"
    return [(words, *[NONE] * 7, fixed(sum(shares), 1))]


def _pair_rows(pairs: Sequence[CorrelationRow]) -> list[tuple[str, ...]]:
    """Return a row a pair; those without weight share one."""
    rows = []
    for pair in pairs:
        if abs(pair.share_percent) >= SLIGHT_PERCENT:
            both = f"r({symbol(pair.first)}, {symbol(pair.second)})"
            share = fixed(pair.share_percent, 1)
            rows.append((both, _coefficient(pair.correlation), *[NONE] * 6, share))
    rest = [p.share_percent for p in pairs if abs(p.share_percent) < SLIGHT_PERCENT]
    return [*rows, *_further(rest, "pair")]


def _budget_row(row: BudgetRow) -> tuple[str, ...]:
    q, shown = row.input, SHOWN[row.input.unit]
    both = with_uncertainty(q.estimate * shown.factor, q.standard_uncertainty * shown.factor)
    unit = "" if shown.unit == "1" else f" {shown.unit}"
    per = "mm" if shown.unit == "1" else f"mm/{shown.unit}"
    return (
        symbol(q.name),
        both.value + unit,
        both.uncertainty + unit,
        q.evaluation,
        q.distribution,
        _count(q.degrees_of_freedom),
        f"{significant(q.sensitivity / shown.factor)} {per}",
        significant(row.contribution),
        fixed(row.share_percent, 1),
    )


def _coefficient(r: float) -> str:
    """Return a correlation coefficient; near one the distance from one is what matters."""
    return fixed(r, 5 if abs(r) > NEARLY_ONE else 3)


def _count(freedom: float | None) -> str:
    """Return degrees of freedom, rounded down."""
    if freedom is None:
        return NONE
    return "∞" if math.isinf(freedom) else str(math.floor(freedom + 1e-9))


def _together(b: Budget) -> str:
    """Return the share of the parameters as a whole: those of each may be huge."""
    part = dict(b.sources).get(PARAMETERS_LABEL, 0.0)
    share = fixed(100 * (part / b.standard_uncertainty) ** 2, 1)
    return f"The parameters with their correlations: {share} %."


def _freedom(b: Budget) -> str:
    if b.coverage_factor is None or b.degrees_of_freedom is None:
        return f"Effective degrees of freedom {b.freedom_note}; no coverage factor is given."
    return (
        f"Effective degrees of freedom {_count(b.degrees_of_freedom)} ({b.freedom_note}); "
        f"k = {fixed(b.coverage_factor, 2)} for 95 %."
    )
