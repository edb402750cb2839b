"""The uncertainty budget of JCGM 100 (GUM): a table whose shares add up to 100 %.

The engine is the jacobian times the covariance: u² = Σ_i c_i² u_i² + 2 Σ_{i<j} c_i c_j u_i u_j r_ij
(JCGM 100, eq. 16). Each product of a correlated pair is a row of its own, with its sign: parameters
of one fit are often so strongly correlated that their own shares add up to far more than 100 %.

Effective degrees of freedom. The Welch-Satterthwaite formula (JCGM 100, eq. G.2b) holds for
independent inputs. Inputs estimated together by one fit are not independent of each other, but
their joint contribution is a linear combination of one multivariate estimate whose covariance has
one number of degrees of freedom; such a *set* therefore enters the formula as one component
(Willink 2007, Metrologia 44, 340, doi 10.1088/0026-1394/44/5/010). Where inputs of different sets
are correlated, where a set mixes degrees of freedom or where an input's are unknown (a posterior
that mixes data and prior), no effective number exists and none is given; nor is a coverage factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray

COVERAGE = 0.95
"""Coverage probability of all intervals."""

CORRELATION_FLOOR = 1e-9
"""Correlations below this are rounding errors of the covariance: they get no row."""


@dataclass(frozen=True)
class InputQuantity:
    """An input of the measurement model with its uncertainty.

    Parameters
    ----------
    name
        As printed.
    estimate, standard_uncertainty
        In `unit`.
    evaluation
        "A" (by statistics), "B" (by other means) or "A, B" (a posterior of data and prior).
    distribution
        As printed: "normal", "rectangular", "Student t", "posterior".
    degrees_of_freedom
        math.inf for a known uncertainty; None where the number is not defined.
    sensitivity
        Partial derivative of the result by this input, result unit per `unit`.
    estimated_with
        Inputs of one multivariate estimate share this label; None for an independent input.
    conditional
        Whether the uncertainty is what remains once the inputs before it in the estimate are known.
    """

    name: str
    estimate: float
    unit: str
    standard_uncertainty: float
    evaluation: str
    distribution: str
    degrees_of_freedom: float | None
    sensitivity: float
    estimated_with: str | None = None
    conditional: bool = False


@dataclass(frozen=True)
class BudgetRow:
    """An input with what it contributes.

    Parameters
    ----------
    input
        The input quantity.
    contribution
        |c_i| u_i, in the unit of the result.
    share_percent
        100 c_i² u_i² / u².
    """

    input: InputQuantity
    contribution: float
    share_percent: float


@dataclass(frozen=True)
class CorrelationRow:
    """A correlated pair of inputs with what the correlation adds or takes away.

    Parameters
    ----------
    first, second
        Names of the inputs.
    correlation
        r_ij.
    share_percent
        100 · 2 c_i c_j u_i u_j r_ij / u²; negative where errors of the two cancel.
    """

    first: str
    second: str
    correlation: float
    share_percent: float


@dataclass(frozen=True)
class Budget:
    """An uncertainty budget.

    Parameters
    ----------
    quantity, estimate, unit
        The result.
    standard_uncertainty
        Combined standard uncertainty, in `unit`.
    rows, correlations
        The table; the shares of both together add up to 100 %.
    degrees_of_freedom
        Effective number, None where the formula does not hold.
    freedom_note
        Why there is one or none, as printed.
    coverage_factor, expanded_uncertainty
        For 95 %; None without effective degrees of freedom.
    """

    quantity: str
    estimate: float
    unit: str
    standard_uncertainty: float
    rows: tuple[BudgetRow, ...]
    correlations: tuple[CorrelationRow, ...]
    degrees_of_freedom: float | None
    freedom_note: str
    coverage_factor: float | None
    expanded_uncertainty: float | None

    @property
    def sources(self) -> tuple[tuple[str, float], ...]:
        """Sources of the uncertainty with their contributions, in `unit`, in the order of the rows.

        Inputs estimated together are one source, under their label, their correlations included.
        Where separate inputs are not correlated, the sources add up in quadrature.
        """
        source_of = {
            row.input.name: row.input.estimated_with or row.input.name for row in self.rows
        }
        share = dict.fromkeys(source_of.values(), 0.0)
        for row in self.rows:
            share[source_of[row.input.name]] += row.share_percent
        for pair in self.correlations:
            if source_of[pair.first] == source_of[pair.second]:
                share[source_of[pair.first]] += pair.share_percent
        return tuple(
            (name, self.standard_uncertainty * math.sqrt(max(percent, 0.0) / 100))
            for name, percent in share.items()
        )


def budget(
    *,
    quantity: str,
    estimate: float,
    unit: str,
    inputs: Sequence[InputQuantity],
    correlation: FloatArray,
) -> Budget:
    """Return the budget of a result.

    Parameters
    ----------
    quantity, estimate, unit
        The result.
    inputs
        The k inputs.
    correlation
        Their correlation matrix, shape (k, k).

    Raises
    ------
    ValueError
        If no input has any uncertainty: a budget without one would claim perfection.
    """
    signed = np.array([q.sensitivity * q.standard_uncertainty for q in inputs])
    terms = correlation * np.outer(signed, signed)
    variance = float(terms.sum())
    if not variance > 0:
        raise ValueError("a budget needs inputs with uncertainty; all contributions are zero")
    share = 100 * terms / variance
    rows = tuple(
        BudgetRow(q, abs(float(signed[i])), float(share[i, i])) for i, q in enumerate(inputs)
    )
    pairs = tuple(
        CorrelationRow(
            inputs[i].name, inputs[j].name, float(correlation[i, j]), float(2 * share[i, j])
        )
        for i in range(len(inputs))
        for j in range(i + 1, len(inputs))
        if abs(correlation[i, j]) > CORRELATION_FLOOR
    )
    freedom, note = _effective_freedom(inputs, correlation, terms)
    factor = None if freedom is None else coverage_factor(freedom)
    u = math.sqrt(variance)
    return Budget(
        quantity=quantity,
        estimate=estimate,
        unit=unit,
        standard_uncertainty=u,
        rows=rows,
        correlations=pairs,
        degrees_of_freedom=freedom,
        freedom_note=note,
        coverage_factor=factor,
        expanded_uncertainty=None if factor is None else factor * u,
    )


def coverage_factor(degrees_of_freedom: float) -> float | None:
    """Return t_95 of the next lower integer number of degrees of freedom (JCGM 100, G.4.1 note 1).

    None below one degree of freedom, where the formula says nothing.
    """
    if degrees_of_freedom < 1:
        return None
    from scipy.special import stdtrit

    # Rounding errors must not turn five degrees of freedom into four.
    whole = math.floor(degrees_of_freedom + 1e-9) if math.isfinite(degrees_of_freedom) else math.inf
    return float(stdtrit(whole, (1 + COVERAGE) / 2))


def _sets(inputs: Sequence[InputQuantity]) -> list[list[int]]:
    """Return the places of inputs estimated together; each independent input is its own set."""
    found: dict[str, list[int]] = {}
    for i, q in enumerate(inputs):
        found.setdefault(q.estimated_with or f"\0{i}", []).append(i)
    return list(found.values())


def _effective_freedom(
    inputs: Sequence[InputQuantity], correlation: FloatArray, terms: FloatArray
) -> tuple[float | None, str]:
    """Return the effective degrees of freedom, or None, and why.

    Parameters
    ----------
    terms
        c_i c_j u_i u_j r_ij, shape (k, k).
    """
    sets = _sets(inputs)
    across = np.ones_like(correlation, dtype=bool)
    for places in sets:
        across[np.ix_(places, places)] = False
    if np.any(across & (np.abs(terms) > CORRELATION_FLOOR * terms.sum())):
        return None, "not defined: inputs that were estimated separately are correlated"
    denominator = 0.0
    for places in sets:
        part = float(terms[np.ix_(places, places)].sum())
        freedoms = {inputs[i].degrees_of_freedom for i in places if terms[i, i] > 0}
        if not freedoms:
            continue
        if len(freedoms) > 1:
            return None, "not defined: one estimate mixes inputs of different degrees of freedom"
        freedom = freedoms.pop()
        if freedom is None:
            return None, (
                "not defined: the parameters come from data and prior knowledge together, or from "
                "a robust fit"
            )
        denominator += part**2 / freedom
    if denominator == 0:
        return math.inf, "all input uncertainties are taken as known"
    together = any(len(places) > 1 for places in sets)
    note = (
        "Welch-Satterthwaite; jointly fitted parameters enter as one component (Willink 2007)"
        if together
        else "Welch-Satterthwaite"
    )
    return float(terms.sum()) ** 2 / denominator, note
