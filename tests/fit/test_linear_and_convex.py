"""Linear and convex fits. Evidence: published figures, simulated truth, weak duality."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_rows import simulated, table_1

from calib.core.errors import EstimationError
from calib.fit.convex import fit_convex
from calib.fit.linear import Bilinear, fit_bilinear, fit_linear, parameters_of
from calib.fit.noise import row_noise
from calib.fit.start import first_guess
from calib.geometry.misclosure import misclosure


def test_table_1_gives_the_papers_result() -> None:
    """Published: L_b = 77.09 mm, tan(delta2) = 0.0133; the table's rounding allows no closer."""
    fit = fit_linear(table_1())
    assert fit.values[0] == pytest.approx(77.09, abs=0.06)
    assert np.tan(fit.values[1]) == pytest.approx(0.0133, abs=1e-4)
    assert fit.sigma_mrad == pytest.approx(3.2, abs=0.15)
    assert 5e3 < fit.condition < 2e4


def test_the_third_unknown_is_the_axis_offset() -> None:
    """Simulated truth: without noise the linear system's product gives Z_a exactly."""
    rows, _ = simulated(np.random.default_rng(0), count=12, noise=0.0, axis_z_mm=-21.0)
    fit = fit_linear(rows)
    assert fit.implied_axis_z_mm == pytest.approx(-21.0, abs=1e-6)
    # The paper's "L_b" is L_b - Z_a tan(delta2).
    assert fit.values[0] == pytest.approx(120.0 + 21.0 * np.tan(0.01), abs=1e-6)


def test_reading_of_90_degrees_is_a_row_like_others() -> None:
    """Simulated truth: eq. (8) is eq. (7) divided by tan(alpha2) at 90 deg."""
    rows, theta = simulated(np.random.default_rng(1), count=10, noise=0.0)
    # Choose x1c such that the reading becomes exactly 90 deg.
    x = rows.x1c.copy()
    x[0] = theta[0] / rows.z_mm[0] + np.tan(theta[1])
    alpha = rows.alpha2_rad.copy()
    alpha[0] = np.pi / 2
    fit = fit_linear(replace(rows, x1c=x, alpha2_rad=alpha))
    np.testing.assert_allclose(fit.values, theta[:2], rtol=1e-9)


@pytest.mark.parametrize("axis_z", [False, True])
def test_bilinear_is_the_weighted_least_squares_minimum(axis_z: bool) -> None:
    """Property: at its solution the gradient of the weighted sum of squares vanishes.

    To first order in the residual: the form is exact, so what is left of the gradient is the
    product of residual and curvature, 1e-3 of each term at most.
    """
    offset = {"axis_z_mm": -15.0} if axis_z else {}
    rows, _ = simulated(np.random.default_rng(2), count=40, **offset)
    weights = 1 / row_noise(first_guess(rows), rows).sigma
    theta = fit_bilinear(rows, weights, axis_z=axis_z)
    c = misclosure(theta, rows.gaze, rows.z_mm)
    free = [0, 1, 2] if axis_z else [0, 1]
    terms = (weights**2 * c.value)[:, None] * c.by_theta[:, free]
    assert np.all(np.abs(terms.sum(axis=0)) < 2e-2 * np.abs(terms).sum(axis=0))


@pytest.mark.parametrize("axis_z", [False, True])
def test_many_bilinear_solutions_at_once_are_those_of_one_at_a_time(axis_z: bool) -> None:
    """Independent computation: each by itself, and its misclosures by the full model.

    A set of rows that are all alike determines nothing; it is told, and the others stay.
    """
    rows, _ = simulated(np.random.default_rng(4), count=12)
    rows = rows.take(np.array([*range(12), 0, 0]))
    weights = 1 / row_noise(first_guess(rows), rows).sigma
    chosen = np.array([[0, 3, 7, 9], [0, 12, 13, 0], [1, 2, 5, 11]])
    equations = Bilinear.of(rows)
    solved = equations.solve(weights, chosen, axis_z=axis_z)
    assert np.isnan(solved[1]).any()
    for place in (0, 2):
        own = np.zeros(len(rows))
        own[chosen[place]] = weights[chosen[place]]
        theta = fit_bilinear(rows, own, axis_z=axis_z)
        np.testing.assert_allclose(parameters_of(solved)[place], theta, rtol=1e-9, atol=1e-12)
        expected = misclosure(theta, rows.gaze, rows.z_mm).value
        found = equations.misclosures(solved)[place]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-13)


def test_convex_is_proved_optimal_and_agrees_without_outliers() -> None:
    """Weak duality: the gap is computed from the residuals, not taken from the solver."""
    rows, theta = simulated(np.random.default_rng(3), count=60)
    fit = fit_convex(rows)
    assert fit.optimal
    assert 0 <= fit.duality_gap + 1e-12 < 1e-6
    assert fit.at_bound == ()
    pull = (fit.values - theta[:2]) / np.sqrt(np.diag(fit.covariance))
    assert np.abs(pull).max() < 4


def test_convex_withstands_outliers_that_ruin_the_linear_fit() -> None:
    """Simulated truth: six of sixty rows are off by 6 to 18 mrad."""
    off, named = [], []
    for seed in range(20):
        rows, theta = simulated(np.random.default_rng(seed), count=60, outliers=6)
        convex, linear = fit_convex(rows), fit_linear(rows)
        off.append(np.array([convex.values, linear.values]) - theta[:2])
        named.append(len(convex.outliers))
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all(rms[0] < 0.6 * rms[1]), rms
    assert np.mean(named) == pytest.approx(6, abs=0.5)


@pytest.mark.parametrize("estimator", ["linear", "convex"])
def test_pulls_over_repeated_simulation(estimator: str) -> None:
    """Coverage: 200 rigs; the rms of 400 pulls is known to 4 % if they are normal."""
    fit_one = {"linear": fit_linear, "convex": fit_convex}[estimator]
    pulls = []
    for i in range(200 if estimator == "linear" else 60):
        rows, theta = simulated(np.random.default_rng(100 + i), count=30)
        fit = fit_one(rows)
        pulls.append((fit.values - theta[:2]) / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt(np.mean(np.square(pulls)))
    assert 0.85 < rms < 1.2


def test_rows_at_one_place_are_refused() -> None:
    """Negative control: six times the same target determine nothing."""
    rows = table_1().take(np.array([0, 0, 0, 0, 0, 0]))
    with pytest.raises(EstimationError, match="determine"):
        fit_linear(rows)
    with pytest.raises(EstimationError, match="determine"):
        fit_convex(rows)


def test_too_few_rows_are_refused() -> None:
    """Negative control."""
    with pytest.raises(EstimationError, match="2 rows"):
        fit_linear(table_1().take(np.array([0, 1])))


def test_published_parameters_leave_what_the_design_measured() -> None:
    """Published: base leaves about 3.2 mrad on Table 1, the axis offset 0.26."""
    rows = table_1()
    weights = np.ones(6)
    base = fit_bilinear(rows, weights, axis_z=False)
    offset = fit_bilinear(rows, weights, axis_z=True)
    # Half of the last digit printed.
    assert np.all(np.abs(base[:2] - [77.46, 0.01311]) <= [0.005, 5e-6])
    assert np.all(np.abs(offset[:3] - [76.93, 0.01315, -21.0]) <= [0.005, 5e-6, 0.05])
