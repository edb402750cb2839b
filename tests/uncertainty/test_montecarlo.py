"""Evidence: published (the known case, JCGM 101 examples), closed forms, property."""

from __future__ import annotations

import math

import known_case
import numpy as np
import pytest
from scipy import stats

from calib.core.errors import EstimationError
from calib.uncertainty.depth import depth_uncertainty
from calib.uncertainty.distributions import (
    PARTS,
    GivenInputs,
    NormalInputs,
    RectangularInputs,
    StudentInputs,
    draw,
    factor,
    triangular_factor,
)
from calib.uncertainty.montecarlo import (
    BLOCK_TRIALS,
    Interval,
    numerical_tolerance,
    propagate,
    shortest_interval,
    validate,
)


def _sum(inputs: np.ndarray) -> np.ndarray:
    return inputs.sum(axis=1)


def test_known_case_shortest_interval_and_verdict() -> None:
    result, draws = depth_uncertainty(
        known_case.instrument(), known_case.READING, np.random.default_rng(5)
    )
    mc = result.monte_carlo
    assert mc.stable
    assert mc.shortest.low == pytest.approx(2185.2, abs=1)
    assert mc.shortest.high == pytest.approx(2387.4, abs=1)
    assert not result.validation.validated
    assert not result.linear_valid
    assert result.interval == mc.shortest
    assert draws.share_within(mc.shortest.low, mc.shortest.high) == pytest.approx(0.95, abs=2e-5)


@pytest.mark.parametrize(
    ("u", "digits", "tolerance"),
    # The examples of JCGM 101, 7.9.2: 0.00035 g, 2 digits: 35e-5, 0.000005; 2 K, 1 digit: 0.5.
    [(0.00035, 2, 0.000005), (2.0, 1, 0.5), (54.6, 2, 0.5), (9.96, 2, 0.5), (0.0996, 2, 0.005)],
)
def test_numerical_tolerance(u: float, digits: int, tolerance: float) -> None:
    assert numerical_tolerance(u, digits=digits) == pytest.approx(tolerance, rel=1e-12)


def test_sum_of_four_rectangular_quantities() -> None:
    """JCGM 101, 9.2.3: unit standard uncertainties; analytic 95 % interval ±3.88 of u = 2.00."""
    block = RectangularInputs(np.zeros(4), np.full(4, math.sqrt(3)))
    linear = Interval(-3.92, 3.92)
    draws = propagate(_sum, [block], np.random.default_rng(1), linear=linear)
    result = draws.summary()
    assert result.standard_uncertainty == pytest.approx(2.0, abs=result.tolerance)
    # Printed to two decimals; ends are known to `tolerance`, 0.05.
    for interval in (result.symmetric, result.shortest):
        assert interval.low == pytest.approx(-3.88, abs=result.tolerance + 0.005)
        assert interval.high == pytest.approx(3.88, abs=result.tolerance + 0.005)
    verdict = validate(result, estimate=0.0, standard_uncertainty=2.0, coverage_factor=1.959964)
    # |3.92 - 3.88| = 0.04 < 0.05: close, so that trials had to go on until it was clear.
    assert verdict.validated
    assert result.trials > 10 * BLOCK_TRIALS


def test_mass_calibration_is_not_validated() -> None:
    """JCGM 101, 9.3: u = 0.0754 mg, 95 % shortest [1.0834, 1.3825]; first order u 0.0539."""
    nominal = 100_000.0  # mg

    def measure(x: np.ndarray) -> np.ndarray:
        weight, correction, air, body, reference = x.T
        return (weight + correction) * (1 + (air - 1.2) * (1 / body - 1 / reference)) - nominal

    blocks = [
        NormalInputs(np.array([100_000.0, 1.234]), np.diag([0.05**2, 0.02**2])),
        RectangularInputs(np.array([1.2, 8e3, 8e3]), np.array([0.1, 1e3, 0.05e3])),
    ]
    result = propagate(measure, blocks, np.random.default_rng(2)).summary()
    assert result.estimate == pytest.approx(1.2341, abs=5e-4)
    assert result.standard_uncertainty == pytest.approx(0.0754, abs=5e-4)
    # The place of a shortest interval is loose, its width is not: published 0.2991 mg.
    assert result.shortest.low == pytest.approx(1.0834, abs=3e-3)
    assert result.shortest.high - result.shortest.low == pytest.approx(0.2991, abs=7e-4)
    verdict = validate(result, estimate=1.2340, standard_uncertainty=0.0539, coverage_factor=1.96)
    assert not verdict.validated


