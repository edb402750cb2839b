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
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.fit.chains import Progress
from calib.fit.groups import units
from calib.fit.importance import ImportanceSample
from calib.fit.leave_one_out import LeftOutPredictions, leave_one_out, of_chain, of_sample
from calib.fit.posterior import Posterior, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_robust
from calib.fit.weights import averaging_weights, stacking_weights
from calib.geometry.parameters import INDEX, MODELS, REFERENCE_OFFSET
from calib.geometry.plane import depth
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations

CLEARLY = 1.0
"""Standard errors of the paired difference that a richer model must be better by.

The difference and its standard error both grow with the effect: a true effect of t standard errors
of the estimate gives about t / 2 here, so that 1 asks for t of 2.
"""

NOTICEABLY = 2.0
"""Nats that a richer model must be better by: below it AIC's users call models equal."""

OFFSET_LIKE_AXIS_MM = 10.0
"""Standard deviation of the prior of where z_mm counts from above which it can stand in for an axis
that stands off: `base` is then not selected. Of simulated rigs with 14 rows `base` fitted one in
eight as well by an offset of the wrong size, and depths were inside their 95 % intervals 91 % of
the time; without it 97 %."""

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
        Its terms, shape (n,). Those of rows rejected as outliers are the models' mean, so that
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
    weight, averaging_weight
        Stacking and pseudo-BMA+ weight; see `calib.fit.weights`.
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
    averaging_weight: float


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
    progress: Progress | None = None,
) -> Comparison:
    """Return the comparison of all models that were fitted.

    Parameters
    ----------
    fits, posteriors
        By model name, the same names in both.
    validation
        Rows never used to fit; None without them.
    """
    draws = {name: of_chain(posteriors[name], fit) for name, fit in fits.items()}
    for_rows, for_weights = seed.spawn(2)
    tell = (lambda *_: None) if progress is None else progress
    expected = 2 * len(fits)
    loos = leave_one_out(
        rows, fits, draws, priors, for_rows, progress=lambda done: tell(done, expected)
    )
    left_out = {}
    for done, (name, fit) in enumerate(fits.items(), len(fits) + 1):
        left_out[name] = _left_out_depth_error(rows, fit, priors)
        tell(done, expected)
    unseen = {name: _validation_error(fit, validation) for name, fit in fits.items()}
    return _compare(rows, fits, priors, loos, _DepthErrors(left_out, unseen), for_weights)


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
    draws = {name: of_sample(sample) for name, sample in samples.items()}
    for_rows, for_weights = seed.spawn(2)
    loos = leave_one_out(rows, fits, draws, priors, for_rows)
    return _compare(rows, fits, priors, loos, _DepthErrors({}, {}), for_weights)


@dataclass(frozen=True)
class _DepthErrors:
    """Relative root mean square depth errors by model, as far as they are known."""

    left_out: Mapping[str, float | None]
    validation: Mapping[str, float | None]


def _compare(
    rows: Observations,
    fits: Mapping[str, RobustFit],
    priors: Priors,
    loos: Mapping[str, LeftOutPredictions],
    errors: _DepthErrors,
    for_weights: SeedSequence,
) -> Comparison:
    """Return scores and selection, models in order of rising number of free parameters."""
    every = _without_outliers(np.stack([loo.pointwise for loo in loos.values()], axis=1), fits)
    stacking = stacking_weights(every)
    unit = units(rows)
    averaging = averaging_weights(_by_unit(every, unit), np.random.default_rng(for_weights))
    scores = []
    for k, (name, loo) in enumerate(loos.items()):
        pointwise = every[:, k]
        aicc, bic = _information_criteria(rows, fits[name], priors)
        scores.append(
            ModelScore(
                model=name,
                loo=float(pointwise.sum()),
                loo_se=_standard_error(pointwise, unit),
                pointwise=pointwise,
                pareto_k=loo.pareto_k,
                refitted=tuple(rows.ids[i] for i in loo.refitted),
                unreliable=tuple(rows.ids[i] for i in loo.unreliable),
                aicc=aicc,
                bic=bic,
                cv_depth_rms_rel=errors.left_out.get(name),
                validation_depth_rms_rel=errors.validation.get(name),
                weight=float(stacking[k]),
                averaging_weight=float(averaging[k]),
            )
        )
    offset_std = priors.stated.get(REFERENCE_OFFSET, (0.0, 0.0))[1]
    selected, reason = select(scores, unit, base=offset_std <= OFFSET_LIKE_AXIS_MM)
    return Comparison(tuple(scores), selected, reason)


