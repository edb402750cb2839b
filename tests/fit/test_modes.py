"""Modes that a sample leaves out. Evidence: closed forms, rows of two truths, negative controls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chain_targets import normal, student, two_modes
from fit_rows import NO_PRIORS, simulated, table_1
from numpy.random import SeedSequence

from calib.checks.verdict import convergence
from calib.fit import posterior
from calib.fit.importance import ImportanceSample, sample_importance
from calib.fit.modes import FAR, find_left_out_mode
from calib.fit.posterior import laplace, look_for_left_out, posterior_of, sample_posterior
from calib.fit.priors import NOISE_SCALE, Priors
from calib.fit.robust import fit_model, fit_robust
from calib.geometry.parameters import MODELS


def first_alone(dimensions: int) -> ImportanceSample:
    """Return a sample of a unit normal about 0."""
    target = normal(np.zeros(dimensions), np.eye(dimensions))
    return sample_importance(
        target, np.zeros(dimensions), np.eye(dimensions), np.random.default_rng(0)
    )


@pytest.mark.parametrize("dimensions", [2, 5, 9])
@pytest.mark.parametrize("distance", [7.0, 12.0, 40.0, 200.0])
def test_a_second_mode_is_found(dimensions: int, distance: float) -> None:
    """Closed form: place and share. All starts miss it with a probability of 6e-4 at most."""
    target = two_modes(distance, dimensions, share=0.3)
    sample = first_alone(dimensions)
    for k in range(5):
        found = find_left_out_mode(target, sample, np.random.default_rng(k))
        assert found is not None
        assert found.share == pytest.approx(0.3, abs=1e-4)
        assert found.distance == pytest.approx(distance, rel=0.05)
        np.testing.assert_allclose(found.place, distance * np.eye(dimensions)[0], atol=0.02)


def test_shares_that_change_nothing_are_no_modes() -> None:
    sample, rng = first_alone(3), np.random.default_rng(0)
    assert find_left_out_mode(two_modes(50.0, 3, share=2e-3), sample, rng) is not None
    assert find_left_out_mode(two_modes(50.0, 3, share=5e-4), sample, rng) is None


@pytest.mark.parametrize("dof", [1.5, 4.0])
def test_one_mode_has_no_other(dof: float) -> None:
    """Negative control: heavy tails, from which climbs are long, hide no mode."""
    target = student(dof, 4)
    sample = sample_importance(target, np.zeros(4), np.eye(4), np.random.default_rng(0))
    for k in range(20):
        assert find_left_out_mode(target, sample, np.random.default_rng(k)) is None


def test_a_sample_of_both_modes_leaves_none_out() -> None:
    target, rng = two_modes(8.0, 2, share=0.4), np.random.default_rng(0)
    draws = rng.standard_normal((4000, 2))
    draws[:1600, 0] += 8.0
    sample = ImportanceSample(draws, np.full(4000, 1 / 4000), 0.1, 4000.0, 0.0)
    assert find_left_out_mode(target, sample, rng) is None


def test_density_that_ends_somewhere() -> None:
    """Property: steps into nowhere, where the density is 0 or not a number, are not taken."""

    def bounded(x: np.ndarray) -> np.ndarray:
        value = two_modes(20.0, 2, share=0.5)(x)
        value[x[:, 0] < -3] = np.nan
        value[x[:, 1] > 4] = -np.inf
        return value

    found = find_left_out_mode(bounded, first_alone(2), np.random.default_rng(0))
    assert found is not None
    assert found.share == pytest.approx(0.5, abs=1e-4)


def test_simulated_rigs_have_one_mode() -> None:
    """Negative control: few rows and many, good and bad, every model; angles half a turn on too."""
    rng = np.random.default_rng(0)
    tables = [table_1()]
    tables += [simulated(rng, count=n, outliers=n // 8, axis_z_mm=-20.0)[0] for n in (9, 14, 60)]
    for rows in tables:
        for name in MODELS if len(rows) > 8 else ("base", "axis-offset"):
            fit = fit_model(rows, NO_PRIORS, model=name)
            target = posterior_of(fit, rows, NO_PRIORS)
            sample = sample_importance(target, *laplace(fit, target), np.random.default_rng(0))
            assert look_for_left_out(target, sample, np.random.default_rng(0)) is None


@pytest.mark.parametrize("search_rows", [500, 12])
def test_rows_of_two_truths(search_rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the readings are 20 mrad on, and the manifest is sure of its uncertainties.

    The posterior then has modes tens of standard deviations apart. Fit and importance sample see
    one, and the sample passes for good. The search may look at some of the rows.
    """
    monkeypatch.setattr(posterior, "SEARCH_ROWS", search_rows)
    rows, _ = simulated(np.random.default_rng(0), count=20, axis_z_mm=-20.0)
    reading = rows.alpha2_rad.copy()
    reading[::2] += 0.02
    rows = replace(rows, alpha2_rad=reading)
    sure = Priors({NOISE_SCALE: (0.0, 0.05)})
    fit = fit_robust(rows, MODELS["axis-offset"], sure)
    found = sample_posterior(rows, fit, sure, seed=SeedSequence(0))
    assert found.k_hat < 0.5
    assert found.left_out is not None
    assert not found.converged
    assert found.left_out.distance > FAR
    target = posterior_of(fit, rows, sure)
    there, here = target(np.stack([found.left_out.place, found.importance_mean]))
    assert there > here + np.log(1e-3)
    gate = convergence({"axis-offset": found})
    assert not gate.passed
    assert f"baseline_mm {found.left_out.place[0]:.6g}" in gate.detail
