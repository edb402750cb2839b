"""One measurement, or several that share a calibration, as a model of uncertain inputs.

The inputs are, in this order: the parameters (one multivariate estimate, shared by all readings),
the shared errors (what C1's intrinsics have wrong, common to all readings and, by the calibration,
correlated with the parameters), and the errors of each reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.parameters import INDEX, PARAMETERS, embed
from calib.geometry.plane import OBSERVABLE, Gaze, depth_jacobian
from calib.uncertainty.budget import Budget, InputQuantity, budget
from calib.uncertainty.distributions import (
    GivenInputs,
    Inputs,
    NormalInputs,
    RectangularInputs,
    StudentInputs,
)
from calib.uncertainty.measurement import Instrument, ParameterKnowledge, Reading, ReadingSpread
from calib.uncertainty.position import READINGS, positions

CALIBRATION = "calibration"
"""Label of the inputs that the calibration estimated together."""

_NAMES = ("x1c", "y1c", "alpha2", "gaze residual")
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
        self._loadings = np.zeros((len(readings), READINGS, len(self._shared_names)))
        if shared is not None:
            for i, r in enumerate(readings):
                if r.shared is None:
                    raise ValueError("a reading of an instrument with shared errors needs loadings")
                self._loadings[i] = r.shared
        self._with_parameters = _reconciled(instrument)
        self._own = tuple(_own_errors(instrument.reading, len(readings)))

    @property
    def estimate(self) -> FloatArray:
        """Positions at the best estimates, mm, shape (n, 3)."""
        points: FloatArray = self._points(self._instrument.theta, self._nominal.T[:, None])[0]
        return points

    def _points(self, theta: FloatArray, values: FloatArray) -> FloatArray:
        """Return positions, mm, shape (t, n, 3).

        Parameters
        ----------
        theta
            Shape (COUNT,), or (t, COUNT).
        values
            x1c, y1c, alpha2 and gaze residual, shape (4, t, readings).
        """
        needed = sorted(set(self._depth_of))
        z = {j: positions(theta, Gaze(*values[:, :, j]))[:, 2] for j in needed}
        with np.errstate(invalid="ignore"):
            found = [
                np.stack([values[0, :, i] * z[j], values[1, :, i] * z[j], z[j]], axis=1)
                for i, j in enumerate(self._depth_of)
            ]
        return np.stack(found, axis=1)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all inputs, shape (K, K)."""
        p = self._instrument.parameters
        k, m = self._with_parameters.shape
        full = np.zeros((k + m + len(self._own),) * 2)
        full[:k, :k] = p.covariance
        full[k : k + m, k : k + m] = np.eye(m)
        full[:k, k : k + m] = self._with_parameters
        full[k : k + m, :k] = self._with_parameters.T
        for i, own in enumerate(self._own, start=k + m):
            full[i, i] = own.std**2
        return full

    @property
    def jacobian(self) -> FloatArray:
        """Derivatives of the positions by all inputs, shape (n, 3, K)."""
        gaze = Gaze(*self._nominal.T)
        j = depth_jacobian(self._instrument.theta, gaze)
        free = [INDEX[name] for name in self._instrument.parameters.names]
        # From inputs to the readings, shape (readings, 4, K), and on to the depths.
        own = np.zeros((len(gaze), READINGS, len(self._own)))
        for i, error in enumerate(self._own):
            own[error.reading, error.quantity, i] = 1.0
        by_theta = np.zeros((len(gaze), READINGS, len(free)))
        to_reading = np.concatenate([by_theta, self._loadings, own], axis=2)
        to_depth = np.einsum("nq,nqk->nk", j.by_observable, to_reading)
        to_depth[:, : len(free)] = j.by_theta[:, free]
        points, lenders = np.arange(self._count), list(self._depth_of)
        ray = np.stack([gaze.x1c, gaze.y1c, np.ones(len(gaze))], axis=1)[points]
        # dx = x1c dz + z dx1c, eq. (11) of Xu and Wang; z may be another reading's.
        found: FloatArray = ray[:, :, None] * to_depth[lenders, None, :]
        found[:, :2] += j.z[lenders, None, None] * to_reading[points, : OBSERVABLE.alpha2]
        return found

    def budget(self, *, quantity: str, estimate: float, sensitivity: FloatArray) -> Budget:
        """Return the budget of a result in mm; inputs without influence are left out.

        Parameters
        ----------
        sensitivity
            Derivative of the result by each input, shape (K,).
        """
        matters = np.flatnonzero(sensitivity)
        inputs = self._quantities(sensitivity)
        return budget(
            quantity=quantity,
            estimate=estimate,
            unit="mm",
            inputs=[inputs[i] for i in matters],
            correlation=_correlation(self.covariance)[np.ix_(matters, matters)],
        )

    def _quantities(self, sensitivity: FloatArray) -> tuple[InputQuantity, ...]:
        p = self._instrument.parameters
        u = np.sqrt(np.diag(self.covariance))
        distribution = _parameter_distribution(p)
        found = [
            InputQuantity(
                name=name,
                estimate=float(p.values[i]),
                unit=PARAMETERS[INDEX[name]].unit,
                standard_uncertainty=float(u[i]),
                evaluation=p.evaluation[i],
                distribution=distribution,
                degrees_of_freedom=p.degrees_of_freedom,
                sensitivity=float(sensitivity[i]),
                estimated_with=CALIBRATION,
            )
            for i, name in enumerate(p.names)
        ]
        # Correlated with the parameters, the shared errors belong to the same estimate.
        tied = bool(np.any(self._with_parameters))
        found += [
            InputQuantity(
                name=name,
                estimate=0.0,
                unit="1",
                standard_uncertainty=float(u[i]),
                evaluation="A",
                distribution="normal",
                degrees_of_freedom=math.inf,
                sensitivity=float(sensitivity[i]),
                estimated_with=CALIBRATION if tied else None,
            )
            for i, name in enumerate(self._shared_names, start=len(found))
        ]
        alone = len(self._nominal) == 1
        found += [
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
            for i, own in enumerate(self._own, start=len(found))
        ]
        return tuple(found)

    @property
    def blocks(self) -> tuple[Inputs, ...]:
        """The inputs as blocks for Monte Carlo; their columns are those of `positions`."""
        m = len(self._shared_names)
        blocks: list[Inputs] = [_parameter_block(self._instrument.parameters)]
        if m:
            rest = np.eye(m) - self._carried @ self._with_parameters
            blocks.append(NormalInputs(np.zeros(m), rest))
        for own in self._own:
            if own.distribution == "rectangular":
                half = np.array([own.std * math.sqrt(3)])
                blocks.append(RectangularInputs(np.zeros(1), half))
            else:
                blocks.append(NormalInputs(np.zeros(1), np.array([[own.std**2]])))
        return tuple(blocks)

    @property
    def _carried(self) -> FloatArray:
        """Regression of the shared errors on the parameters, shape (m, k)."""
        inverse, u = _inverse_correlation(self._instrument.parameters.covariance)
        carried: FloatArray = (self._with_parameters / u[:, None]).T @ inverse / u
        return carried

    def positions(self, draws: FloatArray) -> FloatArray:
        """Return positions, mm, shape (t, n, 3), for draws of `blocks`, shape (t, K)."""
        p = self._instrument.parameters
        k, m = self._with_parameters.shape
        shared = draws[:, k : k + m]
        if m:
            shared = shared + (draws[:, :k] - p.values) @ self._carried.T
        values = self._nominal.T[:, None] + np.einsum("nqm,tm->qtn", self._loadings, shared)
        for i, own in enumerate(self._own, start=k + m):
            values[own.quantity, :, own.reading] += draws[:, i]
        return self._points(embed(draws[:, :k], p.names), values)