def _without_outliers(pointwise: FloatArray, fits: Mapping[str, RobustFit]) -> FloatArray:
    """Return the densities, shape (n, models), with those of outliers the same for all models.

    A gross error says nothing of which model is right, but its density scatters between them by
    more than that of all other rows together. Outliers are those of the model that leaves the
    smallest residuals: to one that does not fit, they are rows among others.
    """
    closest = min(fits.values(), key=lambda fit: fit.noise_scale)
    level = pointwise.mean(axis=1, keepdims=True)
    evened: FloatArray = np.where(closest.rejected[:, None], level, pointwise)
    return evened


def _by_unit(pointwise: FloatArray, unit: IntArray) -> FloatArray:
    """Return densities summed over the rows of each unit, shape (units, models)."""
    total = np.zeros((int(unit.max()) + 1, pointwise.shape[1]))
    np.add.at(total, unit, pointwise)
    return total


def _standard_error(pointwise: FloatArray, unit: IntArray) -> float:
    """Return the standard error of the sum of terms, shape (n,), whose units are independent."""
    independent = np.bincount(unit, weights=pointwise)
    return float(np.sqrt(len(independent) * np.var(independent)))


def select(
    scores: Sequence[ModelScore], unit: IntArray | None = None, *, base: bool = True
) -> tuple[str, str]:
    """Return the name of the model that the rule selects, and the rule with its figures.

    Parameters
    ----------
    unit
        Of each row, shape (n,); see `calib.fit.groups.units`. None where each is its own.
    base
        Whether `base` may be selected beside others; see `OFFSET_LIKE_AXIS_MM`.
    """
    others = [score for score in scores if score.model != "base"]
    if others and len(others) < len(scores) and not base:
        selected, reason = select(others, unit)
        return selected, (
            f"{reason}; base is not considered, as an unknown origin of z_mm can stand in for an "
            "axis that stands off (state z_from)"
        )
    unit = np.arange(len(scores[0].pointwise)) if unit is None else unit
    best = max(scores, key=lambda s: s.loo)
    by_size = sorted(scores, key=lambda s: (len(MODELS[s.model].free), -s.loo))
    for score in by_size:
        behind = best.loo - score.loo
        error = _standard_error(best.pointwise - score.pointwise, unit)
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
    error = _standard_error(best.pointwise - rival.pointwise, unit)
    reason = (
        f"{best.model} predicts best: its expected log predictive density is "
        f"{best.loo - rival.loo:.1f} above that of {rival.model}, the best model with fewer "
        f"parameters, with a standard error of {error:.1f}"
    )
    return best.model, reason


def _information_criteria(
    rows: Observations, fit: RobustFit, priors: Priors
) -> tuple[float | None, float]:
    """Return AICc (None where the rows are too few) and BIC."""
    target = posterior_of(fit, rows, priors)
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
            again = fit_robust(rows.take(~out), fit.structure, priors, start=fit.theta)
        except EstimationError:
            return None
        unseen = rows.take(out)
        origin = again.theta[INDEX[REFERENCE_OFFSET]]
        errors.append(depth(again.theta, unseen.gaze) / (unseen.z_mm + origin) - 1)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _validation_error(fit: RobustFit, validation: ValidationRows | None) -> float | None:
    if validation is None:
        return None
    z = depth(fit.theta, validation.rows.gaze)[validation.depth_of]
    error = z / validation.depth_from_c1(fit.theta) - 1
    return float(np.sqrt(np.mean(error**2)))
