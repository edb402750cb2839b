"""Posterior, importance sampling, comparison. Evidence: closed forms, definitions, properties."""

from __future__ import annotations

from dataclasses import replace

import emcee
import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated, table_1
from numpy.random import SeedSequence
from scipy.stats import multivariate_normal

from calib.core.errors import EstimationError
from calib.fit.chains import ENSEMBLES, autocorrelation_times
from calib.fit.compare import compare_models, select
from calib.fit.density import LogPosterior, log_posterior
from calib.fit.importance import sample_importance
from calib.fit.noise import CLEAN, log_density, row_noise
from calib.fit.posterior import Posterior, laplace, posterior_of, sample_posterior
from calib.fit.priors import NOISE_SCALE, MeasuredParameters, Priors, measured_of, prior_of
from calib.fit.robust import RobustFit, fit_model, fit_robust
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import MODELS, REFERENCE_OFFSET, STANDOFF, embed, model_for
from calib.rows.observations import Observations


@pytest.fixture(scope="module")
def fits() -> dict[str, RobustFit]:
    return {
        name: fit_robust(table_1(), MODELS[name], NO_PRIORS) for name in ("base", "axis-offset")
    }


@pytest.fixture(scope="module")
def posteriors(fits: dict[str, RobustFit]) -> dict[str, Posterior]:
    return {
        name: sample_posterior(table_1(), fit, NO_PRIORS, seed=SeedSequence(1))
        for name, fit in fits.items()
    }


@pytest.mark.parametrize("offset_open", [False, True])
@pytest.mark.parametrize("off_centre", [False, True])
@pytest.mark.parametrize("name", list(MODELS))
def test_log_posterior_is_the_sum_of_its_parts(
    name: str, off_centre: bool, offset_open: bool
) -> None:
    """Property: the matrix product equals row densities of `misclosure` plus priors."""
    model, rng = (
        model_for(name, off_centre=off_centre, offset_open=offset_open),
        np.random.default_rng(0),
    )
    rows, theta = simulated(rng, count=17, axis_z_mm=-20.0)
    if off_centre:
        rows = replace(rows, gaze_residual_rad=rng.normal(0, 0.03, 17))
    measured = MeasuredParameters(("eccentricity_mm",), np.array([2.0]), np.array([[0.5]]))
    priors = Priors({"axis_z_mm": (-10.0, 5.0), NOISE_SCALE: (0.2, 0.5)}, measured)
    target = log_posterior(rows, model, priors, theta, tails=CLEAN)
    x = np.array([theta[i] for i in (*model.indices, 0)]) + 0.0
    x[-1] = 0.1
    draws = x + 1e-3 * rng.standard_normal((5, len(x)))
    for far in (STANDOFF, REFERENCE_OFFSET):
        if far in model.free:
            draws[:, model.free.index(far)] += 30 * rng.standard_normal(5)
    sigma = row_noise(theta, rows).sigma
    knowledge = prior_of(model, priors) + measured_of(model, priors)
    expected = []
    for draw in draws:
        miss = misclosure(embed(draw[:-1], model.free), rows.gaze, rows.z_mm).value / sigma
        free = draw[:-1]
        quadratic = free @ knowledge.precision @ free / 2 - free @ knowledge.shift
        noise = ((draw[-1] - 0.2) / 0.5) ** 2 / 2
        rows_part = CLEAN.efficiency * log_density(miss, draw[-1], CLEAN).sum()
        expected.append(rows_part - quadratic - noise)
    np.testing.assert_allclose(np.diff(target(draws)), np.diff(expected), rtol=1e-9, atol=1e-8)
    pointwise = target.pointwise(draws)
    np.testing.assert_allclose(
        pointwise,
        np.concatenate([target.only(np.array([i])).pointwise(draws) for i in range(17)], axis=1),
        rtol=1e-10,
    )


def test_wild_noise_scales_have_next_to_no_density() -> None:
    """Property: far out in a proposal's tail nothing overflows into a warning or a NaN."""
    rows, theta = simulated(np.random.default_rng(0), count=17, axis_z_mm=-20.0)
    target = log_posterior(rows, MODELS["base"], NO_PRIORS, theta, tails=CLEAN)
    x = np.tile([*theta[list(MODELS["base"].indices)], 0.0], (4, 1))
    x[1:, -1] = -2000.0, 2000.0, -80.0
    density = target(x)
    assert not np.isnan(density).any()
    assert (density[1:] < density[0] - 1000).all()
    assert not np.isnan(target.pointwise(x)).any()


