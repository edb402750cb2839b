"""Robust maximum-likelihood fit of any model: the mode of the posterior density, and its spread.

Errors in x1c, y1c, alpha2, the gaze residual and z_ref all enter the weights; the loss is the
Student-t density of `calib.fit.noise`; priors and measured knowledge enter as residuals. Noise
scale and weights are brought into agreement with the estimate by a few rounds, first with robust
tails, which find the outliers; then, these set aside, with nearly normal ones, which lose little of
what the other rows say (a high breakdown first and efficiency after it, as the MM-estimates of
Yohai 1987, doi 10.1214/aos/1176350366).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calib.arrays import BoolArray, FloatArray
from calib.errors import EstimationError
from calib.fit.linear import residual_mrad
from calib.fit.noise import (
    CLEAN,
    KEPT_SHARE,
    ROBUST,
    SPARE_FREEDOM,
    Tails,
    is_outlier,
    row_noise,
    set_aside,
    weight,
)
from calib.fit.priors import NormalKnowledge, Priors, measured_of, prior_of
from calib.fit.start import find_start, some_rows
from calib.geometry.closure import closure, closure_value
from calib.geometry.parameters import MODELS, PARAMETERS, Model, embed
from calib.observations import Observations

ROUNDS = 12
"""Rounds of fit, weights and noise scale; they agree to six digits after three or four."""

FINAL, ROUGH = 1e-9, 1e-3
"""Relative change of estimate and scale at which rounds end; it takes no more than the second to
tell outliers from other rows."""

ROUGH_ROWS = 20_000
"""Rows that are enough for that: they tell the scale to half a percent."""

AS_STATED = 2.0
"""Noise scale up to which few rows pass for clean. One gross error among six rows is hardly ever
named, as it bends the fit; but it makes the scale five and more."""

SPARE_ROWS = 3
"""Rows beyond the parameters: fewer leave the noise scale to its prior."""

LEFT_TO_PRIOR = ("eccentricity_mm",)
"""Parameters that gaze rows hardly ever tell from others, and therefore need no row."""

MINIMUM_HEIGHT = 0.05
"""Least spread of y1c for a tilt: at 1 deg of tilt it moves the gaze by 0.9 mrad, three steps of
the paper's motor."""


