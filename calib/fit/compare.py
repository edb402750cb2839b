"""Models side by side, and the rule that selects one.

The same scores and the same rule serve Markov chains (`compare_models`) and importance samples
(`compare_samples`): a chain is a sample of equal weights.

The rule: the model with the fewest free parameters whose expected log predictive density (LOO) is
not worse than the best one's by more than `CLEARLY` standard errors of the paired difference, or
by less than `NOTICEABLY`. A richer model must earn its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from arviz_stats.base import array_stats
from numpy.random import SeedSequence
from scipy.special import logsumexp

from calib.arrays import FloatArray
from calib.errors import EstimationError
from calib.fit.density import log_posterior
from calib.fit.importance import K_HAT_LIMIT, ImportanceSample, sample_importance
from calib.fit.posterior import Posterior, laplace
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.geometry.plane import depth
from calib.observations import Observations
from calib.observe import ValidationRows

CLEARLY = 1.0
"""Standard errors of the paired difference that a richer model must be better by.

The difference and its standard error both grow with the effect: a true effect of t standard errors
of the estimate gives about t / 2 here, so that 1 asks for t of 2.
"""

NOTICEABLY = 2.0
"""Nats that a richer model must be better by: below it AIC's users call models equal."""

LOO_DRAWS = 4000
"""Posterior draws that LOO looks at."""

CHUNK_ELEMENTS = 4_000_000
"""Draws x rows held at a time."""

MAXIMUM_GROUPS = 30
"""Groups left out for the depth error; more groups are left out together, in 30 parts."""


@dataclass(frozen=True)
class ModelScore:
    """How well one model predicts rows it has not seen.

    Parameters
    ----------
    model
        Its name.
    loo, loo_se
        Expected log predictive density of the encoder readings, per rad and row, summed; its
        standard error.
    pointwise
        Its terms, shape (n,). Those of rows set aside as outliers are the models' mean, so that
        they favour none.
    pareto_k
        Shape parameter of each row's importance weights, shape (n,).
    refitted
        Rows that were predicted by an exact refit without them, as `pareto_k` was too high.
    unreliable
        Rows whose refit's own importance weights were poor.
    aicc, bic
        With the effective number of parameters and the noise scale; AICc is None where the rows
        are too few for it.
    cv_depth_rms_rel
        Root mean square of (predicted - reference) / reference depth, each group of rows
        predicted by a fit without it.
    validation_depth_rms_rel
        The same on the validation rows; None without them.
    weight
        Stacking weight (Yao et al. 2018, doi 10.1214/17-BA1091).
    """

    model: str
    loo: float
    loo_se: float
    pointwise: FloatArray
    pareto_k: FloatArray
    refitted: tuple[str, ...]
    unreliable: tuple[str, ...]
    aicc: float | None
    bic: float
    cv_depth_rms_rel: float | None
    validation_depth_rms_rel: float | None
    weight: float


@dataclass(frozen=True)
class Comparison:
    """All models' scores, the selected one and why.

    Parameters
    ----------
    scores
        In order of rising number of free parameters.
    selected
        Name of the selected model.
    reason
        The rule with this comparison's figures, for the report.
    """

    scores: tuple[ModelScore, ...]
    selected: str
    reason: str


def compare_models(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    posteriors: Mapping[str, Posterior],
    priors: Priors,
    validation: ValidationRows | None,
    *,
    seed: SeedSequence,
) -> Comparison:
    """Return the comparison of all models that were fitted.

    Parameters
    ----------
    fits, posteriors
        By model name, the same names in both.
    validation
        Rows never used to fit; None without them.
    """
    draws = {name: _of_chain(posteriors[name], fit) for name, fit in fits.items()}
    loos = _leave_one_out(rows, fits, draws, priors, seed)
    left_out = {name: _left_out_depth_error(rows, fit, priors) for name, fit in fits.items()}
    unseen = {name: _validation_error(fit, validation) for name, fit in fits.items()}
    return _compare(rows, fits, priors, loos, _DepthErrors(left_out, unseen))


def compare_samples(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    samples: Mapping[str, ImportanceSample],
    priors: Priors,
    *,
    seed: SeedSequence,
) -> Comparison:
    """Return the same comparison from importance samples, without depth errors of left-out rows.

    A hundred times faster than with Markov chains, for studies of many rigs.

    Parameters
    ----------
    fits, samples
        By model name, the same names in both.
    """
    draws = {name: _Draws(s.draws, _log(s.weights)) for name, s in samples.items()}
    loos = _leave_one_out(rows, fits, draws, priors, seed)
    return _compare(rows, fits, priors, loos, _DepthErrors({}, {}))


