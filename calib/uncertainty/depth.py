"""Uncertainty of one measured point: depth by JCGM 100 and 101, position by JCGM 102."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.core.unit_diagonal import unit_diagonal
from calib.geometry.plane import gaze_at
from calib.uncertainty.budget import COVERAGE, Budget
from calib.uncertainty.joint import (
    FixedNumber,
    MeasuredPoints,
    Quantity,
    propagate_together,
    raise_first,
)
from calib.uncertainty.measurement import Instrument, Reading
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import (
    NORMAL_FACTOR,
    Draws,
    Interval,
    MonteCarlo,
    MonteCarloValidation,
    Results,
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
    validation: MonteCarloValidation
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
        return unit_diagonal(self.covariance_mm2)[1]


def reading_at(theta: FloatArray, *, z_mm: float, x1c: float, y1c: float = 0.0) -> Reading:
    """Return what an instrument with parameters `theta`, shape (COUNT,), reads of a point.

    Raises
    ------
    ValueError
        If C2 cannot gaze at the point.
    """
    gaze = gaze_at(theta, np.array([[x1c * z_mm, y1c * z_mm, z_mm]]))
    return Reading(x1c, y1c, float(gaze.alpha2[0]))


@dataclass(frozen=True)
class PointUncertainty:
    """Depth and position of one point, from the same trials.

    Parameters
    ----------
    depth, position
        With their uncertainties.
    draws
        Of the depth, mm, for further questions.
    """

    depth: DepthUncertainty
    draws: Draws
    position: PositionUncertainty


def depth_budget(instrument: Instrument, reading: Reading) -> Budget:
    """Return the budget of a measured depth."""
    return _depth_budget(MeasurementModel(instrument, [reading]))


def _depth_budget(model: MeasurementModel) -> Budget:
    return model.budget(
        quantity="depth z",
        estimate=float(model.estimate[0, DEPTH]),
        sensitivity=model.jacobian[0, DEPTH],
    )


def least_certain(instrument: Instrument, readings: Sequence[Reading]) -> Reading:
    """Return the reading whose depth is the least certain: what holds there holds for all."""
    u = [depth_budget(instrument, r).standard_uncertainty for r in readings]
    return readings[int(np.argmax(u))]


def depth_uncertainty(
    instrument: Instrument, reading: Reading, rng: np.random.Generator, *, digits: int = 2
) -> tuple[DepthUncertainty, Draws]:
    """Return a measured depth with its uncertainty, and the draws for further questions.

    Raises
    ------
    EstimationError
        If the depth is so uncertain that it has no upper limit.
    """
    model = MeasurementModel(instrument, [reading])
    depth = _AskedDepth.of(model, reading, digits=digits)
    raise_first(propagate_together(instrument, [MeasuredPoints(model, (depth.quantity,))], rng))
    return depth.answer()


def position_uncertainty(
    instrument: Instrument, reading: Reading, rng: np.random.Generator
) -> PositionUncertainty:
    """Return a measured position with its covariance and 95 % ellipsoid (JCGM 102, 7.7.2).

    The ellipsoid has the shape of the linear covariance and the size that the Monte Carlo trials
    ask for: it holds 95 % of them even where the linear covariance is too small.
    """
    model = MeasurementModel(instrument, [reading])
    position = _AskedPosition.of(model)
    raise_first(propagate_together(instrument, [MeasuredPoints(model, (position.quantity,))], rng))
    return position.answer()


def point_uncertainties(
    instrument: Instrument, readings: Sequence[Reading], rng: np.random.Generator
) -> tuple[PointUncertainty | EstimationError, ...]:
    """Return depth and position of points, each measured by itself, all from the same trials.

    Each has the results that `depth_uncertainty` and `position_uncertainty` give with an equal
    generator. In place of a depth so uncertain that it has no upper limit stands the error.
    """
    models = [MeasurementModel(instrument, [reading]) for reading in readings]
    depths = [_AskedDepth.of(m, r, digits=2) for m, r in zip(models, readings, strict=True)]
    positions = [_AskedPosition.of(m) for m in models]
    asked = [
        MeasuredPoints(m, (d.quantity, p.quantity))
        for m, d, p in zip(models, depths, positions, strict=True)
    ]
    errors = propagate_together(instrument, asked, rng)
    return tuple(
        PointUncertainty(*d.answer(), p.answer()) if error is None else error
        for d, p, error in zip(depths, positions, errors, strict=True)
    )


@dataclass(frozen=True)
class _AskedDepth:
    """The linear result of a depth, and the trials that judge it."""

    reading: Reading
    budget: Budget
    results: Results

    @classmethod
    def of(cls, model: MeasurementModel, reading: Reading, *, digits: int) -> _AskedDepth:
        table = _depth_budget(model)
        # Without a coverage factor the linear interval is not stated: no trials to decide a close
        # call.
        linear = None
        if table.coverage_factor is not None:
            half = table.coverage_factor * table.standard_uncertainty
            linear = Interval(table.estimate - half, table.estimate + half)
        return cls(reading, table, Results(model.blocks, digits=digits, linear=linear))

    @property
    def quantity(self) -> Quantity:
        return Quantity(lambda points: points[0, DEPTH], self.results)

    def answer(self) -> tuple[DepthUncertainty, Draws]:
        table, draws = self.budget, self.results.draws()
        factor = table.coverage_factor
        monte_carlo = draws.summary()
        verdict = validate(
            monte_carlo,
            estimate=table.estimate,
            standard_uncertainty=table.standard_uncertainty,
            coverage_factor=NORMAL_FACTOR if factor is None else factor,
        )
        return DepthUncertainty(
            x1c=self.reading.x1c,
            y1c=self.reading.y1c,
            alpha2_rad=self.reading.alpha2_rad,
            z_mm=table.estimate,
            budget=table,
            monte_carlo=monte_carlo,
            validation=verdict,
            linear_valid=verdict.validated and factor is not None,
        ), draws


@dataclass(frozen=True)
class _AskedPosition:
    """The linear covariance of a position, and the trials that give its ellipsoid a size.

    Parameters
    ----------
    estimate
        mm, shape (3,).
    covariance
        mm², shape (3, 3), with eigenvalues, largest first, and eigenvectors as columns.
    """

    estimate: FloatArray
    covariance: FloatArray
    eigenvalues: FloatArray
    vectors: FloatArray
    distances: FixedNumber

    @classmethod
    def of(cls, model: MeasurementModel) -> _AskedPosition:
        jacobian = model.jacobian[0]
        covariance = jacobian @ model.covariance @ jacobian.T
        values, vectors = np.linalg.eigh(covariance)
        largest_first = slice(None, None, -1)
        return cls(
            estimate=model.estimate[0],
            covariance=covariance,
            eigenvalues=np.maximum(values[largest_first], 0),
            vectors=vectors[:, largest_first],
            distances=FixedNumber(POSITION_TRIALS),
        )

    @property
    def _solid(self) -> BoolArray:
        solid: BoolArray = self.eigenvalues > FLAT_AXIS * self.eigenvalues[0]
        return solid

    @property
    def quantity(self) -> Quantity:
        """The square of the distance from the estimate, in standard deviations."""
        solid = self._solid
        whiten = self.vectors[:, solid].T / np.sqrt(self.eigenvalues[solid])[:, None]

        def distance(points: FloatArray) -> FloatArray:
            with np.errstate(invalid="ignore"):
                square = ((whiten @ (points[0] - self.estimate[:, None])) ** 2).sum(axis=0)
            # A point at infinity lies outside every ellipsoid.
            return np.where(np.isfinite(points[0, DEPTH]), square, np.inf)

        return Quantity(distance, self.distances)

    def answer(self) -> PositionUncertainty:
        squares = self.distances.values()
        inside = int(np.ceil(COVERAGE * len(squares)))
        factor = float(np.sqrt(np.partition(squares, inside - 1)[inside - 1]))
        return PositionUncertainty(
            position_mm=self.estimate,
            covariance_mm2=self.covariance,
            coverage_factor=factor,
            semi_axes_mm=factor * np.sqrt(np.where(self._solid, self.eigenvalues, 0)),
            directions=self.vectors,
            trials=len(squares),
        )
