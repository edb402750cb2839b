"""Evidence: closed forms, central differences, simulated truth (coverage)."""

from __future__ import annotations

import math
from dataclasses import replace

import known_case
import numpy as np
import pytest

from calib.geometry.parameters import embed, vector
from calib.geometry.plane import Gaze
from calib.uncertainty import montecarlo
from calib.uncertainty.depth import (
    depth_budget,
    depth_uncertainty,
    least_certain,
    position_uncertainty,
    reading_at,
)
from calib.uncertainty.distributions import draw
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    SharedErrors,
    Spread,
)
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.position import (
    depth_error_terms,
    lateral_error,
    position_jacobian,
    positions,
)

CHI_95_3 = 2.7954834829151074  # sqrt of the 95 % quantile of chi² with three degrees of freedom
GENERAL = vector(
    {
        "baseline_mm": 77.0,
        "delta2_rad": 0.013,
        "axis_z_mm": -21.0,
        "eccentricity_mm": 2.0,
        "axis_tilt_x_rad": 0.02,
        "axis_tilt_z_rad": -0.015,
        "gaze_roll_rad": 0.01,
        "encoder_scale": 0.01,
    }
)


def test_position_jacobian_agrees_with_central_differences() -> None:
    values = np.array([[0.1, -0.2, 1.45, 0.01], [-0.15, 0.1, 1.2, 0.0]])
    j = position_jacobian(GENERAL, Gaze(*values.T))
    np.testing.assert_allclose(j.position, positions(GENERAL, Gaze(*values.T)), rtol=1e-14)
    for q in range(4):
        h = 1e-6
        step = np.zeros(4)
        step[q] = h
        up = positions(GENERAL, Gaze(*(values + step).T))
        down = positions(GENERAL, Gaze(*(values - step).T))
        scale = np.abs(j.by_reading).max()
        np.testing.assert_allclose(j.by_reading[:, :, q], (up - down) / (2 * h), atol=1e-7 * scale)
    for i in range(len(GENERAL)):
        h = 1e-6 * max(abs(GENERAL[i]), 1.0)
        theta = np.zeros_like(GENERAL)
        theta[i] = h
        up = positions(GENERAL + theta, Gaze(*values.T))
        down = positions(GENERAL - theta, Gaze(*values.T))
        scale = np.abs(j.by_theta[:, :, i]).max()
        np.testing.assert_allclose(j.by_theta[:, :, i], (up - down) / (2 * h), atol=1e-6 * scale)


@pytest.mark.parametrize(
    ("z", "alpha_deg", "d_baseline", "terms", "dz", "dx", "dy", "percent"),
    # Xu and Wang, error analysis. First example with its errata: 20 + 5 + 5.06 = 30.06 (printed
    # 30.6), dx 10.02, dy 7.01, dx/z 1.00 %, dy/z 0.70 %. The second is right as printed.
    [
        (1000, 80, 4, (20, 5, 5.06), 30.06, 10.02, 7.01, (3.01, 1.00, 0.70)),
        (2000, 85, 6, (60, 20, 19.79), 99.8, 31.9, 22.0, (4.99, 1.60, 1.10)),
    ],
)
def test_worked_error_examples_of_xu_and_wang(
    z: float,
    alpha_deg: float,
    d_baseline: float,
    terms: tuple[float, ...],
    dz: float,
    dx: float,
    dy: float,
    percent: tuple[float, ...],
) -> None:
    alpha = math.radians(alpha_deg)
    x_gaze = 200 / z - 1 / math.tan(alpha)
    one = np.ones(1)
    gaze = Gaze(x_gaze * one, 0 * one, alpha * one, 0 * one)
    found = depth_error_terms(
        vector({"baseline_mm": 200}),
        gaze,
        by_theta=vector({"baseline_mm": d_baseline}),
        by_reading=np.array([1e-3, 0, math.radians(0.05625), 0]),
    )[0]
    size = found[found > 0]
    np.testing.assert_allclose(size, terms, atol=0.006)
    total = found.sum(keepdims=True)
    assert total[0] == pytest.approx(dz, abs=0.05)
    common = {"z": z * one, "coordinate_error": 1e-3, "z_error": total}
    x = lateral_error(coordinate=0.3 * one, **common)[0]
    y = lateral_error(coordinate=0.2 * one, **common)[0]
    assert x == pytest.approx(dx, abs=0.06)
    assert y == pytest.approx(dy, abs=0.06)
    np.testing.assert_allclose([100 * total[0] / z, 100 * x / z, 100 * y / z], percent, atol=0.0051)


