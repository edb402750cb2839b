"""Markov chains by emcee: several ensembles of walkers, advanced together as one array.

The walkers start from draws of the importance sample. Each ensemble walks by differential evolution
(ter Braak 2006, doi 10.1007/s11222-006-8769-1), one step in ten with the factor 1 that carries a
walker from mode to mode. Where the importance sample is good, most steps propose a fresh point from
a t density with its mean and covariance, accepted or not by Metropolis and Hastings (the
independence sampler of Tierney 1994, doi 10.1214/aos/1176325750): a chain so forgets its past in
two to seven steps and not in ten to a hundred.

Every kind of step leaves the posterior unchanged, whatever it proposes: the t density is fixed
before the chains start, differences are of walkers that stand still meanwhile and come with either
sign alike, and what kind of step is next is drawn without a look at the walkers. So a wrong sample
makes chains slower, not wrong; the starts that it gave are forgotten and left out. What it may hide
is a mode that no walker ever meets: `calib.fit.modes` looks for those.

emcee's snooker move is left out: in emcee 3.1.6 its acceptance does not keep detailed balance, and
a share of one fifth in the mix makes the variance of a unit normal in five dimensions 6 % too small
(docs/decisions.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import emcee
import numpy as np
from arviz_stats.base import array_stats
from numpy.random import MT19937, RandomState, SeedSequence
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtri
from scipy.stats import rankdata

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.fit.importance import ImportanceSample, Proposal, pareto_shape

ENSEMBLES = 4
"""Independent ensembles: R-hat compares them; the walkers of one are not independent."""

WALKERS = 32
"""Walkers an ensemble, or four a dimension where that is more."""

BLOCK_STEPS = 50
"""Steps by which chains are prolonged, and after which convergence is first looked at."""

INDEPENDENT_SHARE = 0.8
"""Share of independent proposals where the importance sample is good; the walk has the rest."""

BURN_IN_SHARE = 1 / 11
"""Share of a chain's steps left out at its start: five autocorrelation times or more, after which
less than 1 % of a wrong start is left. The starts are right already where the sample is."""

INDEPENDENT_K_HAT = 0.5
"""Pareto shape of the ratio of posterior to proposal from which on the walk is alone. An average
over a chain of independent proposals has a finite variance only if that ratio has a finite second
moment under the proposal, a shape below 1/2: above it walkers stay for long where the proposal is
too thin (Mengersen and Tweedie 1996, doi 10.1214/aos/1033066201)."""

SHAPE_DRAWS = (2000, 8000)
"""Draws of the proposal that tell the shape, and further ones where the first do not show it to be
below the limit: of 2000 its standard error is 0.1 and its estimate 0.2 too high, of all half that.
"""

MAXIMUM_STEPS = 60_000
"""Steps after which the chain is given up: three times what the worst rig tried has needed."""

UNTRUSTED_STEPS = 2000
"""The same where the sample is known to have left out a mode: no number of steps mends that."""

TAU_MULTIPLE = 50.0
"""Autocorrelation times a chain must hold before its own estimate of them can be trusted: what
emcee's authors ask for. Here the autocorrelation is averaged over 128 walkers or more."""

ESS_GOAL = 4000.0
"""Effective draws a parameter, in the bulk and in the tails: 1.6 % of sigma on a mean, 4 % of sigma
on a 95 % limit."""

R_HAT_LIMIT = 1.01
"""Vehtari et al. 2021, doi 10.1214/20-BA1221."""

WALKER_R_HAT_LIMIT = 1.05
"""R-hat with each walker as a chain. Walkers that all reach the whole posterior have 1.01 after 50
autocorrelation times; one in 128 that stays 3.2 standard deviations off, in a mode of its own, has
more than this. Neither the autocorrelation of each walker nor R-hat across ensembles shows it."""

TAU_WINDOW = 5
"""Autocorrelation times after which correlations are no longer summed (Sokal 1997, lecture 3)."""

STEPS_A_TAU = 5
"""Steps an autocorrelation time from which effective draws are told. Where correlations fall off
exponentially, 1.3 % fewer are found than by all steps; in the tails, which forget sooner, 5 %."""

TRANSFORMED = 100_000
"""Values whose spectra are held at a time: 3 MB."""