def test_equal_generators_give_equal_results() -> None:
    block = NormalInputs(np.zeros(2), np.eye(2))
    first, second = (propagate(_sum, [block], np.random.default_rng(9)).summary() for _ in range(2))
    assert first == second


def test_validated_verdict_on_a_linear_model() -> None:
    block = NormalInputs(np.zeros(1), np.eye(1))
    half = 1.96
    draws = propagate(_sum, [block], np.random.default_rng(3), linear=Interval(-half, half))
    result = draws.summary()
    verdict = validate(result, estimate=0.0, standard_uncertainty=1.0, coverage_factor=half)
    assert verdict.validated


def test_verdict_considers_its_own_numerical_uncertainty() -> None:
    """A difference just inside the tolerance, known only roughly, does not validate."""
    result = propagate(
        _sum, [NormalInputs(np.zeros(1), np.eye(1))], np.random.default_rng(4)
    ).summary()
    inside = 0.9 * result.tolerance
    assert result.numerical_low > 0.2 * result.tolerance
    verdict = validate(
        result,
        estimate=0.0,
        standard_uncertainty=1.0,
        coverage_factor=inside - result.symmetric.low,
    )
    assert verdict.difference_low == pytest.approx(inside)
    assert not verdict.validated


def test_student_inputs_give_the_interval_of_the_t_distribution() -> None:
    block = StudentInputs(np.array([10.0]), np.array([[4.0]]), 4.0)
    result = propagate(_sum, [block], np.random.default_rng(6)).summary()
    half = 2 * stats.t.ppf(0.975, 4)
    assert result.symmetric.low == pytest.approx(10 - half, abs=2 * result.numerical_low)
    assert result.symmetric.high == pytest.approx(10 + half, abs=2 * result.numerical_high)
    # Four degrees of freedom have no fourth moment: the sample deviation converges slowly.
    assert result.standard_uncertainty == pytest.approx(2 * math.sqrt(2), rel=0.1)


def test_two_degrees_of_freedom_have_an_interval_but_no_standard_uncertainty() -> None:
    block = StudentInputs(np.array([0.0]), np.array([[1.0]]), 2.0)
    result = propagate(_sum, [block], np.random.default_rng(7)).summary()
    assert result.standard_uncertainty is None
    assert result.estimate is None
    assert result.symmetric.high == pytest.approx(4.303, abs=2 * result.numerical_high)


def test_student_block_shares_one_scale() -> None:
    """JCGM 102, 5.3.2: components of one multivariate t are large together."""
    block = StudentInputs(np.zeros(2), np.eye(2), 3.0)
    drawn = draw(block, np.random.default_rng(8), 40_000)
    large = np.abs(drawn) > 3
    both = np.mean(large.all(axis=1))
    # Independent tails would meet with the product of their probabilities.
    assert both > 3 * np.mean(large[:, 0]) * np.mean(large[:, 1])


def test_given_draws_show_that_they_are_few() -> None:
    rng = np.random.default_rng(10)
    few = propagate(_sum, [GivenInputs(rng.standard_normal((2000, 1)))], rng).summary()
    assert few.stable
    assert few.limited_by_draws
    # 97.5 % quantile of 2000 normal draws: standard deviation sqrt(p (1 - p) / m) / f(q) = 0.060;
    # ten parts know it to a quarter, so twice it lies within 0.12 +- 3 · 0.03.
    assert few.numerical_high == pytest.approx(0.12, abs=0.09)
    many = propagate(_sum, [GivenInputs(rng.standard_normal((400_000, 1)))], rng).summary()
    assert not many.limited_by_draws


