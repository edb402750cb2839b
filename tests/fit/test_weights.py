"""Weights of models. Evidence: a grid search, closed forms, properties."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from calib.fit.leave_one_out import _log_sum
from calib.fit.weights import averaging_weights, stacking_weights


def test_stacking_weights_maximise_the_mixture() -> None:
    """Independent tool: a grid search over the simplex of two models."""
    rng = np.random.default_rng(0)
    pointwise = rng.normal(0, 1, (20, 2))
    weight = stacking_weights(pointwise)
    grid = np.linspace(0, 1, 2001)
    density = np.exp(pointwise)
    values = np.log(density[:, :1] * grid + density[:, 1:] * (1 - grid)).sum(axis=0)
    assert weight.sum() == pytest.approx(1.0)
    assert weight[0] == pytest.approx(grid[values.argmax()], abs=1e-3)


def test_averaging_weights_of_rows_that_all_say_the_same() -> None:
    """Closed form: without scatter between rows the bootstrap changes nothing, w ~ exp(LOO)."""
    pointwise = np.full((6, 2), [-1.0, -1.5])
    weight = averaging_weights(pointwise, np.random.default_rng(0))
    assert weight == pytest.approx(np.array([1.0, np.exp(-3.0)]) / (1 + np.exp(-3.0)))


def test_averaging_weights_leave_open_what_one_row_decides() -> None:
    """Closed form: one row of six is for the second model, by far.

    Its bootstrapped share is Beta(1, 5); the second model wins where 6 share gain exceeds the loss,
    here always but for a share below 0.01, whose probability is 1 - 0.99^5 = 0.049.
    """
    pointwise = np.zeros((6, 2))
    pointwise[0, 1], pointwise[1:, 1] = 1e6, -1e6 * 0.01 / 0.99
    weight = averaging_weights(pointwise, np.random.default_rng(0))
    assert weight[1] == pytest.approx(0.951, abs=4 * np.sqrt(0.951 * 0.049 / 2000))
    assert weight.sum() == pytest.approx(1.0)


def test_many_rows_are_weighed_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Property: two models whose densities are the same share the weight, whatever the parts."""
    monkeypatch.setattr("calib.fit.weights.CHUNK_ELEMENTS", 700)
    same = np.random.default_rng(0).normal(size=(50, 1)) * np.ones(2)
    assert averaging_weights(same, np.random.default_rng(0)) == pytest.approx(np.array([0.5, 0.5]))


def test_sums_of_left_out_densities_are_scipys() -> None:
    """Far below the least number, too, where exponentials by themselves would be 0."""
    terms = np.random.default_rng(6).normal(0, 30, (50, 400)) - 2000.0
    assert _log_sum(terms) == pytest.approx(logsumexp(terms, axis=1), rel=1e-14)