Progress = Callable[[int, int], None]
"""Told how far a computation is: steps done, steps expected."""

Moves: TypeAlias = list[tuple[Any, float]]
"""emcee's moves, each with its share."""


class Density(Protocol):
    """A log density of many points at once."""

    @property
    def dimensions(self) -> int:
        """Length d of a point."""

    def __call__(self, x: FloatArray, /) -> FloatArray:
        """Return log densities, shape (m,), of x, shape (m, d), up to a constant."""


@dataclass(frozen=True)
class Chains:
    """Full chains with what was found of them.

    Parameters
    ----------
    chain
        Shape (ensembles, steps, walkers, d), without burn-in.
    tau
        Integrated autocorrelation times, steps, shape (d,).
    ess_bulk, ess_tail
        Effective draws of all chains, in the bulk and in the tails, shape (d,).
    r_hat
        Rank-normalised split R-hat across ensembles, shape (d,).
    acceptance
        Share of proposals accepted.
    converged
        Whether all limits hold.
    independent
        Whether independent proposals were among the moves.
    """

    chain: FloatArray
    tau: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    r_hat: FloatArray
    acceptance: float
    converged: bool
    independent: bool


def run_chains(
    target: Density,
    sample: ImportanceSample,
    *,
    seed: SeedSequence,
    trusted: bool = True,
    progress: Progress | None = None,
) -> Chains:
    """Walk all ensembles, block by block, until they have converged or are given up.

    Parameters
    ----------
    target
        Log density to draw from.
    sample
        Where walkers start, and what independent proposals are drawn from.
    seed
        Source of all random numbers.
    trusted
        False if the sample is known to have left out a mode: ensembles then walk alone, and not
        for long.

    Raises
    ------
    EstimationError
        If too few draws of the sample carry weight, or the density has no finite integral.
    """
    for_start, for_shape, for_chains = seed.spawn(3)
    walkers = max(WALKERS, 4 * target.dimensions)
    if np.count_nonzero(sample.weights) < ENSEMBLES * walkers:
        raise EstimationError("too few importance draws carry weight to start the walkers from")
    starts = sample.resample(ENSEMBLES * walkers, np.random.default_rng(for_start))
    moves: Moves = [(EnsembleWalk(ENSEMBLES), 1.0)]
    independent = trusted and _good_proposal(target, sample, np.random.default_rng(for_shape))
    if independent:
        moves = with_independent(moves, sample.proposal)
    sampler = sampler_of(target, ENSEMBLES * walkers, moves)
    state = emcee.State(starts, random_state=RandomState(MT19937(for_chains)).get_state())
    expected, done, look = float(BLOCK_STEPS), 0, BLOCK_STEPS
    most = MAXIMUM_STEPS if trusted else UNTRUSTED_STEPS
    while True:
        while done < look:
            state = sampler.run_mcmc(state, BLOCK_STEPS)
            done += BLOCK_STEPS
            if progress is not None:
                progress(done, max(int(expected), done))
        flat = sampler.get_chain(discard=int(done * BURN_IN_SHARE))
        with np.errstate(over="ignore", invalid="ignore"):
            tau = autocorrelation_times(flat)
        if not np.isfinite(tau).all():
            raise EstimationError(
                "the walkers run away without bound: rows and priors leave the parameters open"
            )
        expected = max(TAU_MULTIPLE, ESS_GOAL / flat.shape[1]) * float(tau.max())
        expected /= 1 - BURN_IN_SHARE
        chain = flat.reshape(len(flat), ENSEMBLES, walkers, -1).swapaxes(0, 1)
        enough = done >= expected and float(walker_r_hat(flat).max()) < WALKER_R_HAT_LIMIT
        if enough or done >= most:
            found = _diagnosed(chain, tau, float(sampler.acceptance_fraction.mean()), independent)
            if found.converged or done >= most:
                return found
        # A short chain takes its autocorrelation times for shorter than they are.
        look = min(max(int(expected), int(1.2 * done)), 2 * done, most)