def _with_lenders(points: Sequence[Reading]) -> tuple[list[Reading], tuple[int, ...]]:
    """Return the points and all readings whose depth they borrow, and whose depth each has."""
    readings, depth_of = list(points), []
    for point in points:
        lender = point if point.depth_from is None else point.depth_from
        place = next((i for i, r in enumerate(readings) if r is lender), None)
        if place is None:
            readings.append(lender)
        depth_of.append(len(readings) - 1 if place is None else place)
    return readings, tuple(depth_of)


def _inverse_correlation(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse of the correlation matrix, (k, k), and the standard uncertainties, (k,).

    Taken apart, millimetres and microradians do not spoil each other's digits.
    """
    u = np.sqrt(np.diag(covariance))
    safe: FloatArray = np.where(u > 0, u, 1.0)
    inverse = np.linalg.pinv(_correlation(covariance), hermitian=True)
    return np.asarray(inverse, dtype=np.float64), safe


def _reconciled(instrument: Instrument) -> FloatArray:
    """Return the covariance of parameters and shared errors, (k, m), that the former can bear.

    The two come from different computations (a sampled posterior, a linear response), which may
    contradict each other by a little: together they would explain the parameters more than
    wholly. The link is then weakened until they explain just all. The parameters have absorbed part
    of the shared errors and take it away again in a measurement; a weaker link takes less away.
    """
    p, shared = instrument.parameters, instrument.shared
    if shared is None:
        return np.zeros((len(p.names), 0))
    inverse, u = _inverse_correlation(p.covariance)
    scaled = shared.with_parameters / u[:, None]
    explained = float(np.linalg.eigvalsh(scaled.T @ inverse @ scaled)[-1])
    reconciled: FloatArray = shared.with_parameters / math.sqrt(max(explained, 1.0))
    return reconciled


def _correlation(covariance: FloatArray) -> FloatArray:
    u = np.sqrt(np.diag(covariance))
    safe = np.where(u > 0, u, 1.0)
    correlation: FloatArray = covariance / np.outer(safe, safe)
    return correlation


def _own_errors(spread: ReadingSpread, count: int) -> list[_Own]:
    """Return the errors with any size of `count` readings."""
    found = []
    for reading in range(count):
        for quantity, part in enumerate(spread.parts):
            name = _NAMES[quantity]
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


def _parameter_block(p: ParameterKnowledge) -> Inputs:
    if p.draws is not None:
        return GivenInputs(p.draws)
    if p.degrees_of_freedom is not None and math.isfinite(p.degrees_of_freedom):
        return StudentInputs(p.values, p.covariance, p.degrees_of_freedom)
    return NormalInputs(p.values, p.covariance)