def test_correlated_draws_of_a_chain_count_for_less() -> None:
    """The parts follow the chain: slow mixing shows as scatter between them."""
    rng = np.random.default_rng(11)
    chain = np.empty(20_000)
    chain[0] = 0.0
    step = rng.standard_normal(len(chain)) * math.sqrt(1 - 0.995**2)
    for i in range(1, len(chain)):
        chain[i] = 0.995 * chain[i - 1] + step[i]
    slow = propagate(_sum, [GivenInputs(chain[:, None])], rng).summary()
    shuffled = propagate(_sum, [GivenInputs(rng.permutation(chain)[:, None])], rng).summary()
    assert slow.numerical_estimate > 3 * shuffled.numerical_estimate


def test_every_given_draw_can_be_drawn_and_only_from_its_part() -> None:
    block = GivenInputs(np.arange(100.0)[:, None])
    rng = np.random.default_rng(12)
    for part in range(PARTS):
        drawn = draw(block, rng, 2000, part=part)
        assert set(drawn.ravel()) == set(range(10 * part, 10 * part + 10))


def test_covariance_factor_of_a_semidefinite_matrix_with_unlike_units() -> None:
    root = np.array([[1.0, 0], [1e-6, 0], [5e-7, 2e-7]])
    covariance = root @ root.T
    found = factor(covariance)
    np.testing.assert_allclose(found @ found.T, covariance, rtol=1e-9)


def test_triangular_factor_of_semidefinite_matrices() -> None:
    rng = np.random.default_rng(18)
    root = rng.standard_normal((6, 3)) * np.array([1.0, 1e-3, 1e-6, 1, 1e-3, 1])[:, None]
    root[2] = 0.0
    root[4] = 1e-3 * root[0]
    covariance = root @ root.T
    found = triangular_factor(covariance)
    scale = np.sqrt(np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0))
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(found @ found.T / unit, covariance / unit, atol=1e-12)
    np.testing.assert_array_equal(found, np.tril(found))
    # An input without variance, one that another determines, and the last: rank three.
    np.testing.assert_array_equal(np.flatnonzero(~found.any(axis=0)), [2, 4, 5])
    np.testing.assert_array_equal(found[:4, :4], triangular_factor(covariance[:4, :4]))
    regular = covariance + np.diag(scale**2)
    np.testing.assert_allclose(triangular_factor(regular), np.linalg.cholesky(regular), rtol=1e-9)


def test_shortest_interval_of_an_exponential_starts_at_its_mode() -> None:
    ordered = np.sort(np.random.default_rng(13).exponential(size=200_000))
    interval = shortest_interval(ordered)
    # [0, -ln 0.05], JCGM 101 fig. 1's asymmetric case; the end's standard deviation is 0.01.
    assert interval.low == pytest.approx(0, abs=1e-3)
    assert interval.high == pytest.approx(-math.log(0.05), abs=0.03)


def test_shortest_interval_holds_95_percent_and_is_no_longer_than_the_symmetric() -> None:
    ordered = np.sort(1 / np.random.default_rng(14).normal(10, 1, 100_001))
    interval = shortest_interval(ordered)
    inside = np.count_nonzero((ordered >= interval.low) & (ordered <= interval.high))
    assert inside == pytest.approx(0.95 * len(ordered), abs=1.5)
    low, high = np.quantile(ordered, [0.025, 0.975])
    assert interval.high - interval.low < high - low


def test_trials_without_result_count_as_beyond_the_interval() -> None:
    def measure(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] > 0.98, np.inf, x[:, 0])

    block = RectangularInputs(np.array([0.5]), np.array([0.5]))
    result = propagate(measure, [block], np.random.default_rng(15)).summary()
    assert result.standard_uncertainty is None
    assert result.symmetric.high == pytest.approx(0.975, abs=2 * result.numerical_high)
    assert math.isfinite(result.shortest.high)


def test_interval_without_end_is_an_error() -> None:
    def measure(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] > 0.9, np.inf, x[:, 0])

    block = RectangularInputs(np.array([0.5]), np.array([0.5]))
    with pytest.raises(EstimationError, match="has no end"):
        propagate(measure, [block], np.random.default_rng(16))


def test_too_few_trials_are_admitted() -> None:
    block = NormalInputs(np.zeros(1), np.eye(1))
    result = propagate(
        _sum, [block], np.random.default_rng(17), digits=4, maximum_trials=100_000
    ).summary()
    assert not result.stable
