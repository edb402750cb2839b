"""Evidence: published (GUM H.1, H.2) and an independent tool (GTC)."""

from __future__ import annotations

import math
from dataclasses import replace

import GTC
import known_case
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import GAZED_BASELINE, INDEX, NAMES
from calib.geometry.plane import Gaze
from calib.uncertainty.budget import Budget, InputQuantity, budget, coverage_factor
from calib.uncertainty.depth import depth_budget, reading_at
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    ReadingSpread,
    SharedErrors,
    Spread,
)

# GUM H.2, table H.2: V / V, I / mA, phi / rad, five simultaneous observations each.
H2 = np.array(
    [
        [5.007, 19.663e-3, 1.0456],
        [4.994, 19.639e-3, 1.0438],
        [5.005, 19.640e-3, 1.0468],
        [4.990, 19.685e-3, 1.0428],
        [4.999, 19.678e-3, 1.0433],
    ]
)


def _quantity(name: str, u: float, c: float, dof: float | None, with_: str | None = None):
    return InputQuantity(name, 1.0, "1", u, "A", "normal", dof, c, with_)


def _shares(table: Budget) -> float:
    return sum(r.share_percent for r in table.rows) + sum(
        r.share_percent for r in table.correlations
    )


def _h2(function: str) -> Budget:
    mean = H2.mean(axis=0)
    covariance = np.cov(H2.T) / len(H2)
    v, i, phi = mean
    value, slopes = {
        "R": (
            v / i * np.cos(phi),
            [np.cos(phi) / i, -v / i**2 * np.cos(phi), -v / i * np.sin(phi)],
        ),
        "X": (v / i * np.sin(phi), [np.sin(phi) / i, -v / i**2 * np.sin(phi), v / i * np.cos(phi)]),
        "Z": (v / i, [1 / i, -v / i**2, 0.0]),
    }[function]
    u = np.sqrt(np.diag(covariance))
    return budget(
        quantity=function,
        estimate=float(value),
        unit="ohm",
        inputs=[
            _quantity(n, float(u[k]), float(slopes[k]), 4, "observations")
            for k, n in enumerate("VIφ")
        ],
        correlation=covariance / np.outer(u, u),
    )


@pytest.mark.parametrize(
    ("function", "value", "u"),
    [("R", 127.732, 0.071), ("X", 219.847, 0.295), ("Z", 254.260, 0.236)],
)
def test_gum_h2_published_values(function: str, value: float, u: float) -> None:
    table = _h2(function)
    # Table H.4 prints three decimals; the GUM rounded its inputs before, which the last may show.
    assert table.estimate == pytest.approx(value, abs=1e-3)
    assert table.standard_uncertainty == pytest.approx(u, abs=1e-3)
    assert table.degrees_of_freedom == pytest.approx(4)


@pytest.mark.parametrize("function", ["R", "X", "Z"])
def test_gum_h2_against_gtc(function: str) -> None:
    v, i, phi = GTC.type_a.multi_estimate_real(H2.T.tolist())
    gtc = {"R": v / i * GTC.cos(phi), "X": v / i * GTC.sin(phi), "Z": v / i}[function]
    table = _h2(function)
    assert table.estimate == pytest.approx(GTC.value(gtc), rel=1e-12)
    assert table.standard_uncertainty == pytest.approx(GTC.uncertainty(gtc), rel=1e-6)
    assert table.degrees_of_freedom == pytest.approx(GTC.dof(gtc), rel=1e-6)
    for row, x in zip(table.rows, (v, i, phi), strict=True):
        expected = abs(GTC.component(gtc, x))
        assert row.contribution == pytest.approx(expected, rel=1e-6, abs=1e-15)
    assert _shares(table) == pytest.approx(100, abs=1e-9)


