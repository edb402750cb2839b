"""One measurement, or several that share a calibration, as a model of uncertain inputs.

The inputs are, in this order: the parameters with what rows and priors leave uncertain of them (one
multivariate estimate), the shared errors (what the intrinsics and the pose of C2 have wrong, which
falsifies every reading and has falsified the parameters; or what several rows have wrong together,
which has falsified the parameters alone), and the errors of each reading. The three are independent
of each other: a budget in them, with the parameters in the combinations of
`calib.uncertainty.determined`, needs no correlations, and each source of shared errors has one
line, its effects by both ways added with their signs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, embed
from calib.geometry.plane import OBSERVABLE, Gaze
from calib.uncertainty.budget import Budget, InputQuantity, budget
from calib.uncertainty.determined import determined
from calib.uncertainty.distributions import Inputs, NormalInputs, RectangularInputs
from calib.uncertainty.measurement import (
    PARAMETERS_LABEL,
    READING_NAMES,
    READINGS,
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
)
from calib.uncertainty.position import in_front, positions
from calib.uncertainty.trials import ReadingErrors, Trials, own_inputs, reading_errors

_UNITS = ("1", "1", "rad", "rad")


@dataclass(frozen=True)
class _Own:
    """One error of one reading: which reading, which quantity, how it is distributed."""

    reading: int
    quantity: int
    std: float
    distribution: str
    name: str

    def label(self, *, alone: bool) -> str:
        return self.name if alone else f"{self.name}, point {self.reading + 1}"


class MeasurementModel:
    """Points measured by one instrument as functions of all uncertain inputs.

    Parameters
    ----------
    instrument
        What takes the readings.
    points
        Readings of the n points; those whose depth they borrow join them.

    Raises
    ------
    ValueError
        If the instrument has shared errors and a reading has no loadings for them.
    """

    def __init__(self, instrument: Instrument, points: Sequence[Reading]) -> None:
        self._instrument = instrument
        self._count = len(points)
        readings, self._depth_of = _with_lenders(points)
        self._nominal = np.array([r.values for r in readings])
        shared = instrument.shared
        self._shared_names = () if shared is None else shared.names
        self._by_shared = instrument.by_shared
        given = [r.shared for r in readings if r.shared is not None]
        if shared is not None and shared.of_readings and len(given) < len(readings):
            raise ValueError("a reading of an instrument with shared errors needs loadings")
        self._loadings = instrument.loadings(np.stack(given) if given else None, len(readings))
        self._own = tuple(_own_errors(instrument.reading, len(readings)))

    @property
    def readings(self) -> int:
        """Number of readings, those included whose depth is borrowed."""
        return len(self._nominal)

    @property
    def estimate(self) -> FloatArray:
        """Positions at the best estimates, mm, shape (n, 3)."""
        k, m = self._by_shared.shape
        best = np.zeros((1, k + m + len(self._own)))
        best[0, :k] = self._instrument.parameters.values
        found: FloatArray = self.positions(best)[0]
        return found

    def _points(self, depth_of: Callable[[Gaze], FloatArray], values: FloatArray) -> FloatArray:
        """Return positions, mm, shape (n, 3, t).

        Parameters
        ----------
        depth_of
            From t gazes to depths, mm, shape (t,).
        values
            x1c, y1c, alpha2 and gaze residual, shape (readings, 4, t).
        """
        z = {
            depth_source: depth_of(Gaze(*values[depth_source]))
            for depth_source in set(self._depth_of)
        }
        points = np.empty((self._count, 3, values.shape[2]))
        with np.errstate(invalid="ignore"):
            for i, depth_source in enumerate(self._depth_of):
                points[i, 2] = z[depth_source]
                np.multiply(values[i, :2], z[depth_source], out=points[i, :2])
        return points

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all inputs, shape (K, K)."""
        k, m = self._by_shared.shape
        full = np.eye(k + m + len(self._own))
        full[:k, :k] = self._instrument.own_covariance
        for i, own in enumerate(self._own, start=k + m):
            full[i, i] = own.std**2
        return full

    @property
    def jacobian(self) -> FloatArray:
        """Derivatives of the positions by all inputs, shape (n, 3, K)."""
        gaze = Gaze(*self._nominal.T)
        j = depth_jacobian(self._instrument.theta, gaze)
        by_theta = j.by_theta[:, [INDEX[name] for name in self._instrument.parameters.names]]
        k, m = self._by_shared.shape
        # From inputs to the readings, shape (readings, 4, K), and on to the depths.
        own = np.zeros((len(gaze), READINGS, len(self._own)))
        for i, error in enumerate(self._own):
            own[error.reading, error.quantity, i] = 1.0
        no_parameters = np.zeros((len(gaze), READINGS, k))
        to_reading = np.concatenate([no_parameters, self._loadings, own], axis=2)
        to_depth = np.einsum("nq,nqk->nk", j.by_observable, to_reading)
        to_depth[:, :k] = by_theta
        to_depth[:, k : k + m] += by_theta @ self._by_shared
        points, lenders = np.arange(self._count), list(self._depth_of)
        ray = np.stack([gaze.x1c, gaze.y1c, np.ones(len(gaze))], axis=1)[points]
        # dx = x1c dz + z dx1c, eq. (11) of Xu and Wang; z may be another reading's.
        found: FloatArray = ray[:, :, None] * to_depth[lenders, None, :]
        found[:, :2] += j.z[lenders, None, None] * to_reading[points, : OBSERVABLE.alpha2]
        return found

    def budget(self, *, quantity: str, estimate: float, sensitivity: FloatArray) -> Budget:
        """Return the budget of a result in mm; inputs without influence are left out.

        The shared errors of one source are one input, a correction of 0 mm whose standard
        uncertainty is the root sum of squares of their contributions.

        Parameters
        ----------
        sensitivity
            Derivative of the result by each input, shape (K,).
        """
        k, m = self._by_shared.shape
        inputs = [
            *self._parameters(sensitivity[:k]),
            *self._sources(sensitivity[k : k + m]),
            *self._reading_errors(sensitivity[k + m :]),
        ]
        matters = [q for q in inputs if q.sensitivity and q.standard_uncertainty]
        return budget(
            quantity=quantity,
            estimate=estimate,
            unit="mm",
            inputs=matters,
            correlation=np.eye(len(matters)),
        )

    def _parameters(self, sensitivity: FloatArray) -> list[InputQuantity]:
        p = self._instrument.parameters
        found = determined(
            p.names,
            p.values,
            self._instrument.own_covariance,
            mean_gaze_rad=self._instrument.mean_gaze_rad,
        )
        along = sensitivity @ found.to_parameters
        distribution = _parameter_distribution(p)
        return [
            InputQuantity(
                name=name,
                estimate=float(found.estimates[i]),
                unit=found.units[i],
                standard_uncertainty=float(found.std[i]),
                evaluation=p.evaluation[i],
                distribution=distribution,
                degrees_of_freedom=p.degrees_of_freedom,
                sensitivity=float(along[i]),
                estimated_with=PARAMETERS_LABEL,
                conditional=i > 0,
            )
            for i, name in enumerate(found.names)
        ]

    def _sources(self, sensitivity: FloatArray) -> list[InputQuantity]:
        together: dict[str, float] = {}
        for name, effect in zip(self._shared_names, sensitivity, strict=True):
            together[name] = math.hypot(together.get(name, 0.0), effect)
        return [
            InputQuantity(
                name=name,
                estimate=0.0,
                unit="mm",
                standard_uncertainty=u,
                evaluation="A",
                distribution="normal",
                degrees_of_freedom=math.inf,
                sensitivity=1.0,
            )
            for name, u in together.items()
            if u > 0
        ]

    def _reading_errors(self, sensitivity: FloatArray) -> list[InputQuantity]:
        alone = len(self._nominal) == 1
        return [
            InputQuantity(
                name=own.label(alone=alone),
                estimate=float(self._nominal[own.reading, own.quantity]),
                unit=_UNITS[own.quantity],
                standard_uncertainty=own.std,
                evaluation="B",
                distribution=own.distribution,
                degrees_of_freedom=math.inf,
                sensitivity=float(sensitivity[i]),
            )
            for i, own in enumerate(self._own)
        ]

    @property
    def blocks(self) -> tuple[Inputs, ...]:
        """The inputs as blocks for Monte Carlo; their columns are those of `positions`."""
        m = len(self._shared_names)
        blocks = [own_inputs(self._instrument)]
        if m:
            blocks.append(NormalInputs(np.zeros(m), np.eye(m)))
        for own in self._own:
            if own.distribution == "rectangular":
                half = np.array([own.std * math.sqrt(3)])
                blocks.append(RectangularInputs(np.zeros(1), half))
            else:
                blocks.append(NormalInputs(np.zeros(1), np.array([[own.std**2]])))
        return tuple(blocks)

    def positions(self, draws: FloatArray) -> FloatArray:
        """Return positions, mm, shape (t, n, 3), for draws of `blocks`, shape (t, K)."""
        k, m = self._by_shared.shape
        shared = draws[:, k : k + m]
        theta = embed(draws[:, :k] + shared @ self._by_shared.T, self._instrument.parameters.names)
        values = self._nominal[:, :, None] + np.einsum("nqm,tm->nqt", self._loadings, shared)
        for i, own in enumerate(self._own, start=k + m):
            values[own.reading, own.quantity] += draws[:, i]
        return self._points(lambda gaze: positions(theta, gaze)[:, 2], values).transpose(2, 0, 1)

    @cached_property
    def _errors(self) -> ReadingErrors:
        return reading_errors(self._instrument, self._loadings)

    def positions_in(self, trials: Trials) -> FloatArray:
        """Return positions, mm, shape (n, 3, t), for trials of the instrument.

        They have the joint distribution of `positions` for draws of `blocks`.
        """
        errors = self._errors(trials).reshape((*self._nominal.shape, -1))
        values = self._nominal[:, :, None] + errors
        return self._points(lambda gaze: in_front(trials.planes.depth(gaze)), values)


def _with_lenders(points: Sequence[Reading]) -> tuple[list[Reading], tuple[int, ...]]:
    """Return the points and all readings whose depth they borrow, and whose depth each has."""
    readings, depth_of = list(points), []
    for point in points:
        depth_source = point if point.depth_from is None else point.depth_from
        place = next((i for i, r in enumerate(readings) if r is depth_source), None)
        if place is None:
            readings.append(depth_source)
        depth_of.append(len(readings) - 1 if place is None else place)
    return readings, tuple(depth_of)


def _own_errors(spread: ReadingSpread, count: int) -> list[_Own]:
    """Return the errors with any size of `count` readings."""
    found = []
    for reading in range(count):
        for quantity, part in enumerate(spread.parts):
            name = READING_NAMES[quantity]
            if part.normal > 0:
                found.append(_Own(reading, quantity, part.normal, "normal", name))
            if part.width > 0:
                std = part.width / math.sqrt(12)
                found.append(_Own(reading, quantity, std, "rectangular", f"{name}, resolution"))
    return found


def _parameter_distribution(p: ParameterKnowledge) -> str:
    if p.draws is not None:
        return "posterior"
    freedom = p.degrees_of_freedom
    return "Student t" if freedom is not None and math.isfinite(freedom) else "normal"
