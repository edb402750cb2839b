"""What rows can tell of a model.

Evidence: simulated truth, negative controls and properties of the information.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.fit.identifiability import UNDETERMINED, Identifiability, identifiability
from calib.fit.information import Information, beforehand, row_information
from calib.fit.priors import MeasuredParameters, Priors, measured_of, prior_of
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations
from calib.simulate.rig import TrueRig, draw_rig
from calib.simulate.tables import observe
from calib.stages.serialise import deserialise, serialise

PRIORS = Priors({})

NARROW = ([0.05, 0.1, 0.15], [700.0, 900.0, 1200.0, 1500.0])

AXIS_OFFSET = MODELS["axis-offset"]


def rig() -> TrueRig:
    return draw_rig(
        np.random.default_rng(4), model="axis-offset", fixed={"baseline_mm": 120.0}
    )  # fmt: skip


def rows_along(x1c: list[float], z_mm: list[float]) -> Observations:
    """Rows on a grid of directions and depths."""
    x, z = (a.ravel() for a in np.meshgrid(x1c, z_mm))
    points = np.column_stack([x * z, np.zeros_like(x), z])
    return observe(rig(), np.random.default_rng(1), points).observed


def fit(rows: Observations, model: str, priors: Priors = PRIORS) -> RobustFit:
    return fit_robust(rows, MODELS[model], priors)


def told(rows: Observations, priors: Priors = PRIORS) -> Identifiability:
    return identifiability(rows, fit(rows, "axis-offset", priors), priors)


def test_rows_near_the_axis_cannot_tell_baseline_from_eccentricity() -> None:
    """Negative control: seen near 90 deg, L_b and e are one; a wide sweep tells them apart.

    e / sin a changes by (1 - sin a) e: 2 % over a range of +-12 deg, 10 mm of e then moves the
    closure by less than the rows' noise.
    """
    found = told(rows_along(*NARROW))
    worst = found.combinations[-1]
    assert worst.std > UNDETERMINED
    assert worst.names == ("baseline_mm", "eccentricity_mm")
    assert worst.told_by == "prior"
    assert worst.words.startswith(
        "these targets cannot distinguish L_b from e: spread them over readings"
    )
    assert "state a prior of eccentricity_mm" in worst.words
    assert found.open == (worst,)
    # The priors hold what the rows do not.
    assert worst.std_with_priors < worst.std / 2
    assert found.decided_by[0] == found.decided_by[3] == "rows and prior"
    better = told(rows_along([-0.5, -0.2, 0.2, 0.5], [400, 700, 1500]))
    assert better.combinations[-1].std < worst.std / 5


def test_the_readings_asked_for_tell_what_they_should() -> None:
    """Simulated truth: rows put where the words say leave nothing open."""
    narrow = rows_along(*NARROW)
    (remedy, *_) = told(narrow).open[0].remedies
    low, high = map(float, re.findall(r"\d+", remedy)[:2])
    readings = np.rad2deg([narrow.alpha2_rad.min(), narrow.alpha2_rad.max()])
    assert low < readings[0] < readings[1] < high
    # At depths far beyond the baseline C1 sees a target at -cot of the reading.
    x1c = -1 / np.tan(np.deg2rad(np.linspace(low, high, len(NARROW[0]))))
    assert told(rows_along(list(x1c), NARROW[1])).open == ()


def test_a_sweep_identifies_what_the_rows_do_not() -> None:
    """Property: with e measured to 0.05 mm the combination is told by the sweep, and named so."""
    narrow = rows_along(*NARROW)
    e = dict(zip(AXIS_OFFSET.free, fit(narrow, "axis-offset").values, strict=True))
    measured = MeasuredParameters(
        ("eccentricity_mm",), np.array([e["eccentricity_mm"]]), np.array([[0.05**2]])
    )
    found = told(narrow, Priors({}, measured))
    worst = found.combinations[-1]
    assert worst.told_by == "sweep"
    assert worst.words == ""
    assert found.open == ()
    assert found.has_sweep
    decided = dict(zip(found.names, found.decided_by, strict=True))
    assert decided["eccentricity_mm"] == "sweep"
    assert decided["baseline_mm"] == "rows and sweep"
    assert decided["delta2_rad"] == "rows"
    assert found.sweep_std[3] == pytest.approx(0.05, rel=1e-3)
    assert not told(narrow).has_sweep


def test_correlation_alone_fails_no_gate() -> None:
    """Property: L_b and e correlate at -0.9 and beyond, depth is known to 2 % all the same."""
    found = told(rows_along([-0.3, 0.0, 0.3], [600, 900, 1400]))
    i, j = (found.names.index(n) for n in ("baseline_mm", "eccentricity_mm"))
    assert found.correlation[i, j] < -0.9
    assert found.gate.name == "identified"
    assert found.gate.passed
    assert found.depth_std_rel < 0.02


def test_gate_fails_where_depth_stays_unknown() -> None:
    """Negative control: rows that weigh nothing leave depth to the priors."""
    estimate = fit(rows_along([-0.3, 0.0, 0.3], [600, 900, 1400]), "axis-offset")
    spot = identifiability(rows_along([0.1, 0.1001], [800, 800.5, 801]), estimate, PRIORS)
    assert spot.open
    assert spot.condition > 1e3
    far = rows_along([-0.4, 0.4], [1500, 1600])
    gate = identifiability(replace(far, std=far.std * 1e4), estimate, PRIORS).gate
    assert not gate.passed
    assert "these targets" in gate.detail


def test_information_predicts_the_scatter_of_estimates() -> None:
    """Simulated truth: the predicted standard deviations are those of 40 repeated fits.

    Base on 20 rows, noise scale known to the prediction: the rms of 40 draws is known to 11 %, the
    prediction's weights, from observed rows, to a few more; three times that is allowed.
    """
    truth = draw_rig(np.random.default_rng(9), model="base")
    rng = np.random.default_rng(2)
    low, high = truth.depth_range_mm
    z = rng.uniform(low, high, 20)
    points = np.column_stack([rng.uniform(-0.3, 0.3, 20) * z, np.zeros(20), z])
    estimates = []
    for i in range(40):
        noise = np.random.default_rng((3, i))
        # A shift of more than a count each time: else all repeats share the encoder's rounding.
        shifted = points * (1 + 0.01 * noise.standard_normal((20, 1)) * [1, 0, 0])
        estimates.append(fit(observe(truth, noise, shifted).observed, "base"))
    one = observe(truth, np.random.default_rng(0), points).observed
    information = row_information(one, estimates[0]) * estimates[0].noise_scale ** 2
    predicted = np.sqrt(np.diag(np.linalg.inv(information)))
    scatter = np.std([e.values for e in estimates], axis=0)
    assert scatter == pytest.approx(predicted, rel=0.36)


def test_combinations_are_the_information_taken_apart() -> None:
    """Property: singular values and directions give the scaled information back."""
    rows = rows_along([-0.3, 0.0, 0.3], [600, 900, 1400])
    estimate = fit(rows, "axis-offset")
    found = identifiability(rows, estimate, PRIORS)
    directions = np.array([c.direction for c in found.combinations])
    values = np.array([c.singular_value for c in found.combinations])
    unit = beforehand(AXIS_OFFSET)
    np.testing.assert_allclose(unit, [10.0, 0.01, 20.0, 10.0])
    information = row_information(rows, estimate) * np.outer(unit, unit)
    again = (directions.T * values**2) @ directions
    np.testing.assert_allclose(again, information, rtol=1e-9, atol=1e-9 * information.max())
    assert np.all(np.diff(values) <= 0)
    alone = np.linalg.inv(row_information(rows, estimate))
    np.testing.assert_allclose(found.rows_std, np.sqrt(np.diag(alone)), rtol=1e-6)
    prior = prior_of(AXIS_OFFSET, PRIORS).precision
    covariance = np.linalg.inv(row_information(rows, estimate) + prior)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert measured_of(AXIS_OFFSET, PRIORS).precision.max() == 0
    assert rows.std[:, OBSERVABLE.alpha2].min() > 0


def test_what_nothing_is_known_of_is_infinite() -> None:
    """Property: one row of two numbers tells their sum, the difference not, and each not."""
    known = Information.of(np.array([[2.0, 2.0]]))
    along = np.array([[1.0, 1.0], [1.0, -1.0], [np.sqrt(2), 0.0]]) / np.sqrt(2)
    std = known.std(along)
    # The row is 2 sqrt(2) times the unit vector of the sum.
    assert std[0] == pytest.approx(1 / np.sqrt(8))
    assert std[1] == std[2] == np.inf
    assert known.value[1] == 0.0
    both = Information.of(np.array([[2.0, 2.0]]), np.array([[0.0, 1.0]]))
    np.testing.assert_allclose(both.covariance, np.linalg.inv([[4.0, 4.0], [4.0, 5.0]]))


def test_it_is_kept_and_read_back() -> None:
    """Property: what a stage stores comes back, infinities too."""
    found = told(rows_along([0.1, 0.3], [700, 1200, 1500]))
    blind = replace(
        found,
        combinations=tuple(replace(c, std=np.inf, singular_value=0.0) for c in found.combinations),
    )
    document, arrays = serialise(blind)
    again = deserialise(json.loads(json.dumps(document)), arrays, Identifiability)
    assert again.combinations[0].std == np.inf
    assert [c.words for c in again.combinations] == [c.words for c in blind.combinations]
    assert again.gate == blind.gate