def test_gum_h1_effective_degrees_of_freedom() -> None:
    """End-gauge calibration, H.1.6: u_c = 32 nm with contributions 25 (18), 9.7 (25.6), ... nm."""
    # H.1: u(l_s) = 25 nm, nu 18; u(d) = 9.7 nm, nu 25.6; l_s theta_s u(d alpha) = 2.9 nm, nu 50;
    # l_s alpha_s u(d theta) = 16.6 nm, nu 2. Printed: u_c = 32 nm, nu_eff = 16.7, t_99(16) = 2.92.
    inputs = [
        _quantity("l_s", 25.0, 1.0, 18.0),
        _quantity("d", 9.7, 1.0, 25.6),
        _quantity("δα", 2.9, 1.0, 50.0),
        _quantity("δθ", 16.6, 1.0, 2.0),
    ]
    table = budget(quantity="l", estimate=0.0, unit="nm", inputs=inputs, correlation=np.eye(4))
    assert table.standard_uncertainty == pytest.approx(32, abs=0.5)
    assert table.degrees_of_freedom == pytest.approx(16.7, abs=0.1)
    assert table.coverage_factor == pytest.approx(2.120, abs=5e-4)  # GUM table G.2, 95 %, nu 16


def test_known_case_has_the_figures_worked_out_by_hand() -> None:
    table = depth_budget(known_case.instrument(), known_case.READING)
    assert table.estimate == pytest.approx(2283.62, abs=0.005)
    assert table.standard_uncertainty == pytest.approx(54.566, abs=0.0005)
    shares = {row.input.name: row.share_percent for row in table.rows}
    assert shares["x1c, resolution"] == pytest.approx(72.02, abs=0.005)
    assert shares["alpha2, resolution"] == pytest.approx(12.36, abs=0.005)
    # The parameters as such have shares of 7.37 and 38.61, their correlation of -0.9 one of -30.36.
    # Of delta2 0.19 of the variance remains once the baseline is known; the rest is the baseline's.
    assert shares["delta2_rad"] == pytest.approx(0.19 * 38.61, abs=0.005)
    assert shares["baseline_mm"] == pytest.approx(7.37 + 0.81 * 38.61 - 30.36, abs=0.01)
    assert table.correlations == ()
    assert _shares(table) == pytest.approx(100, abs=1e-9)


def _independent(values: np.ndarray, covariance: np.ndarray, dof: float):
    """Return independent GTC quantities, and those of `covariance` that they make up.

    By Cholesky's factor: each is what remains of one once those before it are known.
    """
    factor = np.linalg.cholesky(covariance)
    std = np.diag(factor)
    quantities = GTC.multiple_ureal([0.0] * len(values), std.tolist(), dof)
    rows = factor / std
    return quantities, [
        float(value) + sum(float(a) * q for a, q in zip(row, quantities, strict=True))
        for value, row in zip(values, rows, strict=True)
    ]


@pytest.mark.parametrize("dof", [4.0, 57.0, math.inf])
def test_known_case_against_gtc(dof: float) -> None:
    known = known_case.knowledge()
    quantities, (baseline, delta2) = _independent(known.values, known.covariance, dof)
    x1c = GTC.ureal(-0.0158, GTC.type_b.uniform(known_case.PIXEL / 2))
    alpha2 = GTC.ureal(known_case.READING.alpha2_rad, GTC.type_b.uniform(known_case.STEP / 2))
    z = baseline / (x1c + 1 / GTC.tan(alpha2 + delta2))
    table = depth_budget(
        known_case.instrument(known_case.knowledge(degrees_of_freedom=dof)), known_case.READING
    )
    assert table.estimate == pytest.approx(GTC.value(z), rel=1e-12)
    assert table.standard_uncertainty == pytest.approx(GTC.uncertainty(z), rel=1e-6)
    assert table.degrees_of_freedom == pytest.approx(GTC.dof(z), rel=1e-6)
    for row, x in zip(table.rows, (*quantities, x1c, alpha2), strict=True):
        assert row.contribution == pytest.approx(abs(GTC.component(z, x)), rel=1e-6)
        assert row.input.sensitivity == pytest.approx(GTC.reporting.sensitivity(z, x), rel=1e-6)


