"""The robust fit. Evidence: the paper's data, simulated truth, repeated simulation, SciPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated, table_1
from scipy.integrate import quad
from scipy.stats import norm

from calib.core.errors import EstimationError
from calib.fit.noise import CLEAN, ROBUST, Tails, log_density, row_noise
from calib.fit.priors import MeasuredParameters, Priors
from calib.fit.robust import fit_model, fit_robust
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import MODELS

OFFSET = MODELS["axis-offset"]


def test_axis_offset_explains_table_1() -> None:
    """Published data: the finding of the project on the paper's own table."""
    fit = fit_robust(table_1(), OFFSET, NO_PRIORS)
    values = dict(zip(fit.names, fit.values, strict=True))
    assert values["axis_z_mm"] == pytest.approx(-21.0, abs=1.5)
    assert fit.sigma_mrad < 0.4
    assert dict(zip(fit.names, fit.identified_by, strict=True))["eccentricity_mm"] == "prior"
    base = fit_robust(table_1(), MODELS["base"], NO_PRIORS)
    assert base.sigma_mrad == pytest.approx(3.2, abs=0.2)
    assert base.noise_scale > 5, "a model that does not fit must widen its uncertainties"


@pytest.mark.parametrize("name", list(MODELS))
def test_exact_rows_give_back_the_truth(name: str) -> None:
    """Simulated truth without noise: with data this strong the priors leave no trace of theirs."""
    truth = {
        "axis_z_mm": -18.0, "eccentricity_mm": 3.0, "axis_tilt_x_rad": 0.01,
        "axis_tilt_z_rad": -0.012, "gaze_roll_rad": 0.008, "encoder_scale": 0.004,
        "encoder_cos_rad": 0.001, "encoder_sin_rad": -0.0008,
    }  # fmt: skip
    model = MODELS[name]
    parameters = {k: v for k, v in truth.items() if k in model.free}
    rows, theta = simulated(np.random.default_rng(5), count=60, noise=0.0, **parameters)
    rows = replace(rows, std=1e-6 * rows.std)
    fit = fit_robust(rows, model, NO_PRIORS)
    std = np.sqrt(np.diag(fit.covariance))
    assert np.all(std < 1e-3)
    np.testing.assert_array_less(np.abs(fit.theta - theta)[list(model.indices)], 1e-4 * std + 1e-6)


@pytest.mark.parametrize("tails", [ROBUST, CLEAN])
def test_constants_of_the_t_density(tails: Tails) -> None:
    """Independent tool: SciPy's quadrature of the equations that define them."""
    dof, width = tails.dof, tails.dof * tails.core**2

    def psi(x: float) -> float:
        return (dof + 1) * x / (width + x * x)

    def slope(x: float) -> float:
        return (dof + 1) * (width - x * x) / (width + x * x) ** 2

    def mean(f: Callable[[float], float]) -> float:
        return float(quad(lambda x: f(x) * norm.pdf(x), -12, 12)[0])

    assert mean(lambda x: x * psi(x)) == pytest.approx(1.0, abs=1e-8)
    assert mean(slope) ** 2 / mean(lambda x: psi(x) ** 2) == pytest.approx(
        tails.efficiency, abs=1e-8
    )
    total = quad(
        lambda x: float(np.exp(log_density(np.array([x]), 0.3, tails)[0])), -np.inf, np.inf
    )[0]
    assert total == pytest.approx(1.0, abs=1e-6)


def test_effective_variance_by_simulation() -> None:
    """Repeated simulation: the misclosure of noisy rows has the standard deviation stated."""
    rows, theta = simulated(np.random.default_rng(6), count=20_000, axis_z_mm=-20.0)
    miss = misclosure(theta, rows.gaze, rows.z_mm).value / row_noise(theta, rows).sigma
    assert np.std(miss) == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(rows)))


def test_outliers_are_named_and_harmless() -> None:
    """Simulated truth: four gross errors of forty rows; all named, estimate within 4 sigma."""
    for seed in range(10):
        rows, theta = simulated(np.random.default_rng(seed), count=40, outliers=4, axis_z_mm=-20.0)
        clean = misclosure(theta, rows.gaze, rows.z_mm).value / row_noise(theta, rows).sigma
        fit = fit_robust(rows, OFFSET, NO_PRIORS)
        gross = {i for i, r in zip(rows.ids, clean, strict=True) if abs(r) > 8}
        assert set(fit.outliers) >= gross
        assert len(fit.outliers) <= len(gross) + 1
        pull = (fit.theta - theta)[list(OFFSET.indices)] / np.sqrt(np.diag(fit.covariance))
        assert np.abs(pull).max() < 4.5


