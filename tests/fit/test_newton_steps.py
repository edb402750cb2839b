"""The robust fit by Newton steps, of many rows and few.

Evidence: scipy's optimiser in their place, central differences, closed forms, properties.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from calib.fit import robust, row_sums
from calib.fit.noise import CLEAN, ROBUST, Tails, is_outlier, log_density, row_noise
from calib.fit.priors import MeasuredParameters, NormalKnowledge, Priors, measured_of, prior_of
from calib.fit.reweighting import LAST_STEP, FitProblem, FitSolution
from calib.fit.robust import RobustFit, fit_robust
from calib.fit.row_sums import residuals, sum_rows
from calib.geometry.misclosure import misclosure, misclosure_value
from calib.geometry.parameters import MODELS, Model, embed
from calib.rows.observations import Observations

TRUTH = {
    "axis_z_mm": -20.0, "eccentricity_mm": 2.0, "axis_tilt_x_rad": 0.01, "gaze_roll_rad": 0.008,
    "encoder_scale": 0.004, "encoder_cos_rad": 0.001,
}  # fmt: skip
STATED = Priors({"axis_z_mm": (-15.0, 2.0), "encoder_scale": (0.0, 1e-3)})
MEASURED = Priors(
    {},
    MeasuredParameters(
        ("eccentricity_mm", "axis_z_mm"),
        np.array([2.1, -19.0]),
        np.array([[0.04, 0.01], [0.01, 0.09]]),
    ),
)
COUNT = 3000


def rows_of(model: str, *, count: int = COUNT, outliers: int = 0, seed: int = 1) -> Observations:
    parameters = {k: v for k, v in TRUTH.items() if k in MODELS[model].free}
    rng = np.random.default_rng(seed)
    return simulated(rng, count=count, outliers=outliers, **parameters)[0]


@pytest.fixture
def near(monkeypatch: pytest.MonkeyPatch) -> list[FitSolution | None]:
    """What Newton steps have arrived at, call by call."""
    found: list[FitSolution | None] = []
    settle_near = FitProblem.settle_near

    def spied(self: FitProblem, theta: np.ndarray, scale: float) -> FitSolution | None:
        found.append(settle_near(self, theta, scale))
        return found[-1]

    monkeypatch.setattr(FitProblem, "settle_near", spied)
    return found


def by_optimiser(
    monkeypatch: pytest.MonkeyPatch, rows: Observations, model: str, priors: Priors
) -> RobustFit:
    with monkeypatch.context() as patch:
        patch.setattr(FitProblem, "settle_near", lambda *_: None)
        return fit_robust(rows, MODELS[model], priors)


@pytest.mark.parametrize("outliers", [0, 300])
@pytest.mark.parametrize(
    ("model", "priors"),
    [
        ("base", NO_PRIORS),
        ("axis-offset", NO_PRIORS),
        ("axis-offset", STATED),
        ("axis-offset", MEASURED),
        ("axis-tilt", NO_PRIORS),
        ("encoder", NO_PRIORS),
        ("encoder", STATED),
    ],
)
def test_newton_steps_and_optimiser_agree(
    monkeypatch: pytest.MonkeyPatch,
    near: list[FitSolution | None],
    model: str,
    priors: Priors,
    outliers: int,
) -> None:
    """Independent way: the rounds of scipy's optimiser, on the same rows.

    These end where a step lowers the cost, some COUNT / 2, by less than 1e-14 of it: at
    sqrt(1e-14 COUNT) standard deviations from the least cost.
    """
    rows = rows_of(model, outliers=outliers)
    quick = fit_robust(rows, MODELS[model], priors)
    assert [one is not None for one in near] == [True]
    slow = by_optimiser(monkeypatch, rows, model, priors)
    assert len(near) == 1
    assert len(quick.outliers) >= outliers
    assert (quick.outliers, quick.tails) == (slow.outliers, slow.tails)
    np.testing.assert_array_equal(quick.rejected, slow.rejected)
    tolerance = np.sqrt(1e-14 * COUNT) + LAST_STEP
    std = np.sqrt(np.diag(slow.covariance))
    np.testing.assert_allclose((quick.values - slow.values) / std, 0, atol=tolerance)
    np.testing.assert_allclose(
        quick.covariance / np.outer(std, std), slow.covariance / np.outer(std, std), atol=tolerance
    )
    assert quick.noise_scale == pytest.approx(slow.noise_scale, rel=tolerance)
    assert quick.identified_by == slow.identified_by


@pytest.mark.parametrize("outliers", [0, 300])
@pytest.mark.parametrize("model", list(MODELS))
def test_the_estimate_has_the_greatest_density(model: str, outliers: int) -> None:
    """Central differences of the log density: the gradient, in standard deviations, is nothing.

    Steps of 1e-3 standard deviations: the third derivatives of so many rows leave 1e-8, rounding of
    a sum of 3000 terms as much.
    """
    rows = rows_of(model, outliers=outliers)
    fit = fit_robust(rows, MODELS[model], MEASURED)
    kept = rows.take(~fit.rejected)
    sigma = row_noise(fit.theta, kept).sigma
    known = prior_of(MODELS[model], MEASURED) + measured_of(MODELS[model], MEASURED)

    def log_posterior(values: np.ndarray) -> float:
        miss = misclosure_value(embed(values, fit.names), kept.gaze, kept.z_mm) / sigma
        rows_part = log_density(miss, np.log(fit.noise_scale), fit.tails).sum()
        return float(rows_part - values @ known.precision @ values / 2 + known.shift @ values)

    factor = np.linalg.cholesky(fit.covariance)
    for step in 1e-3 * factor.T:
        slope = log_posterior(fit.values + step) - log_posterior(fit.values - step)
        assert slope / 2e-3 == pytest.approx(0, abs=2 * LAST_STEP)


def test_a_start_too_far_is_left_to_the_optimiser(
    monkeypatch: pytest.MonkeyPatch, near: list[FitSolution | None]
) -> None:
    """Negative control: the rows that the search for outliers looks at are not like the others."""
    rows = rows_of("axis-offset")
    monkeypatch.setattr(robust, "ROUGH_ROWS", 60)
    shifted = rows.alpha2_rad.copy()
    shifted[np.linspace(0, COUNT - 1, 60).astype(int)] += 6e-4
    rows = replace(rows, alpha2_rad=shifted)
    quick = fit_robust(rows, MODELS["axis-offset"], NO_PRIORS)
    assert near == [None]
    slow = by_optimiser(monkeypatch, rows, "axis-offset", NO_PRIORS)
    np.testing.assert_array_equal(quick.values, slow.values)
    assert quick.evaluations == slow.evaluations


def test_density_that_curves_the_wrong_way_has_no_step(near: list[FitSolution | None]) -> None:
    """Negative control: half of the rows say one thing, half another, and the start lies between.

    There the Student-t density of robust tails is least, not greatest.
    """
    rows = rows_of("base")
    apart = np.where(np.arange(COUNT) % 2, 1, -1) * 0.01
    rows = replace(rows, alpha2_rad=rows.alpha2_rad + apart)
    theta = embed(np.array([120.0, 0.01]), MODELS["base"].free)
    problem = problem_of(rows, MODELS["base"], ROBUST)
    assert problem.settle_near(theta, 1.0) is None
    assert problem_of(rows_of("base"), MODELS["base"], ROBUST).settle_near(theta, 1.0) is not None
    assert len(near) == 2


def problem_of(rows: Observations, model: Model, tails: Tails) -> FitProblem:
    return FitProblem(
        rows, model, prior_of(model, NO_PRIORS), measured_of(model, NO_PRIORS), (0.0, 1.0), tails
    )


@pytest.mark.parametrize("outliers", [0, 300])
@pytest.mark.parametrize("model", ["axis-offset", "encoder"])
def test_order_of_rows_does_not_matter(model: str, outliers: int) -> None:
    """Property: not in what is found, but for the last step of either."""
    rows = rows_of(model, outliers=outliers, seed=2)
    order = np.random.default_rng(3).permutation(COUNT)
    one = fit_robust(rows, MODELS[model], NO_PRIORS)
    other = fit_robust(rows.take(order), MODELS[model], NO_PRIORS)
    assert set(one.outliers) == set(other.outliers)
    np.testing.assert_array_equal(one.rejected[order], other.rejected)
    std = np.sqrt(np.diag(one.covariance))
    np.testing.assert_allclose((one.values - other.values) / std, 0, atol=2 * LAST_STEP)
    assert one.noise_scale == pytest.approx(other.noise_scale, rel=2 * LAST_STEP)


def test_order_of_few_rows_does_not_choose_the_tails() -> None:
    """Property: eight rows and two parameters leave six degrees of freedom, in any order.

    Rounding of the parameters' number once made it 6 - 1e-15 in some. The rows scatter seventeen
    times as much as stated, two of them gross errors that none names.
    """
    rows, _ = simulated(np.random.default_rng(10), count=8, outliers=2, axis_z_mm=-20.0)
    for seed in range(10):
        order = np.random.default_rng(seed).permutation(8)
        fit = fit_robust(rows.take(order), MODELS["base"], NO_PRIORS)
        assert (fit.data_parameters, fit.tails) == (2.0, CLEAN)


def test_sums_are_those_of_all_rows_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed forms and central differences, with blocks that do not go into the rows evenly."""
    monkeypatch.setattr(row_sums, "BLOCK", 70)
    model, scale = MODELS["encoder"], 1.3
    rows, theta = simulated(np.random.default_rng(4), count=300, outliers=30, **TRUTH)
    sums = sum_rows(theta, rows, model, scale=scale, tails=ROBUST)
    c = misclosure(theta, rows.gaze, rows.z_mm, parameters=model.indices)
    sigma = row_noise(theta, rows).sigma
    np.testing.assert_allclose(sums.sigma, sigma, rtol=1e-14)
    np.testing.assert_allclose(sums.standardised, c.value / sigma, rtol=1e-10)
    kept = ~is_outlier(c.value / sigma, scale)
    assert 250 < kept.sum() <= 270
    slope = (c.by_theta / sigma[:, None])[kept] / scale
    np.testing.assert_allclose(
        sums.information, ROBUST.efficiency * slope.T @ slope, rtol=1e-10, atol=1e-9
    )

    def gradient(direction: np.ndarray) -> np.ndarray:
        return sum_rows(theta + direction, rows, model, scale=scale, tails=ROBUST).gradient

    def cost(direction: np.ndarray) -> float:
        miss = misclosure_value(theta + direction, rows.gaze, rows.z_mm) / sigma
        return -float(log_density(miss, np.log(scale), ROBUST).sum())

    step = 1e-2 / np.sqrt(np.diag(sums.information))
    for i, place in enumerate(model.indices):
        ahead = np.zeros_like(theta)
        ahead[place] = step[i]
        slope_i = (cost(ahead) - cost(-ahead)) / 2 * 1e2
        # In standard deviations. Of 300 rows, second derivatives change by a hundredth of their
        # size over such a step, and so do the weights in `gradient`.
        assert step[i] * 1e2 * sums.gradient[i] == pytest.approx(slope_i, abs=1e-2)
        bend = (gradient(ahead) - gradient(-ahead)) / 2 * step * 1e4
        wanted = step * 1e2 * sums.curvature[i] * step[i] * 1e2
        np.testing.assert_allclose(bend, wanted, atol=0.05)