def test_axis_offset_model_against_gtc() -> None:
    values = np.array([76.9, 0.0131, -21.0, 3.0])
    root = np.array(
        [[0.4, 0, 0, 0], [-2e-4, 3e-4, 0, 0], [0.3, 0.1, 0.9, 0], [-0.39, 0, 0.1, 0.05]]
    )
    covariance = root @ root.T
    names = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")
    knowledge = ParameterKnowledge(names, values, covariance, 11.0, ("A",) * 4)
    spread = ReadingSpread(x1c=Spread(normal=2e-4), alpha2_rad=Spread(normal=1e-4, width=1e-3))
    mean = 1.3
    instrument = Instrument(knowledge, spread, mean_gaze_rad=mean)
    reading = reading_at(instrument.theta, z_mm=900.0, x1c=0.12)
    combine = np.eye(4)
    combine[0, 3] = 1 / math.sin(mean)
    quantities, combined = _independent(combine @ values, combine @ covariance @ combine.T, 11)
    effective, delta2, axis_z, eccentricity = combined
    baseline = effective - eccentricity / math.sin(mean)
    x = GTC.ureal(0.12, 2e-4)
    a = GTC.ureal(reading.alpha2_rad, 1e-4) + GTC.ureal(0, GTC.type_b.uniform(0.5e-3)) + delta2
    z = (baseline + axis_z / GTC.tan(a) + eccentricity / GTC.sin(a)) / (x + 1 / GTC.tan(a))
    table = depth_budget(instrument, reading)
    assert table.estimate == pytest.approx(900, rel=1e-12)
    assert table.standard_uncertainty == pytest.approx(GTC.uncertainty(z), rel=1e-6)
    assert table.degrees_of_freedom == pytest.approx(GTC.dof(z), rel=1e-6)
    assert [row.input.name for row in table.rows[:4]] == ["baseline_at_mean_gaze_mm", *names[1:]]
    for row, q in zip(table.rows[:4], quantities, strict=True):
        assert row.input.sensitivity == pytest.approx(GTC.reporting.sensitivity(z, q), rel=1e-6)
        share = 100 * (GTC.component(z, q) / GTC.uncertainty(z)) ** 2
        assert row.share_percent == pytest.approx(share, rel=1e-6)
    assert table.rows[0].input.estimate == pytest.approx(GTC.value(effective), rel=1e-12)
    assert table.rows[0].input.standard_uncertainty == pytest.approx(
        GTC.uncertainty(effective), rel=1e-6
    )
    assert table.correlations == ()
    assert _shares(table) == pytest.approx(100, abs=1e-9)


def test_shared_errors_of_one_source_are_one_line_of_the_budget() -> None:
    """Against GTC: effects by both ways add with their signs, errors of a source in quadrature."""
    rng = np.random.default_rng(11)
    names = ("lens", "lens", "pose", "lens")
    loading = rng.normal(0, 2e-4, (4, 4)) * [1, 1, 0, 1]
    p = known_case.knowledge()
    scale = np.array([known_case.U_BASELINE, known_case.U_DELTA2])
    by_shared = scale[:, None] * rng.uniform(-0.1, 0.1, (2, 4))
    reading = replace(known_case.READING, shared=loading)
    shared = SharedErrors(names, by_shared)
    instrument = Instrument(p, ReadingSpread(x1c=Spread(normal=1e-4)), shared)
    table = depth_budget(instrument, reading)
    own = instrument.own_covariance
    u = np.sqrt(np.diag(own))
    parameters = GTC.multiple_ureal(p.values.tolist(), u.tolist(), math.inf)
    GTC.set_correlation(float(own[0, 1] / u[0] / u[1]), *parameters)
    common = [GTC.ureal(0, 1) for _ in names]
    x_own = GTC.ureal(reading.x1c, 1e-4)

    def moved(value, loads):
        return value + sum(float(a) * c for a, c in zip(loads, common, strict=True))

    baseline, delta2 = (moved(q, by_shared[i]) for i, q in enumerate(parameters))
    angle = moved(reading.alpha2_rad + delta2, loading[2] + loading[3])
    z = baseline / (moved(x_own, loading[0]) + 1 / GTC.tan(angle))
    assert table.standard_uncertainty == pytest.approx(GTC.uncertainty(z), rel=1e-6)
    rows = {row.input.name: row for row in table.rows}
    assert list(rows) == ["baseline_mm", "delta2_rad", "lens", "pose", "x1c"]
    for source in ("lens", "pose"):
        parts = [GTC.component(z, c) for n, c in zip(names, common, strict=True) if n == source]
        assert rows[source].contribution == pytest.approx(math.hypot(*parts), rel=1e-6)
        assert (rows[source].input.estimate, rows[source].input.unit) == (0.0, "mm")
    assert table.correlations == ()
    assert _shares(table) == pytest.approx(100, abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.6, 2.5), st.floats(300, 3000))
