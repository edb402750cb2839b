"""The posterior of a model by emcee, with importance sampling as the second computation.

Several independent ensembles of walkers start from different draws of the importance sample, which
is from the posterior already: there is no burn-in to discard. Each walks by differential evolution
(ter Braak 2006, doi 10.1007/s11222-006-8769-1), one step in ten with the factor 1 that carries a
walker from mode to mode. Of long tables, whose posterior is nearly normal, most steps propose a
fresh point from a t density with the importance sample's mean and covariance, accepted or not by
Metropolis and Hastings: a chain so forgets its past in two to four steps and not in ten to thirty,
each of which looks at all rows. The remaining steps, which know nothing of that sample, would show
by their drift if it were not from the posterior. emcee's snooker move is left out: in emcee 3.1.6
its acceptance does not keep detailed balance, and a share of one fifth in the mix makes the
variance of a unit normal in five dimensions 6 % too small (docs/decisions.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import emcee
import numpy as np
from arviz_stats.base import array_stats
from numpy.random import MT19937, RandomState, SeedSequence
from scipy.special import ndtri
from scipy.stats import rankdata

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.fit.density import LogPosterior, log_posterior
from calib.fit.importance import ImportanceSample, Proposal, sample_importance
from calib.fit.priors import NOISE_SCALE, Priors
from calib.fit.robust import RobustFit
from calib.rows.observations import Observations

ENSEMBLES = 4
"""Independent ensembles: R-hat compares them; the walkers of one are not independent."""

WALKERS = 32
"""Walkers an ensemble, or four a dimension where that is more."""

BLOCK_STEPS = 1000
"""Steps from which on convergence is looked at, and by which a chain is prolonged."""

LONG_TABLE = 5000
"""Rows from which on most steps are independent proposals: it is hardly ever refused there."""

INDEPENDENT_SHARE = 0.8
"""Share of such steps."""

LONG_TABLE_BLOCK_STEPS = 100
"""The same for a long table: 400 or so are enough."""

MAXIMUM_STEPS = 60_000
"""Steps after which the chain is given up: three times what the worst rig tried has needed."""

TAU_MULTIPLE = 100.0
"""Autocorrelation times a chain must hold before its own estimate of them can be trusted.

emcee's authors ask for 50; R-hat below 1.01 takes about 100.
"""

ESS_GOAL = 4000.0
"""Effective draws a parameter: 1.6 % on a mean in units of sigma, 4 % on a 95 % limit."""

R_HAT_LIMIT = 1.01
"""Vehtari et al. 2021, doi 10.1214/20-BA1221."""

STEPS_A_TAU = 5
"""Steps an autocorrelation time from which effective draws are told. Where correlations fall off
exponentially, 1.3 % fewer are found than by all steps; in the tails, which forget sooner, 5 %."""

STORED_DRAWS = 16_000
"""Draws kept after thinning, over all ensembles."""

AGREEMENT_SIGMA = 4.0
"""Standard errors by which the two computations' means may differ."""

AGREEMENT_FLOOR = 0.03
"""Difference, in posterior standard deviations, that no user could notice."""

SPREAD_FLOOR = 0.1
"""Relative difference allowed of the two computations' central 68 % intervals."""

CENTRAL = (0.158655, 0.841345)

Progress = Callable[[int, int], None]
"""Told how far a computation is: steps done, steps expected."""


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
        Steps of each ensemble.
    converged
        Whether all limits hold.
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
    k_hat: float
    importance_ess: float
    importance_mean: FloatArray
    importance_std: FloatArray
    agreement: float
    agrees: bool
    identified_by: tuple[str, ...]

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
    for_importance, for_shared, for_start, *for_chains = seed.spawn(3 + ENSEMBLES)
    centre, covariance = laplace(fit, target)
    sample = sample_importance(target, centre, covariance, np.random.default_rng(for_importance))
    chains = _run(target, sample, for_start, for_chains, progress)
    return _summarise(chains, sample, fit, np.random.default_rng(for_shared))


@dataclass(frozen=True)
class _Chains:
    """Full chains, shape (ensembles, steps, walkers, d), with what was found of them."""

    chain: FloatArray
    tau: FloatArray
    acceptance: float
    converged: bool


