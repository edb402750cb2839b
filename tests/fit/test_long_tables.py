"""What is done otherwise for long tables, to be quick. Evidence: closed forms, simulated truth, and
the way of short tables on the same rows."""

from __future__ import annotations

import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated
from numpy.random import SeedSequence

from calib.fit import robust
from calib.fit.density import SMALL_ANGLE_RAD, _sine_cosine, log_posterior
from calib.fit.leave_one_out import leave_one_out, of_chain
from calib.fit.noise import log_density
from calib.fit.posterior import laplace, sample_posterior
from calib.fit.robust import fit_robust
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import MODELS, embed

LONG_TABLE = 5000


def test_posterior_of_a_long_table_is_the_normal_one() -> None:
    """Closed form: with so many rows mode and curvature of the density tell mean and covariance."""
    rows, _ = simulated(np.random.default_rng(2), count=LONG_TABLE, axis_z_mm=-20.0)
    fit = fit_robust(rows, MODELS["base"], NO_PRIORS)
    posterior = sample_posterior(rows, fit, NO_PRIORS, seed=SeedSequence(0))
    assert posterior.converged
    assert posterior.agrees
    assert posterior.steps < 500
    target = log_posterior(
        rows, MODELS["base"], NO_PRIORS, fit.theta, rejected=fit.rejected, tails=fit.tails
    )
    centre, rough = laplace(fit, target)
    unit = np.sqrt(np.diag(rough))
    steps = 0.1 * np.eye(3)
    pairs = steps[:, None] + steps[None, :]
    points = np.concatenate([pairs, pairs - 2 * steps[None, :]]).reshape(-1, 3)
    points = np.concatenate([points, -points]) * unit + centre
    plus, minus = (p.reshape(3, 3) for p in target(points).reshape(2, 2, 9).sum(axis=0))
    std = unit * np.sqrt(np.diag(np.linalg.inv((minus - plus) / 0.04)))
    # Third derivatives shift the mean by a few hundredths of a standard deviation.
    np.testing.assert_allclose((posterior.mean - centre) / std, 0, atol=0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(posterior.covariance)) / std, 1, atol=0.05)


def test_series_of_small_angles() -> None:
    """Closed form: to the last digit but one, on both sides of the change."""
    for most in (SMALL_ANGLE_RAD, 1.01 * SMALL_ANGLE_RAD):
        angle = np.linspace(-most, most, 10_001)
        sine, cosine = _sine_cosine(angle)
        np.testing.assert_allclose(sine, np.sin(angle), rtol=4e-16, atol=1e-18)
        np.testing.assert_allclose(cosine, np.cos(angle), rtol=4e-16)


@pytest.mark.parametrize("encoder_sin_rad", [0.01, 0.4])
def test_rows_turned_by_the_encoder(encoder_sin_rad: float) -> None:
    """Property: the density by turned products is that of the misclosure, for any turn."""
    model = MODELS["encoder"]
    rows, theta = simulated(np.random.default_rng(0), count=23, axis_z_mm=-20.0)
    target = log_posterior(rows, model, NO_PRIORS, theta)
    free = theta[list(model.indices)]
    free[-1] = encoder_sin_rad
    miss = misclosure_value(embed(free, model.free), rows.gaze, rows.z_mm) / target.sigma
    expected = log_density(miss, 0.1, target.tails) + target.log_unit
    found = target.pointwise(np.append(free, 0.1)[None])[0]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_rows_set_aside_are_left_out_once() -> None:
    rows, theta = simulated(np.random.default_rng(0), count=30)
    rejected = np.arange(30) % 7 == 0
    target = log_posterior(rows, MODELS["base"], NO_PRIORS, theta, rejected=rejected)
    x = np.append(theta[list(MODELS["base"].indices)], 0.0)[None]
    np.testing.assert_array_equal(target(x), target.only(np.flatnonzero(~rejected))(x))
    assert target._heard is target._heard


@pytest.mark.slow
def test_rows_without_influence_need_no_smoothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent tool: arviz smooths the weights of every row of the same table."""
    rows, _ = simulated(np.random.default_rng(4), count=LONG_TABLE)
    fits = {"base": fit_robust(rows, MODELS["base"], NO_PRIORS)}
    chain = sample_posterior(rows, fits["base"], NO_PRIORS, seed=SeedSequence(0))
    draws = {"base": of_chain(chain, fits["base"])}

    def loo() -> np.ndarray:
        return leave_one_out(rows, fits, draws, NO_PRIORS, SeedSequence(0))["base"].pointwise

    quick = loo()
    monkeypatch.setattr("calib.fit.leave_one_out.NEARLY_EQUAL", 0.0)
    smoothed = loo()
    assert not np.array_equal(quick, smoothed)
    # Far below the two nats from which models count as different.
    np.testing.assert_allclose(quick, smoothed, atol=1e-4)
    assert quick.sum() == pytest.approx(smoothed.sum(), abs=0.02)


def test_outliers_are_found_from_some_of_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent way: the same fit with the rough search on all rows."""
    rows, _ = simulated(np.random.default_rng(5), count=30_000, outliers=600, axis_z_mm=-20.0)
    quick = fit_robust(rows, MODELS["axis-offset"], NO_PRIORS)
    monkeypatch.setattr(robust, "ROUGH_ROWS", 10**9)
    full = fit_robust(rows, MODELS["axis-offset"], NO_PRIORS)
    assert len(quick.outliers) >= 600
    # One row in 30,000 may lie between the two limits, which differ by half a percent.
    assert len(set(quick.outliers) ^ set(full.outliers)) <= 3
    std = np.sqrt(np.diag(full.covariance))
    np.testing.assert_allclose((quick.values - full.values) / std, 0, atol=0.05)
    assert quick.noise_scale == pytest.approx(full.noise_scale, rel=1e-3)
