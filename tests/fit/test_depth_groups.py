"""Groups of rows with one reference depth, in the fit and in the comparison of models.

Evidence: an independent computation (the sandwich written out with a matrix of all rows; repeated
fits with drawn errors); properties (nothing where each row has its own; size and time).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated

from calib.fit.density import log_posterior
from calib.fit.groups import added_covariance, units, wider_part
from calib.fit.importance import sample_importance
from calib.fit.leave_one_out import leave_one_out, of_sample
from calib.fit.noise import own_sigma
from calib.fit.posterior import laplace, posterior_of
from calib.fit.robust import RobustFit, fit_model, fit_robust
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE
from calib.plan.prepare import _without_groups
from calib.rows.observations import GROUP_SOURCE, Observations, depth_groups
from tests.call_count import counted_calls

U_GROUP = 0.002


def grouped(rows: Observations, group: np.ndarray, *, u_group: float = U_GROUP) -> Observations:
    """Return rows that state a relative error of each group's depths beside their own."""
    number, u = depth_groups(group.tolist(), u_group * rows.z_mm)
    std = rows.std.copy()
    std[:, OBSERVABLE.z] = np.hypot(std[:, OBSERVABLE.z], u_group * rows.z_mm)
    return replace(rows, std=std, z_group=number, u_z_group_mm=u)


def off(rows: Observations, group: np.ndarray, rng: np.random.Generator) -> Observations:
    """Return rows whose groups have drawn errors."""
    error = U_GROUP * rng.standard_normal(group.max() + 1)
    return replace(rows, z_mm=rows.z_mm * (1 + error[group]))


def test_one_row_a_group_is_a_row_s_own_error() -> None:
    """Property: then the sharing is nothing, and results are the same to the last bit."""
    rows, _ = simulated(np.random.default_rng(1), count=14)
    alone = grouped(rows, np.arange(14))
    # What `observe` leaves out as nothing is shared, put in by force.
    forced = replace(alone, z_group=np.arange(14), u_z_group_mm=U_GROUP * rows.z_mm)
    for model in MODELS:
        own, shared = (fit_model(r, NO_PRIORS, model=model) for r in (alone, forced))
        np.testing.assert_array_equal(shared.values, own.values)
        np.testing.assert_array_equal(shared.covariance, own.covariance)
        assert shared.noise_scale == own.noise_scale
        assert shared.by_shared.shape == (len(own.names), 0)
        assert shared.group_freedom == 0.0
    np.testing.assert_array_equal(units(forced), np.arange(14))


def sandwich(rows: Observations, fit: RobustFit, group: np.ndarray) -> np.ndarray:
    """Return the covariance of the weighted estimate by a matrix of all rows, (p, p)."""
    c = misclosure(fit.theta, rows.gaze, rows.z_mm, parameters=MODELS[fit.model].indices)
    sigma = own_sigma(c, rows.std)
    common = c.by_observable[:, OBSERVABLE.z] * rows.u_z_group_mm
    together = np.where(group[:, None] == group, np.outer(common, common), 0.0)
    together[np.diag_indices(len(rows))] = sigma**2
    estimator = np.linalg.pinv(c.by_theta / sigma[:, None]) / sigma
    found: np.ndarray = estimator @ together @ estimator.T
    return found


def test_covariance_is_the_sandwich_where_it_is_wider() -> None:
    """`base`, where all rows of a pose pull alike. 60 rows leave the t loss 2 to 4 % of play."""
    group = np.repeat(np.arange(10), 6)
    rng = np.random.default_rng(5)
    rows, _ = simulated(rng, count=60)
    order = np.argsort(rows.z_mm)
    rows = grouped(off(rows.take(order), group, rng), group)
    fit = fit_model(rows, NO_PRIORS, model="base")
    own = fit.covariance - fit.by_shared @ fit.by_shared.T
    assert set(fit.shared_names) == {GROUP_SOURCE}
    assert 1 <= fit.by_groups.shape[1] <= 2
    expected = sandwich(rows, fit, group)
    alone = sandwich(rows, fit, np.arange(60))
    # Of either the part that the sharing adds, in units of the own covariance.
    added = fit.by_groups @ fit.by_groups.T / max(1.0, fit.noise_scale) ** 2
    found, right = (np.trace(np.linalg.solve(own, x)) for x in (added, expected - alone))
    assert right > 0.5
    assert found == pytest.approx(right, rel=0.1)


def test_directions_that_sharing_improves_are_left_as_they_are() -> None:
    """Property: rows that pull opposite ways cancel; the covariance is not narrowed."""
    by_row = np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 1.0], [1.0, -1.0]])
    added = added_covariance(by_row, np.array([7, 7, 3, 3]))
    np.testing.assert_allclose(added, [[4, 0], [0, -4]], atol=1e-14)
    factor = wider_part(added, np.eye(2), noise_scale=0.5)
    np.testing.assert_allclose(factor, [[2], [0]], atol=1e-14)
    wider = wider_part(added, np.eye(2), noise_scale=3.0)
    np.testing.assert_allclose(wider, [[6], [0]], atol=1e-14)


def test_noise_scale_of_grouped_rows_is_that_of_the_statements() -> None:
    """Simulated truth: parameters follow common errors, and the scale takes that into account.

    Its logarithm scatters by about 0.15, over 24 rigs 0.03 in the mean; taken as independent, the
    same rows give it 0.08 too small.
    """
    group = np.repeat(np.arange(5), 6)
    logs, blind = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        rows, _ = simulated(rng, count=30)
        rows = rows.take(np.argsort(rows.z_mm))
        rows = grouped(off(rows, group, rng), group)
        logs.append(np.log(fit_model(rows, NO_PRIORS, model="base").noise_scale))
        silent = replace(rows, z_group=np.zeros(0, np.int64), u_z_group_mm=np.zeros(0))
        blind.append(np.log(fit_model(silent, NO_PRIORS, model="base").noise_scale))
    assert abs(np.mean(logs)) < 0.1
    assert np.mean(blind) < np.mean(logs) - 0.03