def test_shares_lie_between_0_and_100_percent_however_strongly_parameters_correlate(
    seed: int, mean: float, z_mm: float
) -> None:
    rng = np.random.default_rng(seed)
    names = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm", "encoder_scale")
    root = np.linalg.qr(rng.normal(size=(5, 5)))[0] * 10.0 ** rng.uniform(-4, 0, 5)
    scale = np.array([10, 1e-2, 10, 10, 1e-2])
    covariance = scale[:, None] * (root @ root.T) * scale
    values = np.array([80.0, 0.01, -20.0, 3.0, 0.0])
    instrument = Instrument(
        ParameterKnowledge(names, values, covariance, None, ("A",) * 5),
        ReadingSpread(x1c=Spread(normal=1e-4)),
        mean_gaze_rad=mean,
    )
    table = depth_budget(instrument, reading_at(instrument.theta, z_mm=z_mm, x1c=0.1))
    shares = [row.share_percent for row in table.rows]
    assert table.correlations == ()
    assert all(0 <= share <= 100 + 1e-9 for share in shares)
    assert sum(shares) == pytest.approx(100, abs=1e-6)
    parameters = sum(
        s for s, row in zip(shares, table.rows, strict=True) if row.input.name in PARTS
    )
    gaze = Gaze(*np.array([[0.1], [0.0], [_reading(instrument, z_mm)], [0.0]]))
    slope = depth_jacobian(instrument.theta, gaze).by_theta[0, [INDEX[name] for name in names]]
    expected = slope @ covariance @ slope / table.standard_uncertainty**2
    assert parameters == pytest.approx(100 * expected, rel=1e-6)


PARTS = (*NAMES, GAZED_BASELINE)


def _reading(instrument: Instrument, z_mm: float) -> float:
    return reading_at(instrument.theta, z_mm=z_mm, x1c=0.1).alpha2_rad


def test_no_coverage_factor_where_degrees_of_freedom_are_unknown() -> None:
    instrument = known_case.instrument(known_case.knowledge(degrees_of_freedom=None))
    table = depth_budget(instrument, known_case.READING)
    assert table.degrees_of_freedom is None
    assert table.coverage_factor is None
    assert table.expanded_uncertainty is None
    assert "not defined" in table.freedom_note


def test_no_coverage_factor_where_separate_inputs_are_correlated() -> None:
    correlation = np.array([[1, 0.5], [0.5, 1]])
    inputs = [_quantity("a", 1.0, 1.0, 5.0), _quantity("b", 1.0, 1.0, 8.0)]
    table = budget(quantity="y", estimate=0, unit="1", inputs=inputs, correlation=correlation)
    assert table.standard_uncertainty == pytest.approx(math.sqrt(3))
    assert table.degrees_of_freedom is None
    assert table.coverage_factor is None


def test_no_coverage_factor_where_one_estimate_mixes_degrees_of_freedom() -> None:
    inputs = [_quantity("a", 1.0, 1.0, 5.0, "fit"), _quantity("b", 1.0, 1.0, math.inf, "fit")]
    table = budget(quantity="y", estimate=0, unit="1", inputs=inputs, correlation=np.eye(2))
    assert table.degrees_of_freedom is None


def test_unknown_degrees_of_freedom_of_an_input_without_effect_do_not_matter() -> None:
    inputs = [_quantity("a", 1.0, 1.0, 5.0), _quantity("b", 1.0, 0.0, None)]
    table = budget(quantity="y", estimate=0, unit="1", inputs=inputs, correlation=np.eye(2))
    assert table.degrees_of_freedom == pytest.approx(5)


@pytest.mark.parametrize(
    ("freedom", "factor"),
    # GUM table G.2, 95 %; a fraction counts as the integer below it, and 5 - 1e-13 as 5.
    [(1, 12.71), (4.99, 2.776), (5 - 1e-13, 2.571), (20.7, 2.086), (math.inf, 1.960)],
)
def test_coverage_factor(freedom: float, factor: float) -> None:
    assert coverage_factor(freedom) == pytest.approx(factor, abs=0.005)


def test_below_one_degree_of_freedom_there_is_no_coverage_factor() -> None:
    assert coverage_factor(0.9) is None


def test_a_budget_without_uncertainty_is_refused() -> None:
    with pytest.raises(ValueError, match="all contributions are zero"):
        budget(
            quantity="y",
            estimate=0,
            unit="1",
            inputs=[_quantity("a", 0.0, 1.0, 5.0)],
            correlation=np.eye(1),
        )
