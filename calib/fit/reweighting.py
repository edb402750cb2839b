"""The mode of the posterior density, with the weights and the noise scale that agree with it.

Weights hang on the estimate, as effective variances do, and the noise scale on both. Few rows are
left to scipy's optimiser, round by round. Of many rows each round is one Newton step: it costs one
pass over them, and starts so near that the optimiser would take the same step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import least_squares

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.core.unit_diagonal import Spectrum
from calib.fit.groups import added_covariance
from calib.fit.noise import (
    KEPT_SHARE,
    SPARE_FREEDOM,
    Tails,
    own_sigma,
    reject_outliers,
    row_noise,
    weight,
)
from calib.fit.priors import NormalKnowledge
from calib.fit.row_sums import RowSums, sum_rows
from calib.geometry.misclosure import misclosure, misclosure_value
from calib.geometry.parameters import PARAMETERS, Model, embed
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations

ROUNDS = 12
"""Rounds of fit, weights and noise scale; they agree to six digits after three or four."""

FINAL = 1e-9
"""Relative change of estimate and scale at which rounds end."""

SMALL_STEP = 0.3
"""Newton steps are taken up to this rms change of the residuals, in units of their noise. There the
density is nearly parabolic. From a fit of 20,000 rows the first step is a twentieth of it, from one
of 24 rows with a row left out half of it."""

LAST_STEP = 1e-6
"""Length of a Newton step, in standard deviations of the estimate, after which none is taken. To
come down to it in `ROUNDS` each must be a quarter of the one before, so a third of it is left."""

AS_STATED = 2.0
"""Noise scale up to which few rows pass for clean. One gross error among six rows is hardly ever
named, as it bends the fit; but it makes the scale five and more."""


def _loss(rows: int, scale: float, tails: Tails) -> Callable[..., FloatArray]:
    """Return scipy's loss: Student-t for the first `rows` residuals, quadratic for priors."""
    count = tails.dof + 1
    width = tails.dof * (tails.core * scale) ** 2

    def loss(square: FloatArray) -> FloatArray:
        rho = np.stack([square, np.ones_like(square), np.zeros_like(square)])
        ratio = 1 + square[:rows] / width
        rho[0, :rows] = count * np.log(ratio)
        rho[1, :rows] = count / (width * ratio)
        rho[2, :rows] = -count / (width * ratio) ** 2
        return rho

    return loss


@dataclass(frozen=True)
class GroupEffect:
    """What follows from groups of rows that share the error of a reference depth.

    Parameters
    ----------
    added
        To the estimate's covariance with rows taken as independent, shape (p, p).
    followed
        Degrees of freedom that the parameters take beyond those they decide, as they follow such
        errors: these leave less of themselves in the residuals than independent ones.
    """

    added: FloatArray
    followed: float


@dataclass(frozen=True)
class Response:
    """The change of an estimate by errors of the rows.

    By the implicit function theorem on the weighted normal equations, with the weights that the
    loss leaves each row.

    Parameters
    ----------
    slope, strength
        Weighted derivative of the closures by the parameters, shape (n, p), and the weights, (n,).
    by_observable
        Derivative of the closures by what is observed, shape (n, 5).
    matrix
        From the weighted gradient to the estimate, shape (p, p).
    """

    slope: FloatArray
    strength: FloatArray
    by_observable: FloatArray
    matrix: FloatArray

    def to_shared(self, loadings: FloatArray) -> FloatArray:
        """Return the change per unit of each error that rows share, (p, k), loadings (n, 5, k)."""
        push = self.strength[:, None] * np.einsum("nq,nqk->nk", self.by_observable, loadings)
        change: FloatArray = self.matrix @ (self.slope.T @ push)
        return change

    def to_depths(self, error_mm: FloatArray) -> FloatArray:
        """Return the change by an error of each row's reference depth alone, shape (n, p)."""
        push = self.strength * self.by_observable[:, OBSERVABLE.z] * error_mm
        change: FloatArray = (self.slope * push[:, None]) @ self.matrix
        return change