def test_monte_carlo_agrees_with_the_budget_where_the_model_is_nearly_linear() -> None:
    instrument = known_case.instrument()
    reading = reading_at(instrument.theta, z_mm=300, x1c=0.1)
    result, _ = depth_uncertainty(instrument, reading, np.random.default_rng(1))
    mc = result.monte_carlo
    assert result.z_mm == pytest.approx(300, rel=1e-12)
    assert mc.standard_uncertainty == pytest.approx(
        result.budget.standard_uncertainty, abs=2 * mc.numerical_uncertainty
    )
    assert result.linear_valid
    assert result.interval == result.validation.linear


def test_depth_without_degrees_of_freedom_states_the_monte_carlo_interval() -> None:
    rng = np.random.default_rng(2)
    p = known_case.knowledge(degrees_of_freedom=None)
    draws = rng.multivariate_normal(p.values, p.covariance, 40_000)
    instrument = known_case.instrument(known_case.knowledge(degrees_of_freedom=None, draws=draws))
    reading = reading_at(instrument.theta, z_mm=300, x1c=0.1)
    result, _ = depth_uncertainty(instrument, reading, rng)
    assert result.budget.coverage_factor is None
    assert not result.linear_valid
    assert result.interval == result.monte_carlo.shortest
    half = (result.interval.high - result.interval.low) / 2
    assert half == pytest.approx(1.96 * result.budget.standard_uncertainty, rel=0.03)


def test_few_degrees_of_freedom_widen_the_interval() -> None:
    wide, narrow = (
        depth_uncertainty(
            known_case.instrument(known_case.knowledge(degrees_of_freedom=dof)),
            known_case.READING,
            np.random.default_rng(3),
        )[0]
        for dof in (2.0, math.inf)
    )
    assert wide.monte_carlo.standard_uncertainty is None
    assert wide.interval.high - wide.interval.low > 1.2 * (
        narrow.interval.high - narrow.interval.low
    )


def test_the_least_certain_ray_is_the_most_oblique() -> None:
    instrument = known_case.instrument()
    rays = [reading_at(instrument.theta, z_mm=800, x1c=x) for x in (-0.3, 0.0, 0.1)]
    assert least_certain(instrument, rays) is rays[0]


def test_position_ellipsoid_of_a_nearly_linear_case() -> None:
    """JCGM 102, 6.5.2: a normal distribution has k_p² = chi²; r and u from the jacobian."""
    spread = ReadingSpread(
        x1c=Spread(normal=1e-4), y1c=Spread(normal=1e-4), alpha2_rad=Spread(normal=1e-4)
    )
    instrument = Instrument(known_case.knowledge(), spread)
    reading = reading_at(instrument.theta, z_mm=400, x1c=0.2, y1c=-0.1)
    result = position_uncertainty(instrument, reading, np.random.default_rng(4))
    np.testing.assert_allclose(result.position_mm, [80, -40, 400], rtol=1e-12)
    # sd of the 95 % quantile of a chi variate from 2e5 trials is 0.0035.
    assert result.coverage_factor == pytest.approx(CHI_95_3, abs=0.012)
    u = result.standard_uncertainty_mm
    assert u[2] == pytest.approx(depth_budget(instrument, reading).standard_uncertainty)
    rebuilt = (
        result.directions
        @ np.diag((result.semi_axes_mm / result.coverage_factor) ** 2)
        @ result.directions.T
    )
    np.testing.assert_allclose(rebuilt, result.covariance_mm2, atol=1e-9 * u[2] ** 2)
    np.testing.assert_allclose(np.diag(result.correlation), 1)


def test_position_ellipsoid_holds_95_percent_of_fresh_draws_where_linear_is_wrong() -> None:
    instrument = Instrument(
        known_case.knowledge(degrees_of_freedom=5.0),
        ReadingSpread(x1c=Spread(width=known_case.PIXEL), y1c=Spread(width=known_case.PIXEL)),
    )
    result = position_uncertainty(instrument, known_case.READING, np.random.default_rng(5))
    model = MeasurementModel(instrument, [known_case.READING])
    rng = np.random.default_rng(6)
    fresh = np.hstack([draw(block, rng, 100_000) for block in model.blocks])
    away = (model.positions(fresh)[:, 0] - result.position_mm) @ result.directions
    inside = np.mean(((away / result.semi_axes_mm) ** 2).sum(axis=1) <= 1)
    # Both samples scatter: sqrt(0.95 · 0.05 (1 / 2e5 + 1 / 1e5)) = 0.0008.
    assert inside == pytest.approx(0.95, abs=0.0026)