def _diagnosed(chain: FloatArray, tau: FloatArray, acceptance: float, independent: bool) -> Chains:
    """Return chains with their diagnostics."""
    r_hat = _r_hat(chain)
    bulk, tail = effective_draws(chain, tau)
    walkers = walker_r_hat(chain.swapaxes(0, 1).reshape(chain.shape[1], -1, chain.shape[3]))
    converged = (
        chain.shape[1] >= TAU_MULTIPLE * float(tau.max())
        and bool(min(bulk.min(), tail.min()) >= ESS_GOAL)
        and bool(r_hat.max() < R_HAT_LIMIT)
        and bool(walkers.max() < WALKER_R_HAT_LIMIT)
    )
    return Chains(chain, tau, bulk, tail, r_hat, acceptance, converged, independent)


def _good_proposal(target: Density, sample: ImportanceSample, rng: np.random.Generator) -> bool:
    """Return whether chains may propose from the sample's t density: see `INDEPENDENT_K_HAT`."""
    if not sample.reliable:
        return False
    try:
        proposal = sample.proposal
    except np.linalg.LinAlgError:
        return False
    ratio = np.empty(0)
    for count in SHAPE_DRAWS:
        draws = proposal.draw(count, rng)
        ratio = np.append(ratio, target(draws) - proposal.log_density(draws))
        if np.count_nonzero(np.isfinite(ratio)) < len(ratio) / 2:
            return False
        if pareto_shape(ratio) < INDEPENDENT_K_HAT:
            return True
    return False


