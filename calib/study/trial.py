"""One rig: simulated, calibrated as the chain does it, and set against its truth.

In place of Markov chains the posterior is the importance sample, the chain's own second
computation; everything else (fits, selection, depth intervals) is the chain's code.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence

from calib.core.arrays import FloatArray
from calib.core.errors import CalibError
from calib.fit.compare import compare_samples
from calib.fit.importance import ImportanceSample, sample_importance
from calib.fit.linear import fit_bilinear, fit_linear
from calib.fit.noise import row_noise
from calib.fit.posterior import laplace, posterior_of
from calib.fit.priors import prior_of
from calib.fit.robust import RobustFit, fit_model
from calib.fit.start import first_guess
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import Model
from calib.instrument.calibrated import CalibratedInstrument, instrument_from_draws
from calib.study.conditions import Condition
from calib.study.depths import DRAWS, depth_record, model_depths
from calib.study.rigs import StudiedRig, set_up

DIGITS = 6
"""Significant digits of the figures kept."""

Record = dict[str, Any]


def run_trial(condition: Condition, *, seed: int, number: int) -> Record:
    """Return the scores of rig `number`, ready for JSON; they depend on the arguments alone."""
    record: Record = {"condition": condition.name, "seed": seed, "number": number}
    try:
        bench = set_up(condition, seed=seed, number=number)
        # Streams of their own, beside those that `set_up` spawns.
        seeds = SeedSequence((seed, number, 1)).spawn(4)
        scores: Record = _plain(calibrated(condition, bench, seeds))
        return record | scores
    except CalibError as error:
        return record | {"failed": str(error)}


def calibrated(condition: Condition, bench: StudiedRig, seeds: list[SeedSequence]) -> Record:
    """Calibrate a bench and score it."""
    for_sampling, for_comparison, for_depths, for_table = seeds
    rng = np.random.default_rng(for_sampling)
    fits, samples = {}, {}
    for name in condition.fitted:
        fits[name] = fit_model(bench.rows, bench.priors, model=name)
        target = posterior_of(fits[name], bench.rows, bench.priors)
        samples[name] = sample_importance(target, *laplace(fits[name], target), rng)
    comparison = compare_samples(bench.rows, fits, samples, bench.priors, seed=for_comparison)
    selected = comparison.selected
    fit, sample = fits[selected], samples[selected]
    scores = {score.model: score.loo for score in comparison.scores}
    weights = {score.model: score.averaging_weight for score in comparison.scores}
    depths = {
        name: model_depths(
            _instrument(fits[name], samples[name], bench, rng), bench, for_depths, for_table
        )
        for name in fits
    }
    chosen = depths[selected]
    record: Record = {
        "selected": selected,
        "loo": scores,
        "k_hat": sample.k_hat,
        "ess": sample.ess,
        "noise_scale": [fit.noise_scale, *_standing(sample, -1, float(np.log(bench.noise_scale)))],
        "factor95": chosen.factor95,
        "noise_factor": chosen.noise_factor,
        "depths": depth_record([1.0], [chosen], bench),
    }
    if len(fits) > 1:
        record["weights"] = weights
        record["averaged"] = depth_record(
            [weights[name] for name in depths], list(depths.values()), bench
        )
    if condition.model in fits:
        record["parameters"] = _parameters(bench, fits[condition.model], samples[condition.model])
    return record


def _instrument(
    fit: RobustFit, sample: ImportanceSample, bench: StudiedRig, rng: Generator
) -> CalibratedInstrument:
    """Return the instrument as one model describes it."""
    draws = sample.equally_weighted(DRAWS, rng)
    common = rng.standard_normal((len(draws), fit.by_shared.shape[1]))
    draws[:, :-1] += common @ fit.by_shared.T
    return instrument_from_draws(draws, common, fit, bench.rows, bench.setup)


def _standing(sample: ImportanceSample, column: int, truth: float) -> tuple[float, float, float]:
    """Return posterior mean, standard deviation and share of the posterior below the truth."""
    values = sample.draws[:, column]
    mean = float(sample.weights @ values)
    variance = float(sample.weights @ (values - mean) ** 2)
    return mean, float(np.sqrt(variance)), float(sample.weights @ (values < truth))


def _parameters(bench: StudiedRig, fit: RobustFit, sample: ImportanceSample) -> Record:
    """Return, by parameter of the true model: truth, bound, estimates, posterior."""
    model = fit.structure
    bound = cramer_rao(model, bench)
    ideal = _ideal(model, bench, bound)
    own, robust = np.sqrt(np.diag(fit.covariance)), fit.values
    others = _linear_estimates(bench, model)
    record: Record = {}
    for i, name in enumerate(model.free):
        truth = float(bench.rig.theta[model.indices[i]])
        record[name] = {
            "truth": truth,
            "bound": float(np.sqrt(bound[i, i])),
            "ideal": ideal[i],
            "identified_by": fit.identified_by[i],
            "robust": [robust[i], own[i]],
            "posterior": _standing(sample, i, truth),
        } | {estimator: values[name] for estimator, values in others.items() if name in values}
    return record


def cramer_rao(model: Model, bench: StudiedRig) -> FloatArray:
    """Return the least covariance that an estimator of the free parameters can have, (p, p).

    For normal errors of the true size, with the stated priors (van Trees' bound), outliers and
    shared errors left out.
    """
    theta, rows = bench.rig.theta, bench.true_rows
    slope = misclosure(theta, rows.gaze, rows.z_mm).by_theta[:, list(model.indices)]
    slope = slope / row_noise(theta, rows).sigma[:, None]
    information = slope.T @ slope + prior_of(model, bench.priors).precision
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


def _ideal(model: Model, bench: StudiedRig, bound: FloatArray) -> FloatArray:
    """Return the estimate, (p,), that attains the bound: one Gauss-Newton step from the truth.

    It knows the truth and is of use in one way only: on the same rows its errors are those of other
    estimators but for their loss, so that the ratio of mean squares tells their efficiency with
    much less scatter than the bound alone.
    """
    theta, rows = bench.rig.theta, bench.true_rows
    sigma = row_noise(theta, rows).sigma
    at_truth = misclosure(theta, rows.gaze, rows.z_mm).by_theta[:, list(model.indices)]
    seen = misclosure(theta, bench.rows.gaze, bench.rows.z_mm).value
    prior, truth = prior_of(model, bench.priors), theta[list(model.indices)]
    pull = -at_truth.T @ (seen / sigma**2) + prior.shift - prior.precision @ truth
    estimate: FloatArray = truth + bound @ pull
    return estimate


def _linear_estimates(bench: StudiedRig, model: Model) -> Mapping[str, Mapping[str, float]]:
    """Return what the paper's linear and the weighted bilinear least squares find, by name."""
    linear = fit_linear(bench.rows)
    sigma = row_noise(first_guess(bench.rows), bench.rows).sigma
    theta = fit_bilinear(bench.rows, 1 / sigma, axis_z="axis_z_mm" in model.free)
    solved = [name for name in model.free if name != "eccentricity_mm"]
    return {
        "linear": dict(zip(linear.names, map(float, linear.values), strict=True)),
        "bilinear": {n: float(theta[i]) for n, i in zip(model.free, model.indices, strict=True)
                     if n in solved},
    }  # fmt: skip


def _plain(value: Any) -> Any:
    """Return a document of plain numbers, texts and lists, rounded."""
    match value:
        case dict():
            return {key: _plain(part) for key, part in value.items()}
        case list() | tuple() | np.ndarray():
            return [_plain(part) for part in value]
        case float() | np.floating():
            number = float(f"{value:.{DIGITS}g}")
            return number if np.isfinite(number) else None
        case _:
            return value