def _run(
    target: LogPosterior,
    sample: ImportanceSample,
    for_start: SeedSequence,
    seeds: list[SeedSequence],
    progress: Progress | None,
) -> _Chains:
    """Walk all ensembles, block by block, until they have converged or are given up."""
    walkers = max(WALKERS, 4 * target.dimensions)
    if np.count_nonzero(sample.weights) < ENSEMBLES * walkers:
        raise EstimationError("too few importance draws carry weight to start the walkers from")
    starts = sample.resample(ENSEMBLES * walkers, np.random.default_rng(for_start))
    moves, block = _walk(), BLOCK_STEPS
    if len(target.rows) >= LONG_TABLE:
        moves, block = _with_independent(moves, sample.proposal), LONG_TABLE_BLOCK_STEPS
    samplers, states = [], []
    for i, seed in enumerate(seeds):
        samplers.append(_sampler(target, walkers, moves))
        random_state = RandomState(MT19937(seed)).get_state()
        states.append(emcee.State(starts[i::ENSEMBLES], random_state=random_state))
    expected, done, look = float(block), 0, block
    while True:
        for i, sampler in enumerate(samplers):
            states[i] = sampler.run_mcmc(states[i], block)
            if progress is not None:
                progress(int(done + block * (i + 1) / ENSEMBLES), int(expected))
        done += block
        if done < look:
            continue
        chain = np.stack([s.get_chain() for s in samplers])
        with np.errstate(over="ignore", invalid="ignore"):
            tau = np.mean([_tau(c) for c in chain], axis=0)
        if not np.isfinite(tau).all():
            raise EstimationError(
                "the walkers run away without bound: rows and priors leave the parameters open"
            )
        expected = max(TAU_MULTIPLE, ESS_GOAL / (ENSEMBLES * walkers)) * float(tau.max())
        converged = done >= expected and float(_r_hat(chain).max()) < R_HAT_LIMIT
        if converged or done >= MAXIMUM_STEPS:
            break
        # A short chain takes its autocorrelation times for shorter than they are.
        look = min(int(expected), 2 * done, MAXIMUM_STEPS)
    acceptance = float(np.mean([s.acceptance_fraction.mean() for s in samplers]))
    return _Chains(chain, tau, acceptance, converged)


Moves: TypeAlias = list[tuple[Any, float]]
"""emcee's moves, each with its share."""


def _walk() -> Moves:
    return [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]


def _with_independent(walk: Moves, proposal: Proposal) -> Moves:
    """Return a mix of independent proposals and a walk."""

    def propose(x: FloatArray, random: RandomState) -> tuple[FloatArray, FloatArray]:
        fresh = proposal.draw(len(x), random)
        return fresh, proposal.log_density(x) - proposal.log_density(fresh)

    rest = [(move, (1 - INDEPENDENT_SHARE) * share) for move, share in walk]
    return [(emcee.moves.MHMove(propose), INDEPENDENT_SHARE), *rest]


def _sampler(target: LogPosterior, walkers: int, moves: Moves) -> emcee.EnsembleSampler:
    sampler = emcee.EnsembleSampler(
        walkers,
        target.dimensions,
        target,
        vectorize=True,
        moves=moves,
    )
    # emcee wraps the function to print a traceback of whatever comes out of it, Ctrl-C too.
    sampler.log_prob_fn = target
    return sampler


def _tau(chain: FloatArray) -> FloatArray:
    """Return integrated autocorrelation times, steps, of a chain (steps, walkers, d)."""
    if not np.ptp(chain, axis=0).all():
        # A walker that stayed at one value, as indicators may, has none: join all end to end.
        chain = chain.swapaxes(0, 1).reshape(-1, 1, chain.shape[2])
    tau: FloatArray = emcee.autocorr.integrated_time(chain, tol=0)
    return np.maximum(tau, 1.0)


def _r_hat(chain: FloatArray) -> FloatArray:
    """Return the rank-normalised split R-hat across ensembles, shape (d,)."""
    thin = max(1, chain.shape[1] * chain.shape[2] // 20_000)
    flat = chain.reshape(chain.shape[0], -1, chain.shape[3])[:, :: thin * 2 + 1]
    return np.array([array_stats.rhat(flat[..., k]) for k in range(flat.shape[2])])


def _effective(chain: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bulk and tail effective draws, shape (d,) each, of chains (ensembles, ...).

    Bulk: of the rank-normalised values. Tail: the lesser of those of the indicators of the lowest
    and the highest twentieth (Vehtari et al. 2021), each by emcee's autocorrelation time, of steps
    so far apart that they still tell it.
    """
    chain = chain[:, :: max(1, int(tau.min() / STEPS_A_TAU))]
    total = chain.shape[0] * chain.shape[1] * chain.shape[2]
    flat = chain.reshape(-1, chain.shape[3])
    ranks = np.stack([rankdata(column) for column in flat.T.copy()], axis=1).reshape(chain.shape)
    fraction = (ranks - 0.375) / (total + 0.25)
    bulk = total / np.mean([_tau(c) for c in ndtri(fraction)], axis=0)
    tails = [
        total / np.mean([_tau(c) for c in (indicator).astype(float)], axis=0)
        for indicator in (fraction < 0.05, fraction > 0.95)
    ]
    return bulk, np.minimum(*tails)


def _summarise(
    chains: _Chains, sample: ImportanceSample, fit: RobustFit, rng: np.random.Generator
) -> Posterior:
    """Return the posterior with its diagnostics; shared errors are added to thinned draws."""
    bulk, tail = _effective(chains.chain, chains.tau)
    r_hat = _r_hat(chains.chain)
    ensembles, steps, walkers, d = chains.chain.shape
    agreement, agrees = _agreement(chains.chain.reshape(-1, d), bulk, sample)
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
        ess_bulk=bulk,
        ess_tail=tail,
        r_hat=r_hat,
        tau=chains.tau,
        acceptance=chains.acceptance,
        steps=steps,
        converged=chains.converged and bool(bulk.min() >= ESS_GOAL),
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