def test_residuals_are_those_of_all_rows_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, theta = simulated(np.random.default_rng(4), count=300, **TRUTH)
    whole = residuals(theta, rows)
    monkeypatch.setattr(row_sums, "BLOCK", 70)
    parts = residuals(theta, rows)
    for name in ("standardised", "mrad"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    np.testing.assert_allclose(whole.sigma, row_noise(theta, rows).sigma, rtol=1e-14)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-40, 40), min_size=3, max_size=40),
    st.floats(0, 3),
    st.floats(-1, 1),
    st.sampled_from([ROBUST, CLEAN]),
)
def test_noise_scale_has_the_greatest_density(
    standardised: list[float], parameters: float, mean: float, tails: Tails
) -> None:
    """Independent tool: SciPy's search of the same density, parameters integrated out."""
    values = np.array(standardised)
    model = MODELS["base"]
    problem = replace(problem_of(rows_of("base", count=6), model, tails), noise_prior=(mean, 1.0))
    freedom = max(len(values) - parameters, 0.0)

    def cost(log_scale: float) -> float:
        rows_part = log_density(values, log_scale, tails).sum() + len(values) * log_scale
        return float(freedom * log_scale - rows_part + (log_scale - mean) ** 2 / 2)

    wanted = minimize_scalar(cost, bracket=(-1, 1), tol=1e-10)
    found = np.log(problem.noise_scale(values, parameters))
    # The search sees the cost to 1e-16 of it, hence the place to the root of that.
    assert cost(found) <= wanted.fun + 1e-13 * (1 + abs(wanted.fun))
    assert found == pytest.approx(wanted.x, abs=1e-5)