def test_shared_errors_enter_budget_and_monte_carlo_with_their_correlation() -> None:
    """Parameters that have absorbed an error of the intrinsics take part of it away again."""
    loading = np.array([[4e-4], [0.0], [0.0], [0.0]])
    reading = Reading(-0.0158, 0.0, known_case.READING.alpha2_rad, shared=loading)
    p = known_case.knowledge()
    with_parameters = np.array([[-0.5 * known_case.U_BASELINE], [0.6 * known_case.U_DELTA2]])
    tied = SharedErrors(("focal length",), with_parameters)
    results = {}
    for name, shared in (
        ("free", SharedErrors(("focal length",), np.zeros((2, 1)))),
        ("tied", tied),
    ):
        instrument = Instrument(p, ReadingSpread(), shared)
        results[name], _ = depth_uncertainty(instrument, reading, np.random.default_rng(7))
    z, baseline = results["free"].z_mm, 77.09
    plain = depth_budget(Instrument(p, ReadingSpread()), reading).standard_uncertainty
    by_focal = z * z / (baseline * 1.0) * 4e-4
    free, both = (results[k].budget.standard_uncertainty for k in ("free", "tied"))
    assert free == pytest.approx(math.hypot(plain, by_focal), rel=2e-3)
    assert both < free
    for result in results.values():
        mc = result.monte_carlo
        # Second-order terms are (u/z)² ~ 4e-4 of u.
        assert mc.standard_uncertainty == pytest.approx(
            result.budget.standard_uncertainty, rel=2e-3, abs=2 * mc.numerical_uncertainty
        )


def test_shared_errors_without_loadings_are_refused() -> None:
    shared = SharedErrors(("focal length",), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="loadings"):
        MeasurementModel(
            Instrument(known_case.knowledge(), ReadingSpread(), shared), [known_case.READING]
        )


def test_a_contradiction_between_covariance_and_shared_errors_widens() -> None:
    # Baseline and delta2 at -0.9, an error tied to the first alone by 0.8: impossible.
    p = known_case.knowledge()
    by_shared = np.array([[0.8 * known_case.U_BASELINE], [0.0]])
    instrument = Instrument(p, ReadingSpread(), SharedErrors(("focal length",), by_shared))
    u = np.sqrt(np.diag(p.covariance))
    own = instrument.own_covariance / np.outer(u, u)
    assert np.linalg.eigvalsh(own)[0] == pytest.approx(0, abs=1e-12)
    # Whatever is measured, the parts give no less than covariance and link as they were stated.
    more = own + (by_shared @ by_shared.T - p.covariance) / np.outer(u, u)
    assert np.linalg.eigvalsh(more)[0] > -1e-12
    assert np.trace(more) > 0.1


def test_parts_that_fit_are_taken_as_they_are() -> None:
    p = known_case.knowledge()
    by_shared = np.array([[0.5 * known_case.U_BASELINE], [-0.5 * known_case.U_DELTA2]])
    instrument = Instrument(p, ReadingSpread(), SharedErrors(("focal length",), by_shared))
    whole = instrument.own_covariance + by_shared @ by_shared.T
    np.testing.assert_allclose(whole, p.covariance, rtol=1e-14)


def test_draws_with_shared_errors_need_their_own_part() -> None:
    p = known_case.knowledge()
    p = replace(p, draws=np.tile(p.values, (100, 1)))
    shared = SharedErrors(("focal length",), np.array([[0.1], [0.0]]))
    with pytest.raises(ValueError, match="own part"):
        Instrument(p, ReadingSpread(), shared)
    assert Instrument(p, ReadingSpread(), replace(shared, own_draws=p.draws)).own_draws is p.draws


