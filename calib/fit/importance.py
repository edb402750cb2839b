"""Adaptive importance sampling of a posterior: fast, independent of the Markov chains.

Multivariate t proposals start at the robust fit (Laplace), adapt to the weighted sample, and are
pooled by the deterministic mixture (Cornuet et al. 2012, doi 10.1111/j.1467-9469.2011.00756.x).
Pareto smoothing tames the largest weights and tells by k-hat whether the answer can be trusted
(Vehtari et al. 2024, arXiv 1507.02646).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from arviz_stats.base import array_stats
from scipy.special import gammaln, logsumexp

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.core.unit_diagonal import unit_diagonal

ROUNDS = 8
MAXIMUM_ROUNDS = 32
DRAWS_PER_ROUND = 1250
"""Eight rounds of 1250 do for five dimensions; more dimensions go on until the sample is reliable.
"""

PROPOSAL_DOF = 3.0
"""Tails heavier than those of any posterior here, whose lightest have the rows' count less the
parameters' as degrees of freedom."""

START_WIDENING = 1.5
"""Factor on the first proposal's standard deviations: too narrow would miss the tails."""

K_HAT_LIMIT = 0.7
"""Above it, Pareto-smoothed weights do not converge at a usable rate (Vehtari et al. 2024)."""

ESS_LIMIT = 1000.0
"""Effective draws below which the comparison with the Markov chains says little: 3 % on a mean."""