class EnsembleWalk(emcee.moves.Move):  # type: ignore[misc]  # emcee is untyped
    """Differential evolution within each of several ensembles, all advanced by one call.

    Half of the walkers of each ensemble, chosen at random, move along differences of the other
    half, then the other half along theirs. No ensemble ever sees another.

    Parameters
    ----------
    ensembles
        Into so many equal parts the walkers are divided, in order.
    """

    LONG_SHARE = 0.1
    """Share of steps by a whole difference, from mode to mode."""

    JITTER = 1e-5
    """Relative standard deviation of the step's length (Nelson et al. 2014)."""

    def __init__(self, ensembles: int) -> None:
        self.ensembles = ensembles

    def propose(self, model: Any, state: Any) -> tuple[Any, Any]:
        """Return emcee's state after one step, and which walkers moved, shape (walkers,)."""
        random = model.random
        walkers = len(state.coords)
        order = np.argsort(random.rand(self.ensembles, walkers // self.ensembles), axis=1)
        order += np.arange(0, walkers, order.shape[1])[:, None]
        half = order.shape[1] // 2
        accepted = np.zeros(walkers, dtype=np.bool_)
        for moving, others in (
            (order[:, :half], order[:, half:]),
            (order[:, half:], order[:, :half]),
        ):
            place = moving.ravel()
            fresh = state.coords[place] + self._steps(state.coords[others], moving.shape[1], random)
            density, _ = model.compute_log_prob_fn(fresh)
            taken = np.log(random.rand(len(place))) < density - state.log_prob[place]
            state.coords[place[taken]] = fresh[taken]
            state.log_prob[place[taken]] = density[taken]
            accepted[place[taken]] = True
        return state, accepted

    def _steps(self, others: FloatArray, count: int, random: RandomState) -> FloatArray:
        """Return `count` steps for each ensemble, shape (ensembles * count, d)."""
        ensembles, size, d = others.shape
        first = random.randint(size, size=(ensembles, count))
        second = (first + 1 + random.randint(size - 1, size=first.shape)) % size
        row = np.arange(ensembles)[:, None]
        difference = (others[row, first] - others[row, second]).reshape(-1, d)
        length = np.full(len(difference), 2.38 / np.sqrt(2 * d))
        length[random.rand(len(length)) < self.LONG_SHARE] = 1.0
        length *= 1 + self.JITTER * random.standard_normal(len(length))
        steps: FloatArray = length[:, None] * difference
        return steps


def with_independent(walk: Moves, proposal: Proposal) -> Moves:
    """Return a mix of independent proposals and a walk."""

    def propose(x: FloatArray, random: RandomState) -> tuple[FloatArray, FloatArray]:
        fresh = proposal.draw(len(x), random)
        return fresh, proposal.log_density(x) - proposal.log_density(fresh)

    rest = [(move, (1 - INDEPENDENT_SHARE) * share) for move, share in walk]
    return [(emcee.moves.MHMove(propose), INDEPENDENT_SHARE), *rest]


def sampler_of(target: Density, walkers: int, moves: Moves) -> emcee.EnsembleSampler:
    """Return emcee's sampler of a density, which gets all points of a step at once."""
    sampler = emcee.EnsembleSampler(walkers, target.dimensions, target, vectorize=True, moves=moves)
    # emcee wraps the function to print a traceback of whatever comes out of it, Ctrl-C too.
    sampler.log_prob_fn = target
    return sampler


def autocorrelation_times(chain: FloatArray) -> FloatArray:
    """Return autocorrelation times in steps, shape (d,), of a chain (steps, walkers, d).

    As `emcee.autocorr.integrated_time` finds them: the autocorrelation is the walkers' average,
    its sum ends after `TAU_WINDOW` times itself. Of all walkers at once, where emcee takes one by
    one; and where the sum does not end within the chain, all of it and not 1.
    """
    if not np.ptp(chain, axis=0).all():
        # A walker that stayed at one value, as indicators may, has none: join all end to end.
        chain = chain.swapaxes(0, 1).reshape(-1, 1, chain.shape[2])
    return np.array([_autocorrelation_time(chain[..., k]) for k in range(chain.shape[2])])


def _autocorrelation_time(walkers: FloatArray) -> float:
    """Return the autocorrelation time, steps, 1 at least, of one quantity, (steps, walkers)."""
    steps = len(walkers)
    padded = next_fast_len(2 * steps, real=True)
    power = np.zeros(padded // 2 + 1)
    parts = min(-(-walkers.size // TRANSFORMED), walkers.shape[1])
    for some in np.array_split(walkers.T, parts):
        centred = some - some.mean(axis=1, keepdims=True)
        spectrum = rfft(centred, n=padded, axis=1)
        weight = 1 / (centred**2).sum(axis=1, keepdims=True)
        power += (weight * (spectrum.real**2 + spectrum.imag**2)).sum(axis=0)
    correlation = irfft(power, n=padded)[:steps] / walkers.shape[1]
    tau = 2.0 * np.cumsum(correlation) - 1.0
    ended = np.arange(steps) >= TAU_WINDOW * tau
    return float(max(tau[np.argmax(ended) if ended.any() else -1], 1.0))


def walker_r_hat(chain: FloatArray) -> FloatArray:
    """Return R-hat with each walker as a chain, shape (d,), of a chain (steps, walkers, d).

    Of the values, not their ranks: those hide how far away a walker is (Gelman and Rubin 1992, doi
    10.1214/ss/1177011136).
    """
    within = chain.var(axis=0, ddof=1).mean(axis=0)
    between = chain.mean(axis=0).var(axis=0, ddof=1)
    r_hat: FloatArray = np.sqrt((len(chain) - 1) / len(chain) + between / within)
    return r_hat


def _r_hat(chain: FloatArray) -> FloatArray:
    """Return the rank-normalised split R-hat across ensembles, shape (d,)."""
    thin = max(1, chain.shape[1] * chain.shape[2] // 20_000)
    flat = chain.reshape(chain.shape[0], -1, chain.shape[3])[:, :: thin * 2 + 1]
    return np.array([array_stats.rhat(flat[..., k]) for k in range(flat.shape[2])])


def effective_draws(chain: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bulk and tail effective draws, shape (d,) each, of chains (ensembles, ...).

    Bulk: of the rank-normalised values. Tail: the lesser of those of the indicators of the lowest
    and the highest twentieth (Vehtari et al. 2021), each by emcee's autocorrelation time, of steps
    so far apart that they still tell it.
    """
    chain = chain[:, :: max(1, int(tau.min() / STEPS_A_TAU))]
    # Walkers of all ensembles side by side: (steps, ensembles * walkers, d).
    flat = chain.swapaxes(0, 1).reshape(chain.shape[1], -1, chain.shape[3])
    total = flat.shape[0] * flat.shape[1]
    ranks = np.stack([rankdata(flat[..., k]) for k in range(flat.shape[2])], axis=-1)
    fraction = (ranks.reshape(flat.shape) - 0.375) / (total + 0.25)
    bulk = total / autocorrelation_times(ndtri(fraction))
    tails = [
        total / autocorrelation_times(indicator.astype(float))
        for indicator in (fraction < 0.05, fraction > 0.95)
    ]
    return bulk, np.minimum(*tails)