def test_one_gross_row_of_six_does_not_lead_astray() -> None:
    """Simulated truth: the smallest table with an outlier."""
    astray = 0
    for seed in range(20):
        rows, theta = simulated(np.random.default_rng(seed), count=6, outliers=1)
        fit = fit_robust(rows, MODELS["base"], NO_PRIORS)
        pull = (fit.values - theta[:2]) / np.sqrt(np.diag(fit.covariance))
        astray += bool(np.abs(pull).max() > 5)
    assert astray <= 1


@pytest.mark.parametrize(
    ("model", "rigs"),
    [
        pytest.param("base", 300, marks=pytest.mark.slow),
        pytest.param("axis-offset", 150, marks=pytest.mark.slow),
    ],
)
def test_pulls_over_repeated_simulation(model: str, rigs: int) -> None:
    """Coverage: rigs from the priors; of n the rms of the pulls is known to 1 in root 2 n.

    That of honest ones lies within 3.3 of it of 1.
    """
    pulls = []
    for i in range(rigs):
        rng = np.random.default_rng(1000 + i)
        parameters = {"delta2_rad": rng.normal(0, 0.02)}
        if model == "axis-offset":
            parameters |= {
                "axis_z_mm": rng.normal(0, 20), "eccentricity_mm": rng.normal(0, 10),
            }  # fmt: skip
        rows, theta = simulated(rng, count=14, **parameters)
        fit = fit_robust(rows, MODELS[model], NO_PRIORS)
        error = fit.values - theta[list(MODELS[model].indices)]
        pulls.append(error / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all(np.abs(rms - 1) < 3.3 / np.sqrt(2 * rigs)), rms


def test_shared_errors_enter_the_covariance() -> None:
    """Repeated simulation: a common error of all reference depths, drawn anew for each rig."""
    errors, stated = [], []
    for i in range(60):
        rng = np.random.default_rng(2000 + i)
        rows, theta = simulated(rng, count=20)
        by_shared = np.zeros((20, 5, 1))
        by_shared[:, 4, 0] = 0.01 * rows.z_mm
        common = rng.standard_normal()
        rows = replace(
            rows,
            z_mm=rows.z_mm + by_shared[:, 4, 0] * common,
            shared=by_shared,
            shared_names=("scale",),
        )
        fit = fit_robust(rows, MODELS["base"], NO_PRIORS)
        errors.append(fit.values[0] - theta[0])
        stated.append(np.sqrt(fit.covariance[0, 0]))
    rms = np.sqrt(np.mean(np.square(errors) / np.square(stated)))
    assert abs(rms - 1) < 3.3 / np.sqrt(2 * len(errors))
    assert np.mean(stated) > 1.1, "1 % of 120 mm must show"


def test_measured_eccentricity_separates_it_from_the_baseline() -> None:
    """Simulated truth: what the yaw sweep brings."""
    rows, theta = simulated(np.random.default_rng(8), count=14, eccentricity_mm=5.0)
    measured = MeasuredParameters(("eccentricity_mm",), np.array([5.1]), np.array([[0.2**2]]))
    alone = fit_robust(rows, OFFSET, NO_PRIORS)
    fit = fit_robust(rows, OFFSET, Priors({}, measured))
    std = np.sqrt(np.diag(fit.covariance))
    assert std[3] < 0.21 < np.sqrt(alone.covariance[3, 3])
    assert abs(fit.values[0] - theta[0]) < 4 * std[0]
    assert fit.identified_by[3] == "data"


def test_models_that_rows_cannot_carry() -> None:
    """Negative controls: too few rows, no height."""
    with pytest.raises(EstimationError, match="9 are needed"):
        fit_model(table_1(), NO_PRIORS, model="encoder")
    rows, _ = simulated(np.random.default_rng(9), count=20)
    flat = replace(rows, y1c=np.zeros(20), has_height=False)
    with pytest.raises(EstimationError, match="y1c"):
        fit_model(flat, NO_PRIORS, model="axis-tilt")
