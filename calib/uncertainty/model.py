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
from calib.geometry.plane import Gaze
from calib.uncertainty.budget import Budget, InputQuantity, budget
from calib.uncertainty.distributions import (
    GivenInputs,
    Inputs,
    NormalInputs,
    RectangularInputs,
    StudentInputs,
)
from calib.uncertainty.measurement import Instrument, ParameterKnowledge, Reading, ReadingSpread
from calib.uncertainty.position import READINGS, position_jacobian, positions

NEGATIVE = 1e-6
"""A correlation matrix may have an eigenvalue so far below zero by rounding."""

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
    """Readings of one instrument as functions of all their uncertain inputs.

    Parameters
    ----------
    instrument
        What takes the readings.
    readings
        The n readings.

    Raises
    ------
    ValueError
        If loadings are missing, or if parameters and shared errors have no joint covariance.
    """

    def __init__(self, instrument: Instrument, readings: Sequence[Reading]) -> None:
        self._instrument = instrument
        self._nominal = np.array([r.values for r in readings])
        shared = instrument.shared
        width = 0 if shared is None else len(shared.names)
        self._loadings = np.zeros((len(readings), READINGS, width))
        if shared is not None:
            for i, r in enumerate(readings):
                if r.shared is None:
                    raise ValueError("a reading of an instrument with shared errors needs loadings")
                self._loadings[i] = r.shared
        self._own = tuple(_own_errors(instrument.reading, len(readings)))
        _require_covariance(self.covariance)

    @property
    def _gaze(self) -> Gaze:
        return Gaze(*self._nominal.T)

    @property
    def estimate(self) -> FloatArray:
        """Positions at the best estimates, mm, shape (n, 3)."""
        return positions(self._instrument.theta, self._gaze)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all inputs, shape (K, K)."""
        p, shared = self._instrument.parameters, self._instrument.shared
        k, m = len(p.names), self._loadings.shape[2]
        full = np.zeros((k + m + len(self._own),) * 2)
        full[:k, :k] = p.covariance
        full[k : k + m, k : k + m] = np.eye(m)
        if shared is not None:
            full[:k, k : k + m] = shared.with_parameters
            full[k : k + m, :k] = shared.with_parameters.T
        for i, own in enumerate(self._own, start=k + m):
            full[i, i] = own.std**2
        return full

    @property
    def jacobian(self) -> FloatArray:
        """Derivatives of the positions by all inputs, shape (n, 3, K)."""
        j = position_jacobian(self._instrument.theta, self._gaze)
        free = [INDEX[name] for name in self._instrument.parameters.names]
        own = np.zeros((len(self._nominal), 3, len(self._own)))
        for i, error in enumerate(self._own):
            own[error.reading, :, i] = j.by_reading[error.reading, :, error.quantity]
        return np.concatenate([j.by_theta[:, :, free], j.by_reading @ self._loadings, own], axis=2)

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
        p, shared = self._instrument.parameters, self._instrument.shared
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
        tied = shared is not None and bool(np.any(shared.with_parameters))
        for i, name in enumerate(shared.names if shared is not None else (), start=len(found)):
            found.append(
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
            )
        alone = len(self._nominal) == 1
        for i, own in enumerate(self._own, start=len(found)):
            found.append(
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
            )
        return tuple(found)

    @property
    def blocks(self) -> tuple[Inputs, ...]:
        """The inputs as blocks for Monte Carlo; their columns are those of `positions`."""
        m = self._loadings.shape[2]
        blocks: list[Inputs] = [_parameter_block(self._instrument.parameters)]
        if m:
            rest = np.eye(m) - self._carried() @ self._with_parameters()
            blocks.append(NormalInputs(np.zeros(m), rest))
        for own in self._own:
            if own.distribution == "rectangular":
                half = np.array([own.std * math.sqrt(3)])
                blocks.append(RectangularInputs(np.zeros(1), half))
            else:
                blocks.append(NormalInputs(np.zeros(1), np.array([[own.std**2]])))
        return tuple(blocks)

    def _with_parameters(self) -> FloatArray:
        shared = self._instrument.shared
        return np.zeros((0, 0)) if shared is None else shared.with_parameters

    def _carried(self) -> FloatArray:
        """Return the regression of the shared errors on the parameters, shape (m, k)."""
        carried: FloatArray = self._with_parameters().T @ np.linalg.pinv(
            self._instrument.parameters.covariance, hermitian=True
        )
        return carried

    def positions(self, draws: FloatArray) -> FloatArray:
        """Return positions, mm, shape (t, n, 3), for draws of `blocks`, shape (t, K)."""
        p = self._instrument.parameters
        k, m = len(p.names), self._loadings.shape[2]
        thetas = embed(draws[:, :k], p.names)
        shared = draws[:, k : k + m]
        if m:
            shared = shared + (draws[:, :k] - p.values) @ self._carried().T
        found = []
        for i, nominal in enumerate(self._nominal):
            values = nominal + shared @ self._loadings[i].T
            for j, own in enumerate(self._own, start=k + m):
                if own.reading == i:
                    values[:, own.quantity] += draws[:, j]
            found.append(positions(thetas, Gaze(*values.T)))
        return np.stack(found, axis=1)


def _correlation(covariance: FloatArray) -> FloatArray:
    u = np.sqrt(np.diag(covariance))
    safe = np.where(u > 0, u, 1.0)
    correlation: FloatArray = covariance / np.outer(safe, safe)
    return correlation


def _require_covariance(covariance: FloatArray) -> None:
    lowest = float(np.linalg.eigvalsh(_correlation(covariance))[0])
    if lowest < -NEGATIVE:
        raise ValueError(
            "the covariance of the inputs is not positive semi-definite: the correlations of "
            f"parameters and shared errors contradict each other (eigenvalue {lowest:.2g})"
        )


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