@dataclass(frozen=True)
class _Draws:
    """Draws from a posterior, shape (m, p + 1), with the logarithms of their weights, shape (m,).

    Without what the shared errors add: the rows contain it already.
    """

    draws: FloatArray
    log_weights: FloatArray


@dataclass(frozen=True)
class _DepthErrors:
    """Relative root mean square depth errors by model, as far as they are known."""

    left_out: Mapping[str, float | None]
    validation: Mapping[str, float | None]


def _log(weights: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        logarithm: FloatArray = np.log(weights)
    return logarithm


def _compare(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    priors: Priors,
    loos: Mapping[str, _Loo],
    errors: _DepthErrors,
) -> Comparison:
    """Return scores and selection, models in order of rising number of free parameters."""
    every = _without_outliers(np.stack([loo.pointwise for loo in loos.values()], axis=1), fits)
    weights = stacking_weights(every)
    scores = []
    for (name, loo), pointwise, weight in zip(loos.items(), every.T, weights, strict=True):
        aicc, bic = _information_criteria(rows, fits[name], priors)
        scores.append(
            ModelScore(
                model=name,
                loo=float(pointwise.sum()),
                loo_se=float(np.sqrt(len(rows) * np.var(pointwise))),
                pointwise=pointwise,
                pareto_k=loo.pareto_k,
                refitted=tuple(rows.ids[i] for i in loo.refitted),
                unreliable=tuple(rows.ids[i] for i in loo.unreliable),
                aicc=aicc,
                bic=bic,
                cv_depth_rms_rel=errors.left_out.get(name),
                validation_depth_rms_rel=errors.validation.get(name),
                weight=float(weight),
            )
        )
    selected, reason = select(scores)
    return Comparison(tuple(scores), selected, reason)


def _without_outliers(pointwise: FloatArray, fits: Mapping[str, RobustFit]) -> FloatArray:
    """Return the densities, shape (n, models), with those of outliers the same for all models.

    A gross error says nothing of which model is right, but its density scatters between them by
    more than that of all other rows together. Outliers are those of the model that leaves the
    smallest residuals: to one that does not fit, they are rows among others.
    """
    closest = min(fits.values(), key=lambda fit: fit.noise_scale)
    level = pointwise.mean(axis=1, keepdims=True)
    evened: FloatArray = np.where(closest.aside[:, None], level, pointwise)
    return evened


def select(scores: Sequence[ModelScore]) -> tuple[str, str]:
    """Return the name of the model that the rule selects, and the rule with its figures."""
    best = max(scores, key=lambda s: s.loo)
    by_size = sorted(scores, key=lambda s: (len(MODELS[s.model].free), -s.loo))
    for score in by_size:
        behind = best.loo - score.loo
        difference = best.pointwise - score.pointwise
        error = float(np.sqrt(len(difference) * np.var(difference)))
        if score is best:
            break
        if behind <= max(CLEARLY * error, NOTICEABLY):
            reason = (
                f"{score.model} has the fewest parameters of the models whose expected log "
                f"predictive density is not clearly below the best: it is {behind:.1f} below "
                f"{best.model}, with a standard error of {error:.1f}"
            )
            return score.model, reason
    simpler = [s for s in by_size if len(MODELS[s.model].free) < len(MODELS[best.model].free)]
    if not simpler:
        return best.model, f"{best.model} predicts best and has the fewest parameters"
    rival = max(simpler, key=lambda s: s.loo)
    difference = best.pointwise - rival.pointwise
    error = float(np.sqrt(len(difference) * np.var(difference)))
    reason = (
        f"{best.model} predicts best: its expected log predictive density is "
        f"{best.loo - rival.loo:.1f} above that of {rival.model}, the best model with fewer "
        f"parameters, with a standard error of {error:.1f}"
    )
    return best.model, reason


@dataclass(frozen=True)
class _Loo:
    pointwise: FloatArray
    pareto_k: FloatArray
    refitted: tuple[int, ...]
    unreliable: tuple[int, ...]


def _leave_one_out(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    draws: Mapping[str, _Draws],
    priors: Priors,
    seed: SeedSequence,
) -> Mapping[str, _Loo]:
    """Return the leave-one-out densities of each model, in order of rising size."""
    names = sorted(fits, key=lambda name: len(MODELS[name].free))
    return {
        name: _loo(rows, fits[name], draws[name], priors, child)
        for name, child in zip(names, seed.spawn(len(names)), strict=True)
    }


def _loo(
    rows: Observations, fit: RobustFit, sample: _Draws, priors: Priors, seed: SeedSequence
) -> _Loo:
    """Return leave-one-out densities: Pareto-smoothed, exact where the smoothing fails."""
    target = log_posterior(rows, MODELS[fit.model], priors, fit.theta, aside=fit.aside)
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
    return _Loo(pointwise, pareto_k, tuple(refitted), tuple(unreliable))


def _smoothed(log_ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Pareto-smoothed log weights, shape (n, m), and k-hat, shape (n,), of log ratios.

    A row that no draw depends on, having been set aside, has no tail to smooth: its k-hat is 0.
    """
    log_weights, k_hat = -log_ratios, np.zeros(len(log_ratios))
    varied = np.ptp(log_ratios, axis=1) > 0
    if varied.any():
        log_weights[varied], k_hat[varied] = array_stats.psislw(log_ratios[varied])
    return log_weights, k_hat


def _of_chain(posterior: Posterior, fit: RobustFit) -> _Draws:
    """Return `LOO_DRAWS` draws of the chains, without what the shared errors added to each."""
    thin = max(1, len(posterior.flat) // LOO_DRAWS)
    draws = posterior.flat[::thin].copy()
    common = posterior.common.reshape(len(posterior.flat), fit.by_shared.shape[1])[::thin]
    draws[:, :-1] -= common @ fit.by_shared.T
    return _Draws(draws, np.zeros(len(draws)))


def _exact(
    rows: Observations, fit: RobustFit, priors: Priors, left_out: int, rng: np.random.Generator
) -> tuple[float, bool]:
    """Return the log density of a row under the posterior of the others, and its reliability."""
    model = MODELS[fit.model]
    others = rows.take(np.arange(len(rows)) != left_out)
    again = fit_robust(others, model, priors, start=fit.theta)
    # The weights stay those of the full fit, so that all terms speak of the same density.
    target = log_posterior(rows, model, priors, fit.theta, aside=fit.aside)
    sample = sample_importance(
        target.only(np.flatnonzero(np.arange(len(rows)) != left_out)),
        *laplace(again, target),
        rng,
    )
    density = target.only(np.array([left_out])).pointwise(sample.draws)[:, 0]
    term = logsumexp(density + _log(sample.weights))
    return float(term), sample.k_hat < K_HAT_LIMIT


def _information_criteria(
    rows: Observations, fit: RobustFit, priors: Priors
) -> tuple[float | None, float]:
    """Return AICc (None where the rows are too few) and BIC."""
    target = log_posterior(rows, MODELS[fit.model], priors, fit.theta, aside=fit.aside)
    point = np.append(fit.values, np.log(fit.noise_scale))[None]
    deviance = -2 * float(target.pointwise(point).sum())
    count, parameters = len(rows), fit.data_parameters + 1
    spare = count - parameters - 1
    aicc = deviance + 2 * parameters * count / spare if spare > 0 else None
    return aicc, deviance + parameters * float(np.log(count))


def _left_out_depth_error(rows: Observations, fit: RobustFit, priors: Priors) -> float | None:
    """Return the relative depth error of groups left out, or None if none can be."""
    labels = {group: i for i, group in enumerate(dict.fromkeys(rows.groups))}
    if len(labels) < 2:
        return None
    group = np.array([labels[g] for g in rows.groups])
    parts = group * min(len(labels), MAXIMUM_GROUPS) // len(labels)
    errors = []
    for part in np.unique(parts):
        out = parts == part
        try:
            again = fit_robust(rows.take(~out), MODELS[fit.model], priors, start=fit.theta)
        except EstimationError:
            return None
        unseen = rows.take(out)
        errors.append(depth(again.theta, unseen.gaze) / unseen.z_mm - 1)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _validation_error(fit: RobustFit, validation: ValidationRows | None) -> float | None:
    if validation is None:
        return None
    z = depth(fit.theta, validation.rows.gaze)[validation.depth_of]
    error = z / validation.rows.z_mm - 1
    return float(np.sqrt(np.mean(error**2)))


def stacking_weights(pointwise: FloatArray) -> FloatArray:
    """Return the weights, shape (models,), of the mixture that predicts left-out rows best.

    Maximises sum_i log sum_k w_k exp(pointwise[i, k]) by expectation maximisation, which climbs
    at each step and keeps the weights on the simplex.

    Parameters
    ----------
    pointwise
        LOO log densities, shape (n, models).
    """
    density = np.exp(pointwise - pointwise.max(axis=1, keepdims=True))
    weights: FloatArray = np.full(pointwise.shape[1], 1 / pointwise.shape[1])
    for _ in range(10_000):
        share = weights * density
        share /= share.sum(axis=1, keepdims=True)
        updated: FloatArray = share.mean(axis=0)
        if np.abs(updated - weights).max() < 1e-10:
            return updated
        weights = updated
    return weights
