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

from calib.arrays import FloatArray
from calib.uncertainty.budget import Budget
from calib.uncertainty.measurement import Instrument, Reading
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import NORMAL_FACTOR, Draws, propagate


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


def _length_model(
    instrument: Instrument, start: Reading, end: Reading
) -> tuple[MeasurementModel, float, FloatArray]:
    """Return the model of both points, their distance, mm, and its sensitivities, shape (K,)."""
    model = MeasurementModel(instrument, [start, end])
    first, second = model.estimate
    length = float(np.linalg.norm(second - first))
    if length == 0:
        raise ValueError("a length needs two different points")
    direction = (second - first) / length
    jacobian = model.jacobian
    return model, length, direction @ (jacobian[1] - jacobian[0])


def length_budget(instrument: Instrument, start: Reading, end: Reading) -> Budget:
    """Return the budget of the distance between two measured points.

    Raises
    ------
    ValueError
        If the two points coincide.
    """
    model, length, sensitivity = _length_model(instrument, start, end)
    return model.budget(quantity="length", estimate=length, sensitivity=sensitivity)


def length_draws(
    instrument: Instrument, start: Reading, end: Reading, rng: np.random.Generator
) -> Draws:
    """Return draws of the distance between two measured points, mm."""
    model = MeasurementModel(instrument, [start, end])

    def measure(inputs: FloatArray) -> FloatArray:
        points = model.positions(inputs)
        with np.errstate(invalid="ignore"):
            length = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        return np.where(np.isfinite(length), length, np.inf)

    return propagate(measure, model.blocks, rng)


def length_error(
    instrument: Instrument,
    rng: np.random.Generator,
    *,
    name: str,
    start: Reading,
    end: Reading,
    reference_mm: float,
    u_reference_mm: float,
) -> LengthError:
    """Return the error of a measured length against its reference, u_reference_mm normal."""
    table = length_budget(instrument, start, end)
    interval = length_draws(instrument, start, end, rng).summary().symmetric
    half = max(table.estimate - interval.low, interval.high - table.estimate)
    return LengthError(
        name=name,
        measured_mm=table.estimate,
        reference_mm=reference_mm,
        standard_uncertainty_mm=float(np.hypot(table.standard_uncertainty, u_reference_mm)),
        expanded_uncertainty_mm=float(np.hypot(half, NORMAL_FACTOR * u_reference_mm)),
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