def test_importance_sampling_of_a_normal_density() -> None:
    """Closed form: evidence, mean and covariance of a correlated normal (r = -0.9997)."""
    covariance = np.array([[100.0, -99.97, 0], [-99.97, 100.0, 0], [0, 0, 1e-6]])
    normal = multivariate_normal(np.array([77.0, 0.5, 0.01]), covariance)
    sample = sample_importance(
        lambda x: normal.logpdf(x) + 3.0,
        np.array([75.0, 2.0, 0.0105]),
        1.4 * covariance,
        np.random.default_rng(0),
    )
    assert sample.reliable
    error = 4 / np.sqrt(sample.ess)
    assert sample.log_evidence == pytest.approx(3.0, abs=error)
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(sample.mean - normal.mean) / std, error)
    np.testing.assert_allclose(np.sqrt(np.diag(sample.covariance)) / std, 1, atol=error)
    quantiles = sample.quantiles((0.158655, 0.841345))
    np.testing.assert_allclose((quantiles[1] - quantiles[0]) / 2 / std, 1, atol=2 * error)


def test_importance_sampling_says_when_it_fails() -> None:
    """Negative control: a density far from the guess and much wider must not pass as reliable."""
    sample = sample_importance(
        lambda x: -(np.abs(x[:, 0] - 40.0) ** 0.2) - 1e6 * x[:, 1] ** 2,
        np.zeros(2),
        np.diag([1e-8, 1e4]),
        np.random.default_rng(0),
    )
    assert not sample.reliable


def test_posterior_of_table_1(posteriors: dict[str, Posterior]) -> None:
    """Converged, confirmed by the second computation, and about the finding of the project."""
    for posterior in posteriors.values():
        assert posterior.converged
        assert posterior.agrees
        assert posterior.ess_bulk.min() > 4000
        assert posterior.r_hat.max() < 1.01
    offset = posteriors["axis-offset"]
    assert offset.draws.shape[0] == ENSEMBLES
    assert offset.mean[offset.names.index("axis_z_mm")] == pytest.approx(-21.0, abs=1.5)
    # The prior of e is 10 mm; the rows say nearly nothing.
    assert np.sqrt(offset.covariance[3, 3]) == pytest.approx(10, abs=0.5)
    assert offset.identified_by[offset.names.index("eccentricity_mm")] == "prior"


def test_walkers_that_run_away_are_named(fits: dict[str, RobustFit]) -> None:
    """Rows that say nothing, as from images whose intrinsics are open, and no prior of L_b."""
    told = table_1()
    rows = replace(told, std=1e100 * told.std)
    with pytest.raises(EstimationError, match="run away without bound"):
        sample_posterior(rows, fits["base"], NO_PRIORS, seed=SeedSequence(1))


def test_same_seed_same_draws(fits: dict[str, RobustFit], posteriors: dict[str, Posterior]) -> None:
    """Determinism, and that another seed gives other draws of the same posterior."""
    again = sample_posterior(table_1(), fits["base"], NO_PRIORS, seed=SeedSequence(1))
    np.testing.assert_array_equal(again.draws, posteriors["base"].draws)
    other = sample_posterior(table_1(), fits["base"], NO_PRIORS, seed=SeedSequence(2))
    assert not np.array_equal(other.draws, again.draws)
    error = 5 * np.sqrt(np.diag(again.covariance) * (1 / again.ess_bulk + 1 / other.ess_bulk))
    np.testing.assert_array_less(np.abs(other.mean - again.mean), error)


def test_shared_errors_widen_the_draws(fits: dict[str, RobustFit]) -> None:
    """Property: draws contain the shared part with the loadings of the fit."""
    from dataclasses import replace

    rows = table_1()
    by_shared = np.zeros((6, 5, 1))
    by_shared[:, 4, 0] = 0.05 * rows.z_mm
    rows = replace(rows, shared=by_shared, shared_names=("scale",))
    fit = fit_robust(rows, MODELS["base"], NO_PRIORS)
    # 5 % more depth is 5 % more baseline, whatever the model.
    assert fit.by_shared[0, 0] == pytest.approx(0.05 * fit.values[0], rel=0.02)
    posterior = sample_posterior(rows, fit, NO_PRIORS, seed=SeedSequence(3))
    alone = sample_posterior(table_1(), fits["base"], NO_PRIORS, seed=SeedSequence(3))
    wanted = alone.covariance[0, 0] + fit.by_shared[0, 0] ** 2
    assert posterior.covariance[0, 0] == pytest.approx(wanted, rel=0.05)


