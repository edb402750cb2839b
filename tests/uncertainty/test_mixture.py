"""Mixtures of models. Evidence: closed forms, and quantiles of drawn mixtures."""

from __future__ import annotations

import numpy as np
import pytest

from calib.uncertainty.mixture import mix_depths, mix_moments

FACTOR = 1.959963984540054


def test_one_model_keeps_its_own_interval() -> None:
    """Closed form: 1 / (1 / z ± k u / z²), also where it does not limit the depth."""
    z, u = np.array([[800.0, 4000.0]]), np.array([[4.0, 3000.0]])
    found = mix_depths(np.array([1.0]), z, u, np.array([2.4]))
    half = 2.4 * u[0] / z[0] ** 2
    assert found.z_mm == pytest.approx(z[0])
    assert found.u_mm == pytest.approx(u[0])
    assert found.low95_mm == pytest.approx(1 / (1 / z[0] + half))
    assert found.high95_mm[0] == pytest.approx(1 / (1 / 800 - half[0]))
    assert np.isinf(found.high95_mm[1])


def test_quantiles_are_those_of_draws() -> None:
    """A million draws of inverse depth: their 2.5 % quantile is known to 0.4 % of a spread."""
    rng = np.random.default_rng(0)
    weights = np.array([0.3, 0.7])
    z, u, factors = np.array([[900.0], [930.0]]), np.array([[5.0], [12.0]]), np.array([2.1, 1.96])
    found = mix_depths(weights, z, u, factors)
    which = (rng.random(1_000_000) > weights[0]).astype(int)
    spread = factors / FACTOR * u[:, 0] / z[:, 0] ** 2
    inverse = 1 / z[which, 0] + spread[which] * rng.standard_normal(len(which))
    low, high = np.quantile(1 / inverse, [0.025, 0.975])
    assert found.low95_mm[0] == pytest.approx(low, abs=0.01 * 12)
    assert found.high95_mm[0] == pytest.approx(high, abs=0.01 * 12)
    assert found.z_mm[0] == pytest.approx(0.3 * 900 + 0.7 * 930)
    within, between = 0.3 * 25 + 0.7 * 144, 0.3 * 0.7 * 30**2
    assert found.u_mm[0] == pytest.approx(np.sqrt(within + between))


def test_moments_of_models_that_agree_are_theirs() -> None:
    mean, variance = mix_moments(np.array([0.2, 0.8]), np.full((2, 3), 7.0), np.full((2, 3), 4.0))
    assert mean == pytest.approx(7.0)
    assert variance == pytest.approx(4.0)