@dataclass(frozen=True)
class RobustFit:
    """The robust fit of one model.

    Parameters
    ----------
    model
        Its name.
    names
        Free parameters, p of them.
    values
        Shape (p,).
    covariance
        Shape (p, p), with the errors shared by all rows.
    by_shared
        Change of the values per unit of each shared standard-normal error, shape (p, k); its
        square is contained in `covariance`.
    residual_mrad
        (num / z) - (x1c + cot a), mrad, shape (n,).
    sigma_mrad
        Standard deviation of the residuals of rows that are not outliers, with their number less
        `data_parameters` as degrees of freedom.
    standardised
        Closure over its stated uncertainty, shape (n,).
    noise_scale
        Factor by which the stated uncertainties are too small (above 1) or too large.
    outliers
        Rows that disagree with the others, by id.
    aside
        Which rows say nothing, shape (n,): outliers, where enough other rows remain.
    tails
        Of the rows' density.
    data_parameters
        Effective number of parameters that the rows decide (the rest is decided by priors).
    identified_by
        "data", "prior" or "both" for each parameter.
    data_share
        Standard deviation / that without priors, shape (p,): 1 where the data alone decide.
    evaluations
        Evaluations of the residual that the optimiser took.
    """

    model: str
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    by_shared: FloatArray
    residual_mrad: FloatArray
    sigma_mrad: float
    standardised: FloatArray
    noise_scale: float
    outliers: tuple[str, ...]
    aside: BoolArray
    tails: Tails
    data_parameters: float
    identified_by: tuple[str, ...]
    data_share: FloatArray
    evaluations: int

    @property
    def theta(self) -> FloatArray:
        """The full parameter vector, shape (COUNT,)."""
        return embed(self.values, self.names)


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
class _Problem:
    """Rows, model, knowledge and tails of one fit."""

    rows: Observations
    model: Model
    prior: NormalKnowledge
    measured: NormalKnowledge
    noise_prior: tuple[float, float]
    tails: Tails

    def minimise(
        self, start: FloatArray, sigma: FloatArray, scale: float
    ) -> tuple[FloatArray, int]:
        """Return the free parameters of greatest density at fixed weights and noise scale."""
        a, b = (self.prior + self.measured).root()
        gaze, z, free = self.rows.gaze, self.rows.z_mm, list(self.model.indices)

        def residual(x: FloatArray) -> FloatArray:
            return np.concatenate(
                [closure_value(embed(x, self.model.free), gaze, z) / sigma, a @ x - b]
            )

        def jacobian(x: FloatArray) -> FloatArray:
            slope = closure(embed(x, self.model.free), gaze, z, parameters=free).by_theta
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

    def noise_scale(self, standardised: FloatArray, parameters: float) -> float:
        """Return the noise scale of greatest density, parameters integrated out.

        Integrating them out (Laplace) takes one degree of freedom for each that the rows decide;
        the normal prior is on the logarithm.
        """
        mean, std = self.noise_prior
        dof, count = self.tails.dof, len(standardised)
        freedom = max(count - parameters, 0.0) / count
        log_scale = mean
        for _ in range(100):
            square = (standardised / self.tails.core) ** 2 * np.exp(-2 * log_scale)
            pull = (dof + 1) * square / (dof + square)
            slope = float(pull.sum()) - count * freedom - (log_scale - mean) / std**2
            curvature = float((2 * (dof + 1) * dof * square / (dof + square) ** 2).sum()) + std**-2
            step = float(np.clip(slope / curvature, -1, 1))
            log_scale += step
            if abs(step) < 1e-12:
                break
        return float(np.exp(log_scale))

    def clean_scale(self, standardised: FloatArray, parameters: float) -> float:
        """Return the noise scale of the rows that are not set aside as outliers."""
        aside = np.zeros(len(standardised), dtype=np.bool_)
        scale = self.noise_scale(standardised, parameters)
        for _ in range(len(standardised)):
            # An outlier set aside lowers the scale, and may bring another to light.
            more = aside | set_aside(standardised, scale, parameters=parameters)
            if more.sum() == aside.sum() or more.sum() > (1 - KEPT_SHARE) * len(more):
                break
            aside = more
            scale = self.noise_scale(standardised[~aside], parameters)
        return scale

    def information(self, theta: FloatArray, sigma: FloatArray, scale: float) -> FloatArray:
        """Return the rows' Fisher information, outliers left out, shape (p, p)."""
        c = closure(theta, self.rows.gaze, self.rows.z_mm, parameters=self.model.indices)
        slope = c.by_theta / (sigma * scale)[:, None]
        slope = slope[~is_outlier(c.value / sigma, scale)]
        information: FloatArray = self.tails.efficiency * slope.T @ slope
        return information

    def settle(self, theta: FloatArray, scale: float, *, accuracy: float = FINAL) -> _Solution:
        """Return the estimate, from a start, with the weights and the scale that agree with it."""
        rows, free = self.rows, theta[list(self.model.indices)]
        sigma = row_noise(theta, rows).sigma
        evaluations = 0
        for _ in range(ROUNDS):
            before = np.append(free, scale)
            free, count = self.minimise(free, sigma, scale)
            evaluations += count
            theta = embed(free, self.model.free)
            sigma = row_noise(theta, rows).sigma
            data = self.information(theta, sigma, scale) + self.measured.precision
            decided = float(np.trace(_inverse(data + self.prior.precision, self.model) @ data))
            scale = self.clean_scale(closure_value(theta, rows.gaze, rows.z_mm) / sigma, decided)
            if np.allclose(np.append(free, scale), before, rtol=accuracy, atol=1e-12):
                break
        return _Solution(theta, scale, decided, data, evaluations)


def fit_model(rows: Observations, priors: Priors, *, model: str) -> RobustFit:
    """Return the robust fit of the model of that name, if the rows can carry it.

    Raises
    ------
    EstimationError
        If they cannot, with the reason.
    """
    reason = too_much(rows, MODELS[model])
    if reason is not None:
        raise EstimationError(reason)
    return fit_robust(rows, MODELS[model], priors)


def too_much(rows: Observations, model: Model) -> str | None:
    """Return why `rows` cannot carry `model`, None if they can."""
    wanted = len([name for name in model.free if name not in LEFT_TO_PRIOR]) + SPARE_ROWS
    if len(rows) < wanted:
        return (
            f"{len(rows)} rows; {wanted} are needed, {SPARE_ROWS} more than the parameters that "
            "rows can tell apart, or the noise cannot be judged"
        )
    if model.needs_height and not rows.has_height:
        return "the rows give no y1c, and only targets above and below C1's axis show a tilt"
    if model.needs_height and np.ptp(rows.y1c) < MINIMUM_HEIGHT:
        return (
            f"y1c spans {np.ptp(rows.y1c):.3f} only; tilts need targets over {MINIMUM_HEIGHT} "
            "of it, above and below C1's axis"
        )
    return None


def fit_robust(
    rows: Observations, model: Model, priors: Priors, *, start: FloatArray | None = None
) -> RobustFit:
    """Return the robust fit of `model`.

    Parameters
    ----------
    start
        A full parameter vector near the answer, shape (COUNT,), where one is known (a fit of most
        of these rows); else the fit finds its own.

    Raises
    ------
    EstimationError
        If the rows do not determine the model or the optimiser does not converge.
    """
    problem = _Problem(
        rows=rows,
        model=model,
        prior=prior_of(model, priors),
        measured=measured_of(model, priors),
        noise_prior=priors.noise_scale,
        tails=ROBUST,
    )
    theta = find_start(rows, axis_z="axis_z_mm" in model.free) if start is None else start
    some = replace(problem, rows=some_rows(rows, ROUGH_ROWS))
    scale = some.noise_scale(_standardised(theta, some.rows), 0.0)
    found = some.settle(theta, scale, accuracy=ROUGH)
    standardised = _standardised(found.theta, rows)
    aside = set_aside(standardised, found.scale, parameters=found.decided)
    plain = np.array_equal(aside, is_outlier(standardised, found.scale))
    if plain and found.hides_no_outlier(len(rows)):
        problem = replace(problem, rows=rows.take(~aside) if aside.any() else rows, tails=CLEAN)
    final = problem.settle(found.theta, found.scale)
    final = replace(final, evaluations=found.evaluations + final.evaluations)
    return _describe(problem, final, rows, aside)


