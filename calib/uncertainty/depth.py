"""Uncertainty of one measured point: depth by JCGM 100 and 101, position by JCGM 102."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.plane import gaze_at
from calib.uncertainty.budget import COVERAGE, Budget
from calib.uncertainty.distributions import PARTS, draw
from calib.uncertainty.measurement import Instrument, Reading
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import (
    NORMAL_FACTOR,
    Draws,
    Interval,
    MonteCarlo,
    Validation,
    propagate,
    validate,
)

POSITION_TRIALS = 200_000
"""Trials for the coverage factor of a position: it is then known to 0.2 %."""

FLAT_AXIS = 1e-12
"""A relative variance below this is a direction in which the position is taken as exact."""

DEPTH = 2
"""Place of z in a position."""


@dataclass(frozen=True)
class DepthUncertainty:
    """A measured depth with its uncertainty, by both ways.

    Parameters
    ----------
    x1c, y1c, alpha2_rad
        The reading.
    z_mm
        Depth at the best estimates.
    budget
        The linear result (JCGM 100).
    monte_carlo
        The distribution (JCGM 101).
    validation
        Clause 8 of JCGM 101, with the budget's coverage factor, or with 1.96 if it has none.
    linear_valid
        Whether depth ± k u may be stated: the budget has a coverage factor and clause 8 validates
        it.
    """

    x1c: float
    y1c: float
    alpha2_rad: float
    z_mm: float
    budget: Budget
    monte_carlo: MonteCarlo
    validation: Validation
    linear_valid: bool

    @property
    def interval(self) -> Interval:
        """The 95 % interval to state: linear if valid, else the shortest Monte Carlo one."""
        return self.validation.linear if self.linear_valid else self.monte_carlo.shortest

    @property
    def standard_uncertainty_mm(self) -> float | None:
        """The standard uncertainty that goes with `interval`; None where none exists."""
        if self.linear_valid:
            return self.budget.standard_uncertainty
        return self.monte_carlo.standard_uncertainty


@dataclass(frozen=True)
class PositionUncertainty:
    """A measured position with its uncertainty (JCGM 102).

    Parameters
    ----------
    position_mm
        x, y, z, shape (3,).
    covariance_mm2
        To first order, shape (3, 3).
    coverage_factor
        Scale at which the ellipsoid of the covariance holds 95 % of the Monte Carlo trials
        (7.7.2); for a normal distribution in three dimensions it is 2.795.
    semi_axes_mm
        Of the 95 % ellipsoid, longest first, shape (3,).
    directions
        Unit vectors of the axes in C1, as columns, shape (3, 3).
    trials
        Number of Monte Carlo trials.
    """

    position_mm: FloatArray
    covariance_mm2: FloatArray
    coverage_factor: float
    semi_axes_mm: FloatArray
    directions: FloatArray
    trials: int

    @property
    def standard_uncertainty_mm(self) -> FloatArray:
        """Of x, y and z, shape (3,)."""
        u: FloatArray = np.sqrt(np.diag(self.covariance_mm2))
        return u

    @property
    def correlation(self) -> FloatArray:
        """Of x, y and z, shape (3, 3); 0 beside an exact coordinate."""
        u = self.standard_uncertainty_mm
        safe = np.where(u > 0, u, 1.0)
        r: FloatArray = self.covariance_mm2 / np.outer(safe, safe)
        return r


def reading_at(theta: FloatArray, *, z_mm: float, x1c: float, y1c: float = 0.0) -> Reading:
    """Return what an instrument with parameters `theta`, shape (COUNT,), reads of a point.

    Raises
    ------
    ValueError
        If C2 cannot gaze at the point.
    """
    gaze = gaze_at(theta, np.array([[x1c * z_mm, y1c * z_mm, z_mm]]))
    return Reading(x1c, y1c, float(gaze.alpha2[0]))


def depth_budget(instrument: Instrument, reading: Reading) -> Budget:
    """Return the budget of a measured depth."""
    model = MeasurementModel(instrument, [reading])
    return model.budget(
        quantity="depth z",
        estimate=float(model.estimate[0, DEPTH]),
        sensitivity=model.jacobian[0, DEPTH],
    )


def least_certain(instrument: Instrument, readings: Sequence[Reading]) -> Reading:
    """Return the reading whose depth is the least certain: what holds there holds for all."""
    u = [depth_budget(instrument, r).standard_uncertainty for r in readings]
    return readings[int(np.argmax(u))]


def depth_draws(
    instrument: Instrument,
    reading: Reading,
    rng: np.random.Generator,
    *,
    digits: int = 2,
    linear: Interval | None = None,
) -> Draws:
    """Return draws of a measured depth, mm (JCGM 101, 7.9); see `montecarlo.propagate`."""
    model = MeasurementModel(instrument, [reading])

    def measure(inputs: FloatArray) -> FloatArray:
        return model.positions(inputs)[:, 0, DEPTH]

    return propagate(measure, model.blocks, rng, digits=digits, linear=linear)


def depth_uncertainty(
    instrument: Instrument, reading: Reading, rng: np.random.Generator, *, digits: int = 2
) -> tuple[DepthUncertainty, Draws]:
    """Return a measured depth with its uncertainty, and the draws for further questions.

    Raises
    ------
    EstimationError
        If the depth is so uncertain that it has no upper limit.
    """
    table = depth_budget(instrument, reading)
    factor = NORMAL_FACTOR if table.coverage_factor is None else table.coverage_factor
    half = factor * table.standard_uncertainty
    linear = Interval(table.estimate - half, table.estimate + half)
    # Without a coverage factor the linear interval is not stated: no trials to decide a close call.
    judged = None if table.coverage_factor is None else linear
    draws = depth_draws(instrument, reading, rng, digits=digits, linear=judged)
    monte_carlo = draws.summary()
    verdict = validate(
        monte_carlo,
        estimate=table.estimate,
        standard_uncertainty=table.standard_uncertainty,
        coverage_factor=factor,
    )
    return DepthUncertainty(
        x1c=reading.x1c,
        y1c=reading.y1c,
        alpha2_rad=reading.alpha2_rad,
        z_mm=table.estimate,
        budget=table,
        monte_carlo=monte_carlo,
        validation=verdict,
        linear_valid=verdict.validated and table.coverage_factor is not None,
    ), draws


def position_uncertainty(
    instrument: Instrument,
    reading: Reading,
    rng: np.random.Generator,
    *,
    trials: int = POSITION_TRIALS,
) -> PositionUncertainty:
    """Return a measured position with its covariance and 95 % ellipsoid (JCGM 102, 7.7.2).

    The ellipsoid has the shape of the linear covariance and the size that the Monte Carlo trials
    ask for: it holds 95 % of them even where the linear covariance is too small.
    """
    model = MeasurementModel(instrument, [reading])
    jacobian = model.jacobian[0]
    covariance = jacobian @ model.covariance @ jacobian.T
    drawn = np.vstack(
        [
            np.hstack([draw(block, rng, trials // PARTS, part=part) for block in model.blocks])
            for part in range(PARTS)
        ]
    )
    values, vectors = np.linalg.eigh(covariance)
    order = np.argsort(values)[::-1]
    values, vectors = np.maximum(values[order], 0), vectors[:, order]
    solid = values > FLAT_AXIS * values[0]
    points = model.positions(drawn)[:, 0]
    # A point at infinity lies outside every ellipsoid.
    distance = np.full(len(points), np.inf)
    finite = np.isfinite(points).all(axis=1)
    away = (points[finite] - model.estimate[0]) @ vectors[:, solid]
    distance[finite] = np.linalg.norm(away / np.sqrt(values[solid]), axis=1)
    distance.sort()
    factor = float(distance[int(np.ceil(COVERAGE * len(distance))) - 1])
    return PositionUncertainty(
        position_mm=model.estimate[0],
        covariance_mm2=covariance,
        coverage_factor=factor,
        semi_axes_mm=factor * np.sqrt(np.where(solid, values, 0)),
        directions=vectors,
        trials=len(distance),
    )
