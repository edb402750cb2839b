"""Leave-one-out densities: what a model expects of each row from all others.

Rows that share the error of a reference depth are left out together: from one of them the others
would be expected with its error.

Draws of the full posterior are given the weights that they have once the row is left out, smoothed
by a Pareto tail (Vehtari, Gelman and Gabry 2017, doi 10.1007/s11222-016-9696-4); where that fails,
the model is fitted again without the row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from arviz_stats.base import array_stats
from numpy.random import SeedSequence
from scipy.special import logsumexp

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.fit.density import LogPosterior
from calib.fit.groups import units
from calib.fit.importance import K_HAT_LIMIT, ImportanceSample, sample_importance
from calib.fit.posterior import Posterior, laplace, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.rows.observations import Observations

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
class LeftOutPredictions:
    """What a model expects of each row from all others.

    Parameters
    ----------
    pointwise
        Log predictive density of each row under the posterior of those of other units, shape (n,);
        see `calib.fit.groups.units`.
    pareto_k
        Shape parameter of the importance weights of each row's unit, shape (n,).
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
) -> Mapping[str, LeftOutPredictions]:
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
) -> LeftOutPredictions:
    """Return leave-one-out densities: Pareto-smoothed, exact where the smoothing fails."""
    target = posterior_of(fit, rows, priors)
    used = np.isfinite(sample.log_weights)
    draws, log_prior_weights = sample.draws[used], sample.log_weights[used]
    pointwise, pareto_k = np.empty(len(rows)), np.empty(len(rows))
    unit, most = units(rows), max(1, CHUNK_ELEMENTS // len(draws))
    for part in _parts(unit, most):
        blocks = [target.only(part[i : i + most]) for i in range(0, len(part), most)]
        place = unit[part] - unit[part[0]]
        pointwise[part], pareto_k[part] = _smoothed_terms(blocks, place, draws, log_prior_weights)
    refitted, unreliable = list[int](), list[int]()
    failing = np.unique(unit[pareto_k > K_HAT_LIMIT])
    for number, child in zip(failing, seed.spawn(len(failing)), strict=True):
        out = np.flatnonzero(unit == number)
        try:
            terms, reliable = _exact(rows, fit, priors, out, np.random.default_rng(child))
        except EstimationError:
            # The others alone do not determine the model: the smoothed term stays, and says so.
            unreliable += out.tolist()
            continue
        pointwise[out] = terms
        refitted += out.tolist()
        if not reliable:
            unreliable += out.tolist()
    return LeftOutPredictions(pointwise, pareto_k, tuple(refitted), tuple(unreliable))


def _smoothed_terms(
    blocks: Sequence[LogPosterior],
    place: IntArray,
    draws: FloatArray,
    log_prior_weights: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return left-out densities and k-hat, shape (n,), of the rows of whole units.

    Parameters
    ----------
    blocks
        The rows. More than one block is one unit, of more rows than are held at a time.
    place
        Unit of each row, from 0 in rising order, shape (n,).
    """
    density = blocks[0].pointwise(draws).T
    # A draw's weight once a unit is left out: its own over what the unit's rows gave it.
    given = blocks[0].power[:, None] * density
    if place[-1] + 1 < len(place):
        given = np.add.reduceat(given, np.unique(place, return_index=True)[1], axis=0)
    for block in blocks[1:]:
        given += block.power @ block.pointwise(draws).T
    log_weights, k_hat = _smoothed(given - log_prior_weights)
    log_weights -= _log_sum(log_weights)[:, None]
    if len(log_weights) < len(density):
        log_weights = log_weights[place[: len(density)]]
    terms = [_log_sum(density + log_weights)]
    terms += [_log_sum(b.pointwise(draws).T + log_weights[0]) for b in blocks[1:]]
    return np.concatenate(terms), k_hat[place]


def _log_sum(terms: FloatArray) -> FloatArray:
    """Return the log of the sum of exponentials of finite terms, (n, m), shape (n,).

    scipy's for any terms takes five times as long.
    """
    largest = terms.max(axis=1)
    scaled = terms - largest[:, None]
    total = np.exp(scaled, out=scaled).sum(axis=1)
    found: FloatArray = largest + np.log(total)
    return found


def _parts(unit: IntArray, most: int) -> Iterator[IntArray]:
    """Yield places of rows, unit by unit, of whole units and `most` rows where these allow it."""
    order = np.argsort(unit, kind="stable")
    ends = np.cumsum(np.bincount(unit))
    start = 0
    while start < len(order):
        fitting = int(np.searchsorted(ends, start + most, "right")) - 1
        following = int(np.searchsorted(ends, start, "right"))
        end = int(ends[max(fitting, following)])
        yield order[start:end]
        start = end


def _smoothed(log_ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Pareto-smoothed log weights, shape (n, m), and k-hat, shape (n,), of log ratios.

    A row on which the draws hardly depend, being one of many or rejected, has no tail to smooth:
    its k-hat is 0.
    """
    log_weights, k_hat = -log_ratios, np.zeros(len(log_ratios))
    varied = np.ptp(log_ratios, axis=1) > NEARLY_EQUAL
    if varied.any():
        log_weights[varied], k_hat[varied] = array_stats.psislw(log_ratios[varied])
    return log_weights, k_hat


def _exact(
    rows: Observations, fit: RobustFit, priors: Priors, left_out: IntArray, rng: np.random.Generator
) -> tuple[FloatArray, bool]:
    """Return log densities of a unit's rows, (m,), by the posterior of the others; if reliable."""
    stay = np.setdiff1d(np.arange(len(rows)), left_out)
    again = fit_robust(rows.take(stay), fit.structure, priors, start=fit.theta)
    # The weights stay those of the full fit, so that all terms speak of the same density.
    target = posterior_of(fit, rows, priors)
    sample = sample_importance(
        target.only(stay),
        *laplace(again, target),
        rng,
    )
    density = target.only(left_out).pointwise(sample.draws).T
    terms: FloatArray = logsumexp(density + _log(sample.weights), axis=1)
    return terms, sample.k_hat < K_HAT_LIMIT