def _standardised(theta: FloatArray, rows: Observations) -> FloatArray:
    """Return the closures over their stated uncertainties, shape (n,)."""
    standardised: FloatArray = closure_value(theta, rows.gaze, rows.z_mm) / (
        row_noise(theta, rows).sigma
    )
    return standardised


@dataclass(frozen=True)
class _Solution:
    """What the rounds of a fit arrive at; `decided` and `data` without the priors' part."""

    theta: FloatArray
    scale: float
    decided: float
    data: FloatArray
    evaluations: int

    def hides_no_outlier(self, rows: int) -> bool:
        """Whether so many rows would show an outlier, or scatter about as stated."""
        return rows - self.decided >= SPARE_FREEDOM or self.scale <= AS_STATED


def _inverse(information: FloatArray, model: Model) -> FloatArray:
    """Return the inverse of an information matrix, or say which parameters it does not hold."""
    diagonal = np.diag(information)
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    value, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    if value[0] <= 1e-13 * value[-1]:
        involved = [n for n, v in zip(model.free, vectors[:, 0], strict=True) if abs(v) > 0.1]
        raise EstimationError(
            f"the rows do not determine {', '.join(involved)} of model {model.name}; "
            "add targets at other depths and yaw angles, or state a prior"
        )
    inverse: FloatArray = (vectors / value) @ vectors.T * np.outer(unit, unit)
    return inverse


def _describe(problem: _Problem, fit: _Solution, rows: Observations, aside: BoolArray) -> RobustFit:
    """Return the fit with its uncertainties and what decided each parameter.

    Parameters
    ----------
    rows, aside
        All rows, and which of them `problem` has not.
    """
    model, prior = problem.model, problem.prior
    own = _inverse(fit.data + prior.precision, model)
    by_shared = _by_shared(problem, fit)
    standardised = _standardised(fit.theta, rows)
    outlier = aside | is_outlier(standardised, fit.scale)
    residual = residual_mrad(fit.theta, rows)
    freedom = max(float(np.sum(~outlier)) - fit.decided, 1.0)
    # A trace of the prior keeps the matrix regular where the data say nothing at all.
    alone = np.diag(_inverse(fit.data + NEARLY_NO_PRIOR * prior.precision, model))
    share = np.sqrt(np.diag(own) / alone)
    return RobustFit(
        model=model.name,
        names=model.free,
        values=fit.theta[list(model.indices)],
        covariance=own + by_shared @ by_shared.T,
        by_shared=by_shared,
        residual_mrad=residual,
        sigma_mrad=float(np.sqrt((residual[~outlier] ** 2).sum() / freedom)),
        standardised=standardised,
        noise_scale=fit.scale,
        outliers=tuple(i for i, bad in zip(rows.ids, outlier, strict=True) if bad),
        aside=aside,
        tails=problem.tails,
        data_parameters=fit.decided,
        identified_by=tuple(identified_by(x) for x in share),
        data_share=share,
        evaluations=fit.evaluations,
    )


NEARLY_NO_PRIOR = 1e-8
"""Share of the prior's precision left when asking what the data alone determine."""


def identified_by(data_share: float) -> str:
    """Return who decided a parameter, from its standard deviation over that without priors."""
    if data_share > DECIDED:
        return "data"
    return "prior" if data_share < 1 - DECIDED else "both"


DECIDED = 0.75
"""Above it the data decided a parameter, below 1 - DECIDED the prior, between them both did.

At 0.75 the priors, of this parameter and of those tied to it, take a quarter off the standard
deviation that the data alone would give; at 0.25 three quarters."""


def _by_shared(problem: _Problem, fit: _Solution) -> FloatArray:
    """Return the change of the estimate per unit of each shared error, shape (p, k).

    By the implicit function theorem on the weighted normal equations, with the weights that the
    loss leaves each row.
    """
    rows, model, tails = problem.rows, problem.model, problem.tails
    if not rows.shared_names:
        return np.zeros((len(model.free), 0))
    c = closure(fit.theta, rows.gaze, rows.z_mm, parameters=model.indices)
    sigma = row_noise(fit.theta, rows).sigma
    strength = np.sqrt(weight(c.value / sigma, fit.scale, tails)) / (tails.core * fit.scale * sigma)
    slope = strength[:, None] * c.by_theta
    push = strength[:, None] * np.einsum("nq,nqk->nk", c.by_observable, rows.shared)
    known = problem.prior.precision + problem.measured.precision
    change: FloatArray = -_inverse(slope.T @ slope + known, model) @ (slope.T @ push)
    return change
