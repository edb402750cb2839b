"""Leave-one-out densities: what a model expects of each row from all others.

Draws of the full posterior are given the weights that they have once the row is left out, smoothed
by a Pareto tail (Vehtari, Gelman and Gabry 2017, doi 10.1007/s11222-016-9696-4); where that fails,
the model is fitted again without the row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from arviz_stats.base import array_stats
from numpy.random import SeedSequence
from scipy.special import logsumexp

from calib.arrays import FloatArray
from calib.errors import EstimationError
from calib.fit.importance import K_HAT_LIMIT, ImportanceSample, sample_importance
from calib.fit.posterior import Posterior, laplace, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.observations import Observations

LOO_DRAWS, LOO_DRAWS_LEAST = 4000, 1000
"""Posterior draws that LOO looks at. A thousand leave 0.05 nats of doubt on the rows' sum."""

LOO_ELEMENTS = 100_000_000
"""Draws x rows from which on fewer draws are looked at."""

NEARLY_EQUAL = 0.2
"""Spread of log ratios, greatest less least, in which weights are too equal to need smoothing: 99 %
of the draws are effective. In tables of 10,000 rows nearly all rows are of this kind."""

CHUNK_ELEMENTS = 4_000_000
"""Draws x rows held at a time."""


@dataclass(frozen=True)
class WeightedDraws:
    """Draws from a posterior, shape (m, p + 1), with the logarithms of their weights, shape (m,).

    Without what the shared errors add: the rows contain it already.
    """

    draws: FloatArray
    log_weights: FloatArray


def of_chain(posterior: Posterior, fit: RobustFit) -> WeightedDraws:
    """Return draws of the chains for LOO, without what the shared errors added to each."""
    wanted = np.clip(LOO_ELEMENTS // len(fit.standardised), LOO_DRAWS_LEAST, LOO_DRAWS)
    thin = max(1, len(posterior.flat) // int(wanted))
    draws = posterior.flat[::thin].copy()
    common = posterior.common.reshape(len(posterior.flat), fit.by_shared.shape[1])[::thin]
    draws[:, :-1] -= common @ fit.by_shared.T
    return WeightedDraws(draws, np.zeros(len(draws)))


def of_sample(sample: ImportanceSample) -> WeightedDraws:
    """Return an importance sample's draws with their weights."""
    return WeightedDraws(sample.draws, _log(sample.weights))


def _log(weights: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        logarithm: FloatArray = np.log(weights)
    return logarithm


@dataclass(frozen=True)
class LeftOut:
    """What a model expects of each row from all others.

    Parameters
    ----------
    pointwise
        Log predictive density of each row under the posterior of the others, shape (n,).
    pareto_k
        Shape parameter of each row's importance weights, shape (n,).
    refitted
        Places of rows that were predicted by an exact refit, as `pareto_k` was too high.
    unreliable
        Places of rows whose refit failed, or had poor importance weights itself.
    """

    pointwise: FloatArray
    pareto_k: FloatArray
    refitted: tuple[int, ...]
    unreliable: tuple[int, ...]


def leave_one_out(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    draws: Mapping[str, WeightedDraws],
    priors: Priors,
    seed: SeedSequence,
    *,
    progress: Callable[[int], None] | None = None,
) -> Mapping[str, LeftOut]:
    """Return the leave-one-out densities of each model, in order of rising size.

    Parameters
    ----------
    progress
        Told how many models are done.
    """
    names = sorted(fits, key=lambda name: len(MODELS[name].free))
    found = {}
    for name, child in zip(names, seed.spawn(len(names)), strict=True):
        found[name] = _loo(rows, fits[name], draws[name], priors, child)
        if progress is not None:
            progress(len(found))
    return found


def _loo(
    rows: Observations, fit: RobustFit, sample: WeightedDraws, priors: Priors, seed: SeedSequence
) -> LeftOut:
    """Return leave-one-out densities: Pareto-smoothed, exact where the smoothing fails."""
    target = posterior_of(fit, rows, priors)
    used = np.isfinite(sample.log_weights)
    draws, log_prior_weights = sample.draws[used], sample.log_weights[used]
    pointwise, pareto_k = np.empty(len(rows)), np.empty(len(rows))
    step = max(1, CHUNK_ELEMENTS // len(draws))
    for start in range(0, len(rows), step):
        part = np.arange(start, min(start + step, len(rows)))
        density = target.only(part).pointwise(draws).T
        # A draw's weight once the row is left out: its own over what the row gave it.
        log_weights, pareto_k[part] = _smoothed(
            target.power[part, None] * density - log_prior_weights
        )
        log_weights -= logsumexp(log_weights, axis=1, keepdims=True)
        pointwise[part] = logsumexp(density + log_weights, axis=1)
    refitted, unreliable = [], []
    failing = np.flatnonzero(pareto_k > K_HAT_LIMIT)
    for i, child in zip(failing, seed.spawn(len(failing)), strict=True):
        try:
            term, reliable = _exact(rows, fit, priors, int(i), np.random.default_rng(child))
        except EstimationError:
            # The others alone do not determine the model: the smoothed term stays, and says so.
            unreliable.append(int(i))
            continue
        pointwise[i] = term
        refitted.append(int(i))
        if not reliable:
            unreliable.append(int(i))
    return LeftOut(pointwise, pareto_k, tuple(refitted), tuple(unreliable))


def _smoothed(log_ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Pareto-smoothed log weights, shape (n, m), and k-hat, shape (n,), of log ratios.

    A row on which the draws hardly depend, being one of many or set aside, has no tail to smooth:
    its k-hat is 0.
    """
    log_weights, k_hat = -log_ratios, np.zeros(len(log_ratios))
    varied = np.ptp(log_ratios, axis=1) > NEARLY_EQUAL
    if varied.any():
        log_weights[varied], k_hat[varied] = array_stats.psislw(log_ratios[varied])
    return log_weights, k_hat


def _exact(
    rows: Observations, fit: RobustFit, priors: Priors, left_out: int, rng: np.random.Generator
) -> tuple[float, bool]:
    """Return the log density of a row under the posterior of the others, and its reliability."""
    others = rows.take(np.arange(len(rows)) != left_out)
    again = fit_robust(others, MODELS[fit.model], priors, start=fit.theta)
    # The weights stay those of the full fit, so that all terms speak of the same density.
    target = posterior_of(fit, rows, priors)
    sample = sample_importance(
        target.only(np.flatnonzero(np.arange(len(rows)) != left_out)),
        *laplace(again, target),
        rng,
    )
    density = target.only(np.array([left_out])).pointwise(sample.draws)[:, 0]
    term = logsumexp(density + _log(sample.weights))
    return float(term), sample.k_hat < K_HAT_LIMIT
