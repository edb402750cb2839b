"""The posterior of a model by emcee, with importance sampling as the second computation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.fit.chains import Chains, Progress, run_chains
from calib.fit.density import LogPosterior, log_posterior
from calib.fit.importance import ImportanceSample, sample_importance
from calib.fit.modes import LeftOutMode, find_left_out_mode
from calib.fit.priors import NOISE_SCALE, Priors
from calib.fit.robust import RobustFit
from calib.geometry.parameters import IdentifiedBy
from calib.rows.observations import Observations

STORED_DRAWS = 16_000
"""Draws kept after thinning, over all ensembles."""

AGREEMENT_SIGMA = 4.0
"""Standard errors by which the two computations' means may differ."""

AGREEMENT_FLOOR = 0.03
"""Difference, in posterior standard deviations, that no user could notice."""

SEARCH_ROWS = 500
"""Rows by which other modes are looked for; all rows judge what is found."""

QUARTER_TURN_RAD = np.pi / 2
"""Angles are looked for within a quarter turn about 0: half a turn on, the plane is the same."""

SPREAD_FLOOR = 0.1
"""Relative difference allowed of the two computations' central 68 % intervals."""

CENTRAL = (0.158655, 0.841345)


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior of one model, and whether they can be trusted.

    Parameters
    ----------
    model
        Its name.
    names
        The p free parameters, then the logarithm of the noise scale.
    draws
        Thinned draws, shape (ensembles, draws, p + 1), shared errors included.
    common
        The shared standard-normal errors that went with each draw, shape (ensembles, draws, k).
    mean, covariance, quantiles
        Of the draws: shapes (p + 1,), (p + 1, p + 1) and (p + 1, 3) at 2.5, 50 and 97.5 %. What
        the shared errors add to mean and covariance is known and not left to their draws.
    ess_bulk, ess_tail, r_hat, tau
        Effective draws in the bulk and in the tails, R-hat across ensembles, autocorrelation time
        in steps; shape (p + 1,) each.
    acceptance
        Share of proposals accepted.
    steps
        Steps of each ensemble, without burn-in.
    converged
        Whether all limits hold, and no mode was left out.
    left_out
        A mode of the density that both computations have left out, None if none was found.
    k_hat, importance_ess, importance_mean, importance_std
        The second computation.
    agreement
        Largest difference of the means, in units of what is allowed; at most 1 if they agree.
    agrees
        Whether the second computation is reliable and confirms means and spreads.
    identified_by
        "data", "prior" or "both", by free parameter.
    """

    model: str
    names: tuple[str, ...]
    draws: FloatArray
    common: FloatArray
    mean: FloatArray
    covariance: FloatArray
    quantiles: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    r_hat: FloatArray
    tau: FloatArray
    acceptance: float
    steps: int
    converged: bool
    left_out: LeftOutMode | None
    k_hat: float
    importance_ess: float
    importance_mean: FloatArray
    importance_std: FloatArray
    agreement: float
    agrees: bool
    identified_by: tuple[IdentifiedBy, ...]

    @property
    def flat(self) -> FloatArray:
        """All draws, shape (m, p + 1)."""
        return self.draws.reshape(-1, len(self.names))


def posterior_of(fit: RobustFit, rows: Observations, priors: Priors) -> LogPosterior:
    """Return the log posterior density of the model of `fit`, with its outliers and tails."""
    return log_posterior(
        rows,
        fit.structure,
        priors,
        fit.theta,
        rejected=fit.rejected,
        tails=fit.tails,
        followed=fit.group_freedom,
    )


def laplace(fit: RobustFit, target: LogPosterior) -> tuple[FloatArray, FloatArray]:
    """Return centre, (p + 1,), and covariance of a normal density near the posterior.

    The noise scale has about n - p rows to it, and its prior.
    """
    taken = fit.data_parameters + fit.group_freedom
    rows_for_scale = max(np.count_nonzero(target.power) - taken, 0.0)
    centre = np.append(fit.values, np.log(fit.noise_scale))
    covariance = np.zeros((len(centre), len(centre)))
    covariance[:-1, :-1] = fit.covariance - fit.by_shared @ fit.by_shared.T
    covariance[-1, -1] = 1 / (rows_for_scale + target.noise_prior[1] ** -2)
    return centre, covariance


def sample_posterior(
    rows: Observations,
    fit: RobustFit,
    priors: Priors,
    *,
    seed: SeedSequence,
    progress: Progress | None = None,
) -> Posterior:
    """Return the posterior of the model of `fit`.

    Parameters
    ----------
    seed
        Source of all random numbers; the same one gives the same draws.

    Raises
    ------
    EstimationError
        If the density is not finite near the fit, or the importance sample too poor to start from.
    """
    target = posterior_of(fit, rows, priors)
    for_importance, for_shared, for_chains, for_search = seed.spawn(4)
    centre, covariance = laplace(fit, target)
    sample = sample_importance(target, centre, covariance, np.random.default_rng(for_importance))
    left_out = look_for_left_out(target, sample, np.random.default_rng(for_search))
    chains = run_chains(
        target, sample, seed=for_chains, trusted=left_out is None, progress=progress
    )
    return _summarise(chains, sample, left_out, fit, np.random.default_rng(for_shared))


def look_for_left_out(
    target: LogPosterior, sample: ImportanceSample, rng: np.random.Generator
) -> LeftOutMode | None:
    """Return a mode of the posterior that the sample has left out, None if none is found."""
    angles = [i for i, name in enumerate(target.model.free) if name.endswith("_rad")]
    heard = np.flatnonzero(target.power)
    some = target
    if len(heard) > SEARCH_ROWS:
        some = target.only(heard[np.linspace(0, len(heard) - 1, SEARCH_ROWS).astype(np.int64)])

    def within(density: LogPosterior) -> Callable[[FloatArray], FloatArray]:
        def of(x: FloatArray) -> FloatArray:
            outside = np.abs(x[:, angles]).max(axis=1) > QUARTER_TURN_RAD
            return np.where(outside, -np.inf, density(x))

        return of

    widening = float(np.sqrt(max(len(heard) / SEARCH_ROWS, 1.0)))
    found = find_left_out_mode(within(some), sample, rng, widening=widening)
    if found is None or some is target:
        return found
    return find_left_out_mode(within(target), sample, rng, near=found.place)


def _summarise(
    chains: Chains,
    sample: ImportanceSample,
    left_out: LeftOutMode | None,
    fit: RobustFit,
    rng: np.random.Generator,
) -> Posterior:
    """Return the posterior with its diagnostics; shared errors are added to thinned draws."""
    ensembles, steps, walkers, d = chains.chain.shape
    agreement, agrees = _agreement(chains.chain.reshape(-1, d), chains.ess_bulk, sample)
    thin = max(1, -(-ensembles * steps * walkers // STORED_DRAWS))
    kept = chains.chain[:, thin - 1 :: thin].reshape(ensembles, -1, d)
    common = rng.standard_normal((*kept.shape[:2], fit.by_shared.shape[1]))
    draws = kept.copy()
    draws[..., :-1] += common @ fit.by_shared.T
    covariance = np.cov(kept.reshape(-1, d), rowvar=False)
    covariance[:-1, :-1] += fit.by_shared @ fit.by_shared.T
    return Posterior(
        model=fit.model,
        names=(*fit.names, NOISE_SCALE),
        draws=draws,
        common=common,
        mean=kept.reshape(-1, d).mean(axis=0),
        covariance=covariance,
        quantiles=np.quantile(draws.reshape(-1, d), [0.025, 0.5, 0.975], axis=0).T,
        ess_bulk=chains.ess_bulk,
        ess_tail=chains.ess_tail,
        r_hat=chains.r_hat,
        tau=chains.tau,
        acceptance=chains.acceptance,
        steps=steps,
        converged=chains.converged and left_out is None,
        left_out=left_out,
        k_hat=sample.k_hat,
        importance_ess=sample.ess,
        importance_mean=sample.mean,
        importance_std=np.sqrt(np.diag(sample.covariance)),
        agreement=agreement,
        agrees=agrees,
        identified_by=fit.identified_by,
    )


def _agreement(flat: FloatArray, ess: FloatArray, sample: ImportanceSample) -> tuple[float, bool]:
    """Return the means' difference in units of what is allowed, and whether all agrees."""
    std = flat.std(axis=0)
    error = AGREEMENT_SIGMA * np.sqrt(1 / ess + 1 / max(sample.ess, 1.0)) + AGREEMENT_FLOOR
    difference = np.abs(flat.mean(axis=0) - sample.mean) / std / error
    own, other = np.quantile(flat, CENTRAL, axis=0), sample.quantiles(CENTRAL)
    spread = np.abs(np.log((other[1] - other[0]) / (own[1] - own[0])))
    agreement = float(difference.max())
    return agreement, bool(sample.reliable and agreement <= 1 and spread.max() <= SPREAD_FLOOR)