@dataclass(frozen=True)
class FitSolution:
    """What the rounds of a fit arrive at.

    Parameters
    ----------
    theta
        The full parameter vector, shape (COUNT,).
    scale
        The noise scale.
    decided
        Effective number of parameters that the rows and measured knowledge decide.
    groups
        What rows do that share a reference depth.
    data
        Information of rows and measured knowledge, without the priors', shape (p, p).
    evaluations
        Evaluations of the residual.
    """

    theta: FloatArray
    scale: float
    decided: float
    groups: GroupEffect
    data: FloatArray
    evaluations: int

    def hides_no_outlier(self, rows: int) -> bool:
        """Whether so many rows would show an outlier, or scatter about as stated."""
        return rows - self.decided >= SPARE_FREEDOM or self.scale <= AS_STATED


@dataclass(frozen=True)
class FitProblem:
    """Rows, model, knowledge and tails of one fit.

    Parameters
    ----------
    prior, measured
        Of the free parameters; the second counts as data.
    noise_prior
        Mean and standard deviation of the logarithm of the noise scale.
    """

    rows: Observations
    model: Model
    prior: NormalKnowledge
    measured: NormalKnowledge
    noise_prior: tuple[float, float]
    tails: Tails

    def solve(self, theta: FloatArray, scale: float, *, accuracy: float = FINAL) -> FitSolution:
        """Return the estimate, from a start, with the weights and the scale that agree with it.

        Raises
        ------
        EstimationError
            If the rows do not determine the model or the optimiser does not converge.
        """
        free, sigma = theta[list(self.model.indices)], row_noise(theta, self.rows).sigma
        evaluations = 0
        for _ in range(ROUNDS):
            before = np.append(free, scale)
            free, count = self._minimise(free, sigma, scale)
            evaluations += count
            theta = embed(free, self.model.free)
            sums = self._sums(theta, scale)
            sigma = sums.sigma
            decided, groups = self._decided(sums), self._groups(theta, scale, sums)
            scale = self._clean_scale(sums.standardised, decided + groups.followed)
            if np.allclose(np.append(free, scale), before, rtol=accuracy, atol=1e-12):
                break
        data = sums.information + self.measured.precision
        return FitSolution(theta, scale, decided, groups, data, evaluations)

    def settle_near(self, theta: FloatArray, scale: float) -> FitSolution | None:
        """Return what `settle` does, by Newton steps from a start so near that all are small.

        None where one is not, or they do not converge. Each round looks once at the rows, for
        the step and for the noise scale; so it ends where both agree with the same estimate.
        """
        for passes in range(1, ROUNDS + 1):
            sums, before = self._sums(theta, scale), scale
            step, length = self._newton_step(theta, sums)
            if not length <= np.sqrt(len(self.rows)) * SMALL_STEP:
                return None
            theta = theta + embed(step, self.model.free)
            decided, groups = self._decided(sums), self._groups(theta, scale, sums)
            scale = self._clean_scale(sums.standardised, decided + groups.followed)
            if length <= LAST_STEP and abs(scale - before) <= FINAL * before:
                data = sums.information + self.measured.precision
                return FitSolution(theta, scale, decided, groups, data, passes)
        return None

    def noise_scale(self, standardised: FloatArray, parameters: float) -> float:
        """Return the noise scale of greatest density, parameters integrated out.

        Integrating them out (Laplace) takes one degree of freedom for each that the rows decide;
        the normal prior is on the logarithm.
        """
        mean, std = self.noise_prior
        dof, count = self.tails.dof, len(standardised)
        freedom = max(count - parameters, 0.0) / count
        square = (standardised / self.tails.core) ** 2
        near = np.empty_like(square)
        log_scale = mean
        for _ in range(100):
            np.multiply(square, np.exp(-2 * log_scale), out=near)
            near += dof
            np.reciprocal(near, out=near)
            # Sums of s / (dof + s) and dof s / (dof + s)², for the squares s at this scale.
            far = count - dof * float(near.sum())
            bend = count - far - dof**2 * float(near @ near)
            slope = (dof + 1) * far - count * freedom - (log_scale - mean) / std**2
            curvature = 2 * (dof + 1) * bend + std**-2
            step = float(np.clip(slope / curvature, -1, 1))
            log_scale += step
            if abs(step) < 1e-12:
                break
        return float(np.exp(log_scale))

    def _minimise(
        self, start: FloatArray, sigma: FloatArray, scale: float
    ) -> tuple[FloatArray, int]:
        """Return the free parameters of greatest density at fixed weights and noise scale."""
        a, b = (self.prior + self.measured).root()
        gaze, z, free = self.rows.gaze, self.rows.z_mm, list(self.model.indices)

        def residual(x: FloatArray) -> FloatArray:
            return np.concatenate(
                [misclosure_value(embed(x, self.model.free), gaze, z) / sigma, a @ x - b]
            )

        def jacobian(x: FloatArray) -> FloatArray:
            slope = misclosure(embed(x, self.model.free), gaze, z, parameters=free).by_theta
            return np.concatenate([slope / sigma[:, None], a])

        solution = least_squares(
            residual,
            start,
            jac=jacobian,
            loss=_loss(len(z), scale, self.tails),
            x_scale=np.array([PARAMETERS[i].scale for i in free]),
            xtol=1e-12,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        if solution.status == 0:
            raise EstimationError(
                f"the fit of model {self.model.name} did not converge in {solution.nfev} steps; "
                "check the rows named as outliers, the encoder's sign and the units"
            )
        best: FloatArray = solution.x
        return best, int(solution.nfev)

    def _newton_step(self, theta: FloatArray, sums: RowSums) -> tuple[FloatArray, float]:
        """Return the step to the greatest density at these weights, shape (p,), and its length.

        The length is in standard deviations of the estimate; infinite where the density curves the
        wrong way and there is no such step.
        """
        known, free = self.prior + self.measured, theta[list(self.model.indices)]
        curvature = sums.curvature + known.precision
        try:
            factor = cho_factor(curvature)
        except LinAlgError:
            return np.zeros_like(free), np.inf
        step: FloatArray = -cho_solve(factor, sums.gradient + known.precision @ free - known.shift)
        return step, float(np.sqrt(step @ curvature @ step))

    def _sums(self, theta: FloatArray, scale: float) -> RowSums:
        return sum_rows(theta, self.rows, self.model, scale=scale, tails=self.tails)

    def _decided(self, sums: RowSums) -> float:
        """Return the effective number of parameters that rows and measured knowledge decide."""
        known = self.prior.precision
        total = sums.information + self.measured.precision + known
        # Exactly p without priors: what hangs on whole degrees of freedom must not on rounding.
        return len(known) - float(np.trace(inverse(total, self.model) @ known))

    def response(self, theta: FloatArray, scale: float) -> Response:
        """Return how the estimate answers to errors of the rows."""
        c = misclosure(theta, self.rows.gaze, self.rows.z_mm, parameters=self.model.indices)
        sigma = own_sigma(c, self.rows.std)
        strength = np.sqrt(weight(c.value / sigma, scale, self.tails))
        strength /= self.tails.core * scale * sigma
        slope = strength[:, None] * c.by_theta
        known = self.prior.precision + self.measured.precision
        matrix = -inverse(slope.T @ slope + known, self.model)
        return Response(slope, strength, c.by_observable, matrix)

    def _groups(self, theta: FloatArray, scale: float, sums: RowSums) -> GroupEffect:
        """Return what follows from rows that share a reference depth."""
        if not self.rows.has_groups:
            return GroupEffect(np.zeros_like(sums.information), 0.0)
        by_row = self.response(theta, scale).to_depths(self.rows.u_z_group_mm)
        added = added_covariance(by_row, self.rows.z_group)
        total = sums.information + self.measured.precision + self.prior.precision
        return GroupEffect(added, float(np.trace(total @ added)))

    def _clean_scale(self, standardised: FloatArray, parameters: float) -> float:
        """Return the noise scale of the rows that are not rejected as outliers."""
        rejected: BoolArray = np.zeros(len(standardised), dtype=np.bool_)
        scale = self.noise_scale(standardised, parameters)
        for _ in range(len(standardised)):
            # An outlier rejected lowers the scale, and may bring another to light.
            more = rejected | reject_outliers(standardised, scale, parameters=parameters)
            if more.sum() == rejected.sum() or more.sum() > (1 - KEPT_SHARE) * len(more):
                break
            rejected = more
            scale = self.noise_scale(standardised[~rejected], parameters)
        return scale


def inverse(information: FloatArray, model: Model) -> FloatArray:
    """Return the inverse of an information matrix, or say which parameters it does not hold.

    Raises
    ------
    EstimationError
        If it is singular.
    """
    spectrum = Spectrum.of(information)
    if spectrum.span <= 1e-13:
        least_known = np.abs(spectrum.vectors[:, 0])
        involved = [n for n, v in zip(model.free, least_known, strict=True) if v > 0.1]
        raise EstimationError(
            f"the rows do not determine {', '.join(involved)} of model {model.name}; "
            "add targets at other depths and yaw angles, or state a prior"
        )
    return spectrum.inverse()