@dataclass(frozen=True)
class ImportanceSample:
    """A weighted sample of a posterior.

    Parameters
    ----------
    draws
        Shape (m, d).
    weights
        Smoothed, summing to 1, shape (m,).
    k_hat
        Pareto shape of the raw weights' tail.
    ess
        Effective sample size, 1 / sum(weights²).
    log_evidence
        Log of the integral of the density sampled.
    """

    draws: FloatArray
    weights: FloatArray
    k_hat: float
    ess: float
    log_evidence: float

    @property
    def reliable(self) -> bool:
        """Whether means and quantiles of the sample may be used."""
        return self.k_hat < K_HAT_LIMIT and self.ess >= ESS_LIMIT

    @property
    def mean(self) -> FloatArray:
        """Weighted mean, shape (d,)."""
        mean: FloatArray = self.weights @ self.draws
        return mean

    @property
    def covariance(self) -> FloatArray:
        """Weighted covariance, shape (d, d)."""
        centred = self.draws - self.mean
        covariance: FloatArray = (self.weights[:, None] * centred).T @ centred
        return covariance

    def quantiles(self, levels: tuple[float, ...]) -> FloatArray:
        """Return weighted quantiles, shape (len(levels), d)."""
        order = np.argsort(self.draws, axis=0)
        below = np.cumsum(self.weights[order], axis=0)
        values = np.take_along_axis(self.draws, order, axis=0)
        columns = range(self.draws.shape[1])
        return np.array([np.interp(levels, below[:, k], values[:, k]) for k in columns]).T

    @property
    def proposal(self) -> Proposal:
        """The density to propose from that fits the sample."""
        return Proposal.around(self.mean, self.covariance)

    def resample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` different draws, chosen by weight, shape (count, d)."""
        chosen = rng.choice(len(self.draws), size=count, replace=False, p=self.weights)
        picked: FloatArray = self.draws[chosen]
        return picked

    def equally_weighted(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return `count` draws of equal weight, shape (count, d), by systematic resampling.

        A draw comes as often as its weight says, within one: no more noise than the weights have.
        """
        steps = (np.arange(count) + rng.random()) / count
        chosen = np.searchsorted(np.cumsum(self.weights), steps)
        picked: FloatArray = self.draws[np.minimum(chosen, len(self.draws) - 1)]
        return picked


@dataclass(frozen=True)
class Proposal:
    """A multivariate t density with `PROPOSAL_DOF` degrees of freedom."""

    centre: FloatArray
    factor: FloatArray

    @classmethod
    def around(cls, centre: FloatArray, covariance: FloatArray) -> Proposal:
        """Return the proposal, or raise LinAlgError if the covariance is singular."""
        if not np.all(np.diagonal(covariance) > 0):
            raise np.linalg.LinAlgError("a quantity has no spread")
        std, correlation = unit_diagonal(covariance)
        wider = correlation + 1e-12 * np.eye(len(std))
        return cls(centre, std[:, None] * np.linalg.cholesky(wider))

    def draw(self, count: int, rng: np.random.Generator | np.random.RandomState) -> FloatArray:
        """Return draws, shape (count, d)."""
        normal = rng.standard_normal((count, len(self.centre)))
        stretch = np.sqrt(PROPOSAL_DOF / rng.chisquare(PROPOSAL_DOF, count))
        draws: FloatArray = self.centre + stretch[:, None] * (normal @ self.factor.T)
        return draws

    def log_density(self, x: FloatArray) -> FloatArray:
        """Return the log density, shape (m,), of x, shape (m, d)."""
        d = len(self.centre)
        white = np.linalg.inv(self.factor) @ (x - self.centre).T
        norm = gammaln((PROPOSAL_DOF + d) / 2) - gammaln(PROPOSAL_DOF / 2)
        norm -= d / 2 * np.log(PROPOSAL_DOF * np.pi) + np.log(np.diag(self.factor)).sum()
        density: FloatArray = norm - (PROPOSAL_DOF + d) / 2 * np.log1p(
            (white**2).sum(axis=0) / PROPOSAL_DOF
        )
        return density


def sample_importance(
    log_density: Callable[[FloatArray], FloatArray],
    centre: FloatArray,
    covariance: FloatArray,
    rng: np.random.Generator,
) -> ImportanceSample:
    """Return an importance sample of a density.

    Parameters
    ----------
    log_density
        Maps points, shape (m, d), to log densities, shape (m,), up to a constant.
    centre, covariance
        First guess of the posterior's mean, shape (d,), and covariance, shape (d, d).

    Raises
    ------
    EstimationError
        If the density is nowhere finite near the guess.
    """
    proposals = [Proposal.around(centre, START_WIDENING**2 * covariance)]
    draws, target = np.empty((0, len(centre))), np.empty(0)
    mixture = np.empty(0)
    while True:
        fresh = proposals[-1].draw(DRAWS_PER_ROUND, rng)
        draws = np.concatenate([draws, fresh])
        target = np.concatenate([target, log_density(fresh)])
        # Of the mixture only what is new: the last proposal at old draws, all at fresh ones.
        mixture = np.logaddexp(mixture, proposals[-1].log_density(draws[: len(mixture)]))
        of_fresh = logsumexp([p.log_density(fresh) for p in proposals], axis=0)
        mixture = np.concatenate([mixture, of_fresh])
        log_weights = target - mixture
        if not np.isfinite(log_weights).any():
            raise EstimationError("the posterior density is nowhere finite near the robust fit")
        if len(proposals) >= ROUNDS:
            sample = _smoothed(draws, log_weights + np.log(len(proposals)))
            if sample.reliable or len(proposals) >= MAXIMUM_ROUNDS:
                return sample
        proposals.append(_adapted(draws, log_weights, proposals[-1]))


def _adapted(draws: FloatArray, log_weights: FloatArray, last: Proposal) -> Proposal:
    """Return the proposal that fits the weighted sample, or the last if the sample is too poor."""
    weights = np.exp(log_weights - logsumexp(log_weights))
    if 1 / float(weights @ weights) < 5 * draws.shape[1]:
        # Few draws carry all the weight: their covariance would be singular. Temper instead.
        weights = np.exp(0.3 * (log_weights - log_weights.max()))
        weights /= weights.sum()
    mean = weights @ draws
    centred = draws - mean
    covariance = (weights[:, None] * centred).T @ centred
    try:
        return Proposal.around(mean, covariance)
    except np.linalg.LinAlgError:
        return last


def pareto_shape(log_weights: FloatArray) -> float:
    """Return k-hat of the largest weights, from log weights, shape (m,)."""
    return _pareto_smoothed(log_weights)[1]


def _pareto_smoothed(log_weights: FloatArray) -> tuple[FloatArray, float]:
    # It takes log densities of left-out data, whose negatives are the log weights.
    smoothed, k_hat = array_stats.psislw(-log_weights)
    return smoothed, float(k_hat)


def _smoothed(draws: FloatArray, log_weights: FloatArray) -> ImportanceSample:
    smoothed, k_hat = _pareto_smoothed(log_weights)
    weights = np.exp(smoothed - logsumexp(smoothed))
    return ImportanceSample(
        draws=draws,
        weights=weights,
        k_hat=k_hat,
        ess=float(1 / (weights @ weights)),
        log_evidence=float(logsumexp(log_weights) - np.log(len(draws))),
    )