def test_a_sharp_prior_leaves_a_wide_one_alone() -> None:
    """Closed form: precisions sixteen powers of ten apart, as of a roll and a length, both hold."""
    precision = np.diag([0.0, 2.5e-3, 1e13])
    precision[1, 2] = precision[2, 1] = 1e4
    shift = np.array([0.0, 3.0, 5e8])
    a, b = NormalKnowledge(precision, shift).root()
    assert a.shape == (2, 3)
    unit = np.sqrt([1.0, 2.5e-3, 1e13])
    np.testing.assert_allclose(a.T @ a / np.outer(unit, unit), precision / np.outer(unit, unit),
                               atol=1e-14)  # fmt: skip
    np.testing.assert_allclose(a.T @ b / unit, shift / unit, rtol=1e-12)


def test_memory_beside_the_rows() -> None:
    """Bytes a row: ten numbers, and with a tenth rejected a copy of the table."""
    for outliers, most in ((0, 110), (10_000, 200)):
        rows = rows_of("axis-offset", count=100_000, outliers=outliers)
        tracemalloc.start()
        try:
            fit_robust(rows, MODELS["axis-offset"], NO_PRIORS)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak / len(rows) < most


@pytest.mark.parametrize("count", [6, 14, 60])
@pytest.mark.parametrize("model", ["base", "axis-offset"])
def test_few_rows_left_out_one_by_one_are_settled_alike(
    monkeypatch: pytest.MonkeyPatch, near: list[FitSolution | None], model: str, count: int
) -> None:
    """Whichever way settles them: the steps, or the optimiser where these do not converge."""
    rows = rows_of(model, count=count, seed=count)
    start = fit_robust(rows, MODELS[model], STATED)
    for i in range(0, count, max(1, count // 6)):
        kept = rows.take(np.arange(count) != i)
        quick = fit_robust(kept, MODELS[model], STATED, start=start.theta)
        # An offset that few rows hardly tell may take more steps than there are.
        assert model != "base" or near[-1] is not None
        with monkeypatch.context() as patch:
            patch.setattr(FitProblem, "settle_near", lambda *_: None)
            slow = fit_robust(kept, MODELS[model], STATED, start=start.theta)
        std = np.sqrt(np.diag(slow.covariance))
        np.testing.assert_allclose((quick.values - slow.values) / std, 0, atol=3 * LAST_STEP)
        assert quick.outliers == slow.outliers
        assert quick.noise_scale == pytest.approx(slow.noise_scale, rel=1e-6)