def test_sampled_density_has_the_scale_of_the_fit() -> None:
    """Property: the mode of the density in the noise scale moves as the fit's does."""
    group = np.repeat(np.arange(5), 6)
    rng = np.random.default_rng(8)
    rows, _ = simulated(rng, count=30)
    rows = grouped(off(rows.take(np.argsort(rows.z_mm)), group, rng), group)
    fit = fit_model(rows, NO_PRIORS, model="base")
    assert fit.group_freedom > 1
    target = posterior_of(fit, rows, NO_PRIORS)
    plain = log_posterior(
        rows, MODELS["base"], NO_PRIORS, fit.theta, rejected=fit.rejected, tails=fit.tails
    )
    x = np.tile(np.append(fit.values, 0.0), (2, 1))
    x[1, -1] = 0.3
    slower = np.diff(target(x))[0] - np.diff(plain(x))[0]
    assert slower == pytest.approx(0.3 * fit.tails.efficiency * fit.group_freedom, rel=1e-9)


def test_outliers_set_aside_have_no_part_in_their_group() -> None:
    group = np.repeat(np.arange(8), 5)
    rng = np.random.default_rng(3)
    rows, _ = simulated(rng, count=40, outliers=2)
    rows = grouped(rows, group)
    fit = fit_model(rows, NO_PRIORS, model="base")
    assert fit.rejected.sum() == 2
    again = fit_robust(rows.take(~fit.rejected), MODELS["base"], NO_PRIORS, start=fit.theta)
    np.testing.assert_allclose(fit.by_groups, again.by_groups, rtol=1e-4)


def test_rows_of_a_group_are_left_out_together() -> None:
    """An independent computation: the exact fit of the others, by the same importance sampling."""
    group = np.repeat(np.arange(6), 4)
    rng = np.random.default_rng(11)
    rows, _ = simulated(rng, count=24)
    rows = grouped(off(rows, group, rng), group)
    fit = fit_model(rows, NO_PRIORS, model="base")
    target = posterior_of(fit, rows, NO_PRIORS)
    sample = sample_importance(target, *laplace(fit, target), np.random.default_rng(0))
    (found,) = leave_one_out(
        rows, {"base": fit}, {"base": of_sample(sample)}, NO_PRIORS, np.random.SeedSequence(0)
    ).values()
    np.testing.assert_array_equal(units(rows), group)
    for k in (0, 3, 5):
        out = group == k
        others = target.only(np.flatnonzero(~out))
        again = fit_robust(rows.take(~out), MODELS["base"], NO_PRIORS)
        exact = sample_importance(others, *laplace(again, others), np.random.default_rng(1))
        density = target.only(np.flatnonzero(out)).pointwise(exact.draws)
        expected = np.log(exact.weights @ np.exp(density - density.max(axis=0)))
        np.testing.assert_allclose(found.pointwise[out], expected + density.max(axis=0), atol=0.1)
        assert len({*found.pareto_k[out].tolist()}) == 1


def test_plan_starts_from_what_groups_leave() -> None:
    """Property: the information is the inverse of the covariance with what groups add."""
    rng = np.random.default_rng(0)
    root, added = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    information = root @ root.T + np.eye(4)
    left = _without_groups(information, added)
    expected = np.linalg.inv(np.linalg.inv(information) + added @ added.T)
    np.testing.assert_allclose(left, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(_without_groups(information, np.zeros((4, 0))), information)


def test_nothing_is_done_group_by_group() -> None:
    """Property: 9,000 rows in ten times as many groups are fitted by as many calls."""
    rows, _ = simulated(np.random.default_rng(2), count=9000)
    calls = []
    for groups in (300, 3000):
        one = grouped(rows, np.arange(9000) % groups)
        with counted_calls() as count:
            fit = fit_model(one, NO_PRIORS, model="axis-offset")
        calls.append(count())
        assert 1 <= fit.by_shared.shape[1] <= 4
    assert calls[1] < 1.5 * calls[0], "the rounds of a fit differ a little"


def test_units_larger_than_what_is_held_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Property: block by block the left-out densities are the same."""
    group = np.repeat(np.arange(4), [30, 2, 1, 7])
    rng = np.random.default_rng(6)
    rows, _ = simulated(rng, count=40)
    rows = grouped(off(rows, group, rng), group).take(rng.permutation(40))
    fit = fit_model(rows, NO_PRIORS, model="base")
    target = posterior_of(fit, rows, NO_PRIORS)
    sample = sample_importance(target, *laplace(fit, target), np.random.default_rng(0))
    found = []
    for elements in (4_000_000, 8 * len(sample.draws)):
        monkeypatch.setattr("calib.fit.leave_one_out.CHUNK_ELEMENTS", elements)
        (left_out,) = leave_one_out(
            rows, {"base": fit}, {"base": of_sample(sample)}, NO_PRIORS, np.random.SeedSequence(0)
        ).values()
        found.append(left_out)
    np.testing.assert_allclose(found[1].pointwise, found[0].pointwise, rtol=1e-9)
    np.testing.assert_allclose(found[1].pareto_k, found[0].pareto_k, rtol=1e-6)
