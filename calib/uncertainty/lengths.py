"""Distances between two measured points, and their errors against reference lengths.

The two points share parameters and calibration errors, so that most of their uncertainty is common
to both and not independent; the length is propagated with the joint covariance.

The summary follows the manner of VDI/VDE 2634 part 1: the error of length indication with a limit
A + K L. It is no acceptance test: that guideline asks for 35 calibrated lengths in seven lines,
and no conformity with it is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.uncertainty.budget import Budget
from calib.uncertainty.joint import MeasuredPoints, Quantity, propagate_together, raise_first
from calib.uncertainty.measurement import Instrument, Reading
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import NORMAL_FACTOR, Draws, Interval, Results

TOGETHER = 10
"""Lengths that share trials: results of each, 24 MB at most, are held until all have settled."""


@dataclass(frozen=True)
class LengthError:
    """Error of one measured length.

    Parameters
    ----------
    name
        Of the length.
    measured_mm, reference_mm
        Length by the instrument and reference length.
    standard_uncertainty_mm
        Of the error measured - reference, reference included.
    expanded_uncertainty_mm
        Of the error, 95 %: from the farther end of the Monte Carlo interval, reference included.
    """

    name: str
    measured_mm: float
    reference_mm: float
    standard_uncertainty_mm: float
    expanded_uncertainty_mm: float

    @property
    def error_mm(self) -> float:
        """Measured minus reference."""
        return self.measured_mm - self.reference_mm

    @property
    def bound_mm(self) -> float:
        """|error| + U."""
        return abs(self.error_mm) + self.expanded_uncertainty_mm


@dataclass(frozen=True)
class LengthLimit:
    """The line A + K L above every |error| + U, as low as it can be on average.

    Parameters
    ----------
    constant_mm, slope
        A and K, neither negative.
    shortest_mm, longest_mm
        The range of reference lengths for which the line speaks.
    count
        Number of lengths.
    """

    constant_mm: float
    slope: float
    shortest_mm: float
    longest_mm: float
    count: int


@dataclass(frozen=True)
class Length:
    """A length to be measured between two points, and its reference.

    Parameters
    ----------
    name
        Of the length.
    start, end
        Readings of its ends.
    reference_mm, u_reference_mm
        Reference length with its standard uncertainty, normal.
    """

    name: str
    start: Reading
    end: Reading
    reference_mm: float
    u_reference_mm: float


def length_budget(instrument: Instrument, start: Reading, end: Reading) -> Budget:
    """Return the budget of the distance between two measured points.

    Raises
    ------
    ValueError
        If the two points coincide.
    """
    return _length_budget(MeasurementModel(instrument, [start, end]))


def _length_budget(model: MeasurementModel) -> Budget:
    first, second = model.estimate
    length = float(np.linalg.norm(second - first))
    if length == 0:
        raise ValueError("a length needs two different points")
    direction = (second - first) / length
    jacobian = model.jacobian
    sensitivity = direction @ (jacobian[1] - jacobian[0])
    return model.budget(quantity="length", estimate=length, sensitivity=sensitivity)


def _between(points: FloatArray) -> FloatArray:
    """Return distances of two points, mm, shape (t,), infinite where one of them is."""
    with np.errstate(invalid="ignore"):
        length = np.sqrt(((points[1] - points[0]) ** 2).sum(axis=0))
    return np.where(np.isfinite(length), length, np.inf)


def length_draws(
    instrument: Instrument, start: Reading, end: Reading, rng: np.random.Generator
) -> Draws:
    """Return draws of the distance between two measured points, mm."""
    return _draws(instrument, [MeasurementModel(instrument, [start, end])], rng)[0]


def _draws(
    instrument: Instrument, models: Sequence[MeasurementModel], rng: np.random.Generator
) -> list[Draws]:
    """Return draws of the distances between the two points of each model, mm."""
    results = [Results(model.blocks) for model in models]
    asked = [
        MeasuredPoints(model, (Quantity(_between, own),))
        for model, own in zip(models, results, strict=True)
    ]
    raise_first(propagate_together(instrument, asked, rng))
    return [own.draws() for own in results]


def length_errors(
    instrument: Instrument, lengths: Sequence[Length], rng: np.random.Generator
) -> tuple[LengthError, ...]:
    """Return the errors of measured lengths against their references.

    Raises
    ------
    EstimationError
        If a length is so uncertain that it has no upper limit.
    """
    found: list[LengthError] = []
    for first in range(0, len(lengths), TOGETHER):
        some = lengths[first : first + TOGETHER]
        models = [MeasurementModel(instrument, [length.start, length.end]) for length in some]
        tables = [_length_budget(model) for model in models]
        draws = _draws(instrument, models, rng)
        found += [
            _error(length, table, own.summary().symmetric)
            for length, table, own in zip(some, tables, draws, strict=True)
        ]
    return tuple(found)


def _error(length: Length, table: Budget, interval: Interval) -> LengthError:
    half = max(table.estimate - interval.low, interval.high - table.estimate)
    u_reference = length.u_reference_mm
    return LengthError(
        name=length.name,
        measured_mm=table.estimate,
        reference_mm=length.reference_mm,
        standard_uncertainty_mm=float(np.hypot(table.standard_uncertainty, u_reference)),
        expanded_uncertainty_mm=float(np.hypot(half, NORMAL_FACTOR * u_reference)),
    )


def length_limit(errors: Sequence[LengthError]) -> LengthLimit:
    """Return the lowest line A + K L, A and K not negative, above every |error| + U.

    A linear programme in two unknowns: its optimum lies where two of its constraints meet, so all
    such corners are tried.
    """
    length = np.array([e.reference_mm for e in errors])
    bound = np.array([e.bound_mm for e in errors])
    corners = [(float(bound.max()), 0.0), (0.0, float((bound / length).max()))]
    for i in range(len(errors)):
        for j in range(i):
            if length[i] != length[j]:
                slope = float((bound[i] - bound[j]) / (length[i] - length[j]))
                corners.append((float(bound[i] - slope * length[i]), slope))
    slack = 1e-12 * float(bound.max())
    allowed = [
        (a, k) for a, k in corners if a >= 0 and k >= 0 and np.all(a + k * length >= bound - slack)
    ]
    constant, slope = min(allowed, key=lambda line: line[0] + line[1] * float(length.mean()))
    return LengthLimit(
        constant_mm=constant,
        slope=slope,
        shortest_mm=float(length.min()),
        longest_mm=float(length.max()),
        count=len(errors),
    )