def test_a_borrowed_depth_carries_the_errors_of_the_row_it_comes_from() -> None:
    """x = x1c z with another row's z: jacobian against differences, and both rows' errors."""
    spread = ReadingSpread(
        x1c=Spread(normal=2e-4), y1c=Spread(normal=3e-4), alpha2_rad=Spread(normal=1e-4)
    )
    instrument = Instrument(known_case.knowledge(), spread)
    centre = reading_at(instrument.theta, z_mm=900, x1c=0.05)
    corners = [Reading(x, y, 1.0, depth_from=centre) for x, y in ((-0.1, 0.02), (0.2, -0.03))]
    model = MeasurementModel(instrument, corners)
    np.testing.assert_allclose(model.estimate, [[-90, 18, 900], [180, -27, 900]], rtol=1e-12)
    jacobian = model.jacobian
    count = jacobian.shape[2]
    for i in range(count):
        h = 1e-6 if i else 1e-3
        draws = np.zeros((2, count))
        draws[:, :2] = instrument.parameters.values
        draws[:, i] += np.array([h, -h])
        up, down = model.positions(draws)
        np.testing.assert_allclose((up - down) / (2 * h), jacobian[:, :, i], rtol=1e-5, atol=1e-6)
    # The readings of the corners' own angle have no influence; one centre serves both.
    z = jacobian[:, 2]
    np.testing.assert_array_equal(z[0], z[1])
    assert np.count_nonzero(z[0]) == 2 + 2


def _coverage(*, z_mm: float, repeats: int, dof: float | None, seed: int) -> tuple[float, float]:
    """Return the shares of linear and stated intervals that hold the true depth.

    Each repeat calibrates anew (estimates about the truth, covariance from `dof` residuals if
    finite) and reads the point anew, rounded to pixel and step.
    """
    rng = np.random.default_rng(seed)
    true = known_case.knowledge()
    point = reading_at(embed(true.values, true.names), z_mm=z_mm, x1c=0.05)
    linear = stated = 0
    for _ in range(repeats):
        scale = 1.0 if dof is None else rng.chisquare(dof) / dof
        p = ParameterKnowledge(
            names=true.names,
            values=rng.multivariate_normal(true.values, true.covariance),
            covariance=scale * true.covariance,
            degrees_of_freedom=math.inf if dof is None else dof,
            evaluation=true.evaluation,
        )
        reading = Reading(
            point.x1c + known_case.PIXEL * rng.uniform(-0.5, 0.5),
            0.0,
            point.alpha2_rad + known_case.STEP * rng.uniform(-0.5, 0.5),
        )
        result, _ = depth_uncertainty(known_case.instrument(p), reading, rng, digits=1)
        linear += result.validation.linear.low <= z_mm <= result.validation.linear.high
        stated += result.interval.low <= z_mm <= result.interval.high
    return linear / repeats, stated / repeats


@pytest.mark.parametrize("dof", [None, 4.0])
def test_stated_intervals_cover_the_truth(
    dof: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Ends known to a few per cent of u are enough for a share of 250.
    monkeypatch.setattr(montecarlo, "MINIMUM_BLOCKS", 2)
    repeats = 250
    _, stated = _coverage(z_mm=1000, repeats=repeats, dof=dof, seed=20)
    # Three standard deviations of a share of 250; below it the interval would be too narrow.
    assert stated >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / repeats)


@pytest.mark.slow
@pytest.mark.parametrize("z_mm", [500, 1000, 2000])
@pytest.mark.parametrize("dof", [None, 3.0, 10.0])
def test_coverage_study(z_mm: float, dof: float | None) -> None:
    repeats = 600
    linear, stated = _coverage(z_mm=z_mm, repeats=repeats, dof=dof, seed=21)
    deviation = 3 * math.sqrt(0.95 * 0.05 / repeats)
    assert stated >= 0.95 - deviation
    assert linear >= 0.95 - deviation


def test_inputs_without_influence_get_no_row() -> None:
    spread = ReadingSpread(x1c=Spread(normal=1e-4), y1c=Spread(normal=1e-4))
    table = depth_budget(Instrument(known_case.knowledge(), spread), known_case.READING)
    assert [row.input.name for row in table.rows] == ["baseline_mm", "delta2_rad", "x1c"]


def test_points_at_infinity_lie_outside_the_ellipsoid() -> None:
    """A depth so loose that some trials never meet: the ellipsoid grows, and stays finite."""
    p = known_case.knowledge()
    loose = ParameterKnowledge(p.names, p.values, 900 * p.covariance, math.inf, p.evaluation)
    instrument = Instrument(loose, ReadingSpread(x1c=Spread(normal=1e-3)))
    reading = reading_at(instrument.theta, z_mm=2000, x1c=0.05)
    model = MeasurementModel(instrument, [reading])
    rng = np.random.default_rng(1)
    drawn = np.hstack([draw(block, rng, 20_000) for block in model.blocks])
    missed = np.mean(~np.isfinite(model.positions(drawn)).all(axis=(1, 2)))
    assert 0 < missed < 0.05
    result = position_uncertainty(instrument, reading, np.random.default_rng(2))
    assert CHI_95_3 < result.coverage_factor < math.inf