def test_comparison_selects_the_axis_offset_on_table_1(
    fits: dict[str, RobustFit], posteriors: dict[str, Posterior]
) -> None:
    """Published data; and LOO against its definition, the posterior without each row."""
    rows = table_1()
    comparison = compare_models(rows, fits, posteriors, NO_PRIORS, None, seed=SeedSequence(4))
    assert comparison.selected == "axis-offset"
    assert comparison.scores[-1].weight > 0.9
    score = comparison.scores[0]
    model = MODELS["base"]
    for i in range(6):
        others = np.flatnonzero(np.arange(6) != i)
        target = log_posterior(rows, model, NO_PRIORS, fits["base"].theta)
        again = fit_robust(rows.take(others), model, NO_PRIORS)
        sample = sample_importance(
            target.only(others), *laplace(again, target), np.random.default_rng(i)
        )
        density = np.exp(target.only(np.array([i])).pointwise(sample.draws)[:, 0])
        exact = float(np.log(sample.weights @ density))
        assert score.pointwise[i] == pytest.approx(exact, abs=0.12)


def test_rule_prefers_the_simpler_model_unless_clearly_worse() -> None:
    """Property of the written rule, at its borders."""
    from dataclasses import replace

    from calib.fit.compare import ModelScore

    def score(model: str, pointwise: list[float]) -> ModelScore:
        values = np.array(pointwise)
        return ModelScore(
            model, float(values.sum()), 0.0, values, values, (), (), None, 0.0, None, None, 0.0, 0.0
        )

    base = score("base", [0.0] * 10)
    assert select([base, score("axis-offset", [0.19] * 10)])[0] == "base"
    assert select([base, score("axis-offset", [0.21] * 10)])[0] == "axis-offset"
    # 3 nats better, but from one row of ten: the standard error is 2.8.
    one_row = score("axis-offset", [0.0] * 9 + [3.0])
    assert select([base, one_row])[0] == "axis-offset"
    mixed = score("axis-offset", [2.0, -1.0] * 4 + [0.0, -1.0])
    assert select([base, mixed])[0] == "base"
    assert select([replace(base, model="axis-offset", loo=-5.0), base])[0] == "base"


def plain_emcee(
    target: LogPosterior, centre: np.ndarray, covariance: np.ndarray, *, steps: int
) -> np.ndarray:
    """Return emcee's own draws, shape (steps, walkers, d), by the moves it has when asked for none.

    They start at the fit, with no importance sample, and the first third is left out.
    """
    sampler = emcee.EnsembleSampler(64, target.dimensions, target, vectorize=True)
    rng = np.random.default_rng(7)
    sampler.random_state = np.random.RandomState(8).get_state()
    sampler.run_mcmc(rng.multivariate_normal(centre, covariance, 64), steps)
    draws: np.ndarray = sampler.get_chain(discard=steps // 3)
    return draws


def assert_same_posterior(rows: Observations, model: str, *, steps: int) -> None:
    """Independent tool: means, deviations and limits of plain emcee's long chains."""
    fit = fit_model(rows, NO_PRIORS, model=model)
    target = posterior_of(fit, rows, NO_PRIORS)
    plain = plain_emcee(target, *laplace(fit, target), steps=steps)
    other_draws = plain[0].size / target.dimensions * len(plain) / autocorrelation_times(plain)
    assert other_draws.min() > steps / 8
    found = sample_posterior(rows, fit, NO_PRIORS, seed=SeedSequence(2))
    assert found.converged
    flat, own = plain.reshape(-1, target.dimensions), found.flat
    std = flat.std(axis=0)
    draws = 1 / (1 / np.minimum(found.ess_bulk, found.ess_tail) + 1 / other_draws)
    np.testing.assert_array_less(np.abs(own.mean(0) - flat.mean(0)) / std, 4.5 / np.sqrt(draws))
    for level in (0.025, 0.1587, 0.8413, 0.975):
        share = (own < np.quantile(flat, level, axis=0)).mean(axis=0)
        error = np.sqrt(level * (1 - level) / draws)
        np.testing.assert_array_less(np.abs(share - level), 4.5 * error)


def test_plain_emcee_finds_the_same_on_table_1() -> None:
    assert_same_posterior(table_1(), "axis-offset", steps=6000)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("model", list(MODELS))
def test_plain_emcee_finds_the_same(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, _ = simulated(rng, count=(12, 10, 12, 25, 100)[seed], axis_z_mm=-20.0)
    assert_same_posterior(rows, model, steps=12_000)
