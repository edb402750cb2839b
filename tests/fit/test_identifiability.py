"""What rows can tell of a model. Evidence: simulated truth and properties of the information."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fit.identifiability import UNDETERMINED, identifiability, row_information
from calib.fit.priors import Priors, prior_of
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE
from calib.observations import Observations
from calib.simulate.rig import Rig, draw_rig
from calib.simulate.tables import observe

PRIORS = Priors({})


def rig() -> Rig:
    return draw_rig(
        np.random.default_rng(4), model="axis-offset", fixed={"baseline_mm": 120.0}
    )  # fmt: skip


def rows_along(x1c: list[float], z_mm: list[float]) -> Observations:
    """Rows on a grid of directions and depths."""
    x, z = (a.ravel() for a in np.meshgrid(x1c, z_mm))
    points = np.column_stack([x * z, np.zeros_like(x), z])
    return observe(rig(), np.random.default_rng(1), points).observed


def fit(rows: Observations, model: str) -> RobustFit:
    return fit_robust(rows, MODELS[model], PRIORS)


def test_rows_near_the_axis_cannot_tell_baseline_from_eccentricity() -> None:
    """Negative control: seen near 90 deg, L_b and e are one; a wide sweep tells them apart.

    e / sin a changes by (1 - sin a) e: 2 % over a range of +-12 deg, 10 mm of e then moves the
    closure by less than the rows' noise.
    """
    narrow = rows_along([0.05, 0.1, 0.15], [700, 900, 1200, 1500])
    found = identifiability(narrow, fit(narrow, "axis-offset"), PRIORS)
    worst = found.combinations[-1]
    assert worst.std > UNDETERMINED
    assert set(worst.names) == {"baseline_mm", "eccentricity_mm"}
    assert worst.words.startswith("these targets cannot tell")
    assert "sweep wider than" in worst.words
    assert "give a prior of eccentricity_mm" in worst.words
    # The priors hold what the rows do not.
    assert worst.std_with_priors < worst.std
    wide = rows_along([-0.5, -0.2, 0.2, 0.5], [400, 700, 1500])
    better = identifiability(wide, fit(wide, "axis-offset"), PRIORS)
    assert better.combinations[-1].std < worst.std / 5


def test_correlation_alone_fails_no_gate() -> None:
    """Property: L_b and e correlate at -0.9 and beyond, depth is known to 2 % all the same."""
    rows = rows_along([-0.3, 0.0, 0.3], [600, 900, 1400])
    found = identifiability(rows, fit(rows, "axis-offset"), PRIORS)
    i, j = (found.names.index(n) for n in ("baseline_mm", "eccentricity_mm"))
    assert found.correlation[i, j] < -0.9
    assert found.gate.passed
    assert found.depth_std_rel < 0.02


def test_gate_fails_where_depth_stays_unknown() -> None:
    """Negative control: rows at one spot leave depth open there by the priors' own width."""
    rows = rows_along([0.1, 0.1001], [800, 800.5, 801])
    estimate = fit(rows_along([-0.3, 0.0, 0.3], [600, 900, 1400]), "axis-offset")
    far = rows_along([-0.4, 0.4], [1500, 1600])
    spread = identifiability(rows, estimate, PRIORS)
    assert spread.combinations[-1].words
    assert spread.condition > 1e3
    # The same knowledge asked at other depths: build rows that weigh nothing there.
    blind = far.take(np.arange(len(far)))
    loose = Observations(**{**vars(blind), "std": blind.std * 1e4})
    gate = identifiability(loose, estimate, PRIORS).gate
    assert not gate.passed
    assert "these targets" in gate.detail


def test_information_predicts_the_scatter_of_estimates() -> None:
    """Simulated truth: the predicted standard deviations are those of 60 repeated fits.

    Base on 20 rows, noise scale known to the prediction: the rms of 60 draws is known to 9 %, the
    prediction's weights, from observed rows, to a few more; three times that is allowed.
    """
    truth = draw_rig(np.random.default_rng(9), model="base")
    rng = np.random.default_rng(2)
    low, high = truth.depth_range_mm
    z = rng.uniform(low, high, 20)
    points = np.column_stack([rng.uniform(-0.3, 0.3, 20) * z, np.zeros(20), z])
    estimates = []
    for i in range(60):
        noise = np.random.default_rng((3, i))
        # A shift of more than a count each time: else all repeats share the encoder's rounding.
        shifted = points * (1 + 0.01 * noise.standard_normal((20, 1)) * [1, 0, 0])
        estimates.append(fit(observe(truth, noise, shifted).observed, "base"))
    one = observe(truth, np.random.default_rng(0), points).observed
    information = row_information(one, estimates[0]) * estimates[0].noise_scale ** 2
    predicted = np.sqrt(np.diag(np.linalg.inv(information)))
    scatter = np.std([e.values for e in estimates], axis=0)
    assert scatter == pytest.approx(predicted, rel=0.3)


def test_combinations_are_the_information_taken_apart() -> None:
    """Property: singular values and directions give the scaled information back."""
    rows = rows_along([-0.3, 0.0, 0.3], [600, 900, 1400])
    estimate = fit(rows, "axis-offset")
    found = identifiability(rows, estimate, PRIORS)
    directions = np.array([c.direction for c in found.combinations])
    values = np.array([c.singular_value for c in found.combinations])
    unit = np.array([1.0, 1e-3, 1.0, 1.0])
    information = row_information(rows, estimate) * np.outer(unit, unit)
    again = (directions.T * values**2) @ directions
    np.testing.assert_allclose(again, information, rtol=1e-9, atol=1e-9 * information.max())
    assert np.all(np.diff(values) <= 0)
    prior = prior_of(MODELS["axis-offset"], PRIORS).precision
    covariance = np.linalg.inv(row_information(rows, estimate) + prior)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert rows.std[:, OBSERVABLE.alpha2].min() > 0
