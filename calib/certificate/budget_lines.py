"""The lines of an uncertainty budget, as all forms of the certificate print them."""

from __future__ import annotations

import math

from calib.certificate.data import NONE, BudgetLine
from calib.geometry.parameters import GAZED_BASELINE, INDEX, PARAMETERS
from calib.uncertainty.budget import Budget, BudgetRow
from calib.uncertainty.format import SHOWN, fixed, significant, with_uncertainty

GAZED_SYMBOL = "L_b + e / sin α"
"""Of the effective baseline at the mean gaze; the annex of budgets says which α."""

KNOWN = ", above known"
"""Of a quantity whose uncertainty is what remains once those above it are known."""


def symbol(name: str) -> str:
    """Return the symbol of a parameter, or the name of another input."""
    if name == GAZED_BASELINE:
        return GAZED_SYMBOL
    if name in INDEX:
        return PARAMETERS[INDEX[name]].symbol
    return name.replace("alpha2", "α2")


def budget_lines(budget: Budget) -> tuple[BudgetLine, ...]:
    """Return the lines of a budget of a length in mm."""
    return tuple(_line(row) for row in budget.rows)


def _line(row: BudgetRow) -> BudgetLine:
    q, shown = row.input, SHOWN[row.input.unit]
    both = with_uncertainty(q.estimate * shown.factor, q.standard_uncertainty * shown.factor)
    slope = q.sensitivity / shown.factor
    return BudgetLine(
        quantity=symbol(q.name) + KNOWN * q.conditional,
        unit=shown.unit,
        estimate=both.value,
        standard_uncertainty=both.uncertainty,
        evaluation=q.evaluation,
        distribution=q.distribution,
        freedom=count(q.degrees_of_freedom),
        sensitivity=significant(slope),
        contribution=significant(row.contribution),
        share=fixed(row.share_percent, 1),
        numbers=(f"{slope:.2e}", f"{row.contribution:.2e}"),
        of_parameters=q.estimated_with is not None,
        share_percent=row.share_percent,
    )


def count(freedom: float | None) -> str:
    """Return degrees of freedom, rounded down."""
    if freedom is None:
        return NONE
    return "∞" if math.isinf(freedom) else str(math.floor(freedom + 1e-9))
