"""Robust maximum-likelihood fit of any model: the mode of the posterior density, and its spread.

Errors in x1c, y1c, alpha2, the gaze residual and z_ref all enter the weights; the loss is the
Student-t density of `calib.fit.noise`; priors and measured knowledge enter as residuals. Noise
scale and weights are brought into agreement with the estimate by a few rounds, first with robust
tails, which find the outliers; then, these rejected, with nearly normal ones, which lose little of
what the other rows say (a high breakdown first and efficiency after it, as the MM-estimates of
Yohai 1987, doi 10.1214/aos/1176350366).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.fit.groups import wider_part
from calib.fit.noise import CLEAN, ROBUST, Tails, is_outlier, reject_outliers
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.reweighting import FitProblem, FitSolution, inverse
from calib.fit.row_sums import residuals
from calib.fit.start import find_start, some_rows
from calib.geometry.parameters import (
    MODELS,
    REFERENCE_OFFSET,
    STANDOFF,
    IdentifiedBy,
    Model,
    embed,
    model_for,
)
from calib.rows.observations import GROUP_SOURCE, Observations

ROUGH = 1e-3
"""Relative change of estimate and scale at which they tell outliers from other rows."""

ROUGH_ROWS = 20_000
"""Rows that are enough for that: they tell the scale to half a percent."""

SPARE_ROWS = 3
"""Rows beyond the parameters: fewer leave the noise scale to its prior."""

LEFT_TO_PRIOR = ("eccentricity_mm", STANDOFF, REFERENCE_OFFSET)
"""Parameters that gaze rows hardly ever tell from others, or at all, and therefore need no row."""

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
        square is contained in `covariance`. The errors are those of the rows, and after them what
        groups of rows add that share a reference depth (`calib.fit.groups`).
    shared_names
        One name a shared error, length k.
    residual_mrad
        (num / z) - (x1c + cot a), mrad, shape (n,).
    sigma_mrad
        Standard deviation of the residuals of rows that are not outliers, with their number less
        `data_parameters` as degrees of freedom.
    standardised
        Misclosure over its stated uncertainty, shape (n,).
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
    group_freedom
        Degrees of freedom that the parameters take beyond these, as they follow the errors that
        rows of a group share.
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
    shared_names: tuple[str, ...]
    residual_mrad: FloatArray
    sigma_mrad: float
    standardised: FloatArray
    noise_scale: float
    outliers: tuple[str, ...]
    rejected: BoolArray
    tails: Tails
    data_parameters: float
    group_freedom: float
    identified_by: tuple[IdentifiedBy, ...]
    data_share: FloatArray
    evaluations: int

    @property
    def by_groups(self) -> FloatArray:
        """What of `by_shared` groups of rows with one reference depth add, shape (p, r)."""
        return self.by_shared[:, [name == GROUP_SOURCE for name in self.shared_names]]

    @property
    def structure(self) -> Model:
        """The model with the parameters that were free in the fit."""
        return replace(MODELS[self.model], free=self.names)

    @property
    def theta(self) -> FloatArray:
        """The full parameter vector, shape (COUNT,)."""
        return embed(self.values, self.names)


def fit_model(rows: Observations, priors: Priors, *, model: str) -> RobustFit:
    """Return the robust fit of the model of that name, if the rows can carry it.

    Raises
    ------
    EstimationError
        If they cannot, with the reason.
    """
    free = model_for(model, off_centre=rows.off_centre, offset_open=priors.offset_open)
    reason = too_much(rows, free)
    if reason is not None:
        raise EstimationError(reason)
    return fit_robust(rows, free, priors)


def too_much(rows: Observations, model: Model) -> str | None:
    """Return why `rows` cannot carry `model`, None if they can."""
    wanted = len([name for name in model.free if name not in LEFT_TO_PRIOR]) + SPARE_ROWS
    if len(rows) < wanted:
        return (
            f"{len(rows)} rows; {wanted} are needed, {SPARE_ROWS} more than the parameters that "
            "rows can distinguish, or the noise cannot be judged"
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
    problem = FitProblem(
        rows=rows,
        model=model,
        prior=prior_of(model, priors),
        measured=measured_of(model, priors),
        noise_prior=priors.noise_scale,
        tails=ROBUST,
    )
    theta = find_start(rows, axis_z="axis_z_mm" in model.free) if start is None else start
    some = replace(problem, rows=some_rows(rows, ROUGH_ROWS))
    scale = some.noise_scale(residuals(theta, some.rows).standardised, 0.0)
    found = None if start is None else some.settle_near(theta, scale)
    if found is None:
        found = some.solve(theta, scale, accuracy=ROUGH)
    standardised = residuals(found.theta, rows).standardised
    rejected = reject_outliers(standardised, found.scale, parameters=found.decided)
    plain = np.array_equal(rejected, is_outlier(standardised, found.scale))
    if plain and found.hides_no_outlier(len(rows)):
        problem = replace(
            problem, rows=rows.take(~rejected) if rejected.any() else rows, tails=CLEAN
        )
    final = problem.settle_near(found.theta, found.scale)
    if final is None:
        final = problem.solve(found.theta, found.scale)
    final = replace(final, evaluations=found.evaluations + final.evaluations)
    return _describe(problem, final, rows, rejected)


def _describe(
    problem: FitProblem, fit: FitSolution, rows: Observations, rejected: BoolArray
) -> RobustFit:
    """Return the fit with its uncertainties and what decided each parameter.

    Parameters
    ----------
    rows, aside
        All rows, and which of them `problem` has not.
    """
    model, prior = problem.model, problem.prior
    own = inverse(fit.data + prior.precision, model)
    by_shared = _by_shared(problem, fit, own)
    named = (*rows.shared_names, *rows.alone_names)
    added = by_shared.shape[1] - len(named)
    found = residuals(fit.theta, rows)
    standardised, residual = found.standardised, found.mrad
    outlier = rejected | is_outlier(standardised, fit.scale)
    freedom = max(float(np.sum(~outlier)) - fit.decided, 1.0)
    # A trace of the prior keeps the matrix regular where the data say nothing at all.
    alone = np.diag(inverse(fit.data + NEARLY_NO_PRIOR * prior.precision, model))
    share = np.sqrt(np.diag(own) / alone)
    return RobustFit(
        model=model.name,
        names=model.free,
        values=fit.theta[list(model.indices)],
        covariance=own + by_shared @ by_shared.T,
        by_shared=by_shared,
        shared_names=(*named, *(GROUP_SOURCE,) * added),
        residual_mrad=residual,
        sigma_mrad=float(np.sqrt((residual[~outlier] ** 2).sum() / freedom)),
        standardised=standardised,
        noise_scale=fit.scale,
        outliers=tuple(rows.ids[i] for i in np.flatnonzero(outlier)),
        rejected=rejected,
        tails=problem.tails,
        data_parameters=fit.decided,
        group_freedom=fit.groups.followed,
        identified_by=tuple(identified_by(x) for x in share),
        data_share=share,
        evaluations=fit.evaluations,
    )


NEARLY_NO_PRIOR = 1e-8
"""Share of the prior's precision left when asking what the data alone determine."""


def identified_by(data_share: float) -> IdentifiedBy:
    """Return who decided a parameter, from its standard deviation over that without priors."""
    if data_share > DECIDED:
        return "data"
    return "prior" if data_share < 1 - DECIDED else "both"


DECIDED = 0.75
"""Above it the data decided a parameter, below 1 - DECIDED the prior, between them both did.

At 0.75 the priors, of this parameter and of those tied to it, take a quarter off the standard
deviation that the data alone would give; at 0.25 three quarters."""


def _by_shared(problem: FitProblem, fit: FitSolution, own: FloatArray) -> FloatArray:
    """Return the change of the estimate per unit of each shared error, shape (p, k).

    Parameters
    ----------
    own
        Covariance of the estimate without shared errors, shape (p, p).
    """
    rows = problem.rows
    change = np.zeros((len(problem.model.free), 0))
    if rows.shared_names:
        change = problem.response(fit.theta, fit.scale).to_shared(rows.shared)
    if rows.alone_names:
        alone = problem.response(fit.theta, fit.scale).to_shared(rows.alone)
        change = np.hstack([change, alone])
    if rows.has_groups:
        change = np.hstack([change, wider_part(fit.groups.added, own, noise_scale=fit.scale)])
    return change
