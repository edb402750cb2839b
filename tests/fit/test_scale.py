"""Default priors on rigs of another size. Evidence: simulated truth, invariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fit_rows import NO_PRIORS, simulated

from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.fit.scale import scaled_defaults
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations

RIG = {"baseline_mm": 300.0, "delta2_rad": 0.01, "axis_z_mm": -25.0, "eccentricity_mm": 8.0}
TRUTH = vector(RIG)


def enlarged(rows: Observations, by: float) -> Observations:
    """Return the rows of a similar rig: lengths times `by`, angles the same."""
    std = np.array(rows.std)
    std[:, OBSERVABLE.z] *= by
    return replace(rows, z_mm=by * rows.z_mm, std=std)


@pytest.fixture(scope="module")
def rows() -> Observations:
    return simulated(np.random.default_rng(5), count=40, **RIG)[0]


def test_usual_rigs_keep_their_priors(rows: Observations) -> None:
    assert scaled_defaults(rows) == {}


@pytest.mark.parametrize(("by", "factor"), [(10.0, 3000 / 60), (2.0, 10**0.585), (0.02, 6 / 60)])
def test_priors_follow_the_baseline(by: float, factor: float, rows: Observations) -> None:
    scaled = scaled_defaults(enlarged(rows, by))
    assert set(scaled) == {"axis_z_mm", "eccentricity_mm", "standoff_mm"}
    assert scaled["axis_z_mm"][1] == pytest.approx(20 * factor, rel=0.15)
    assert scaled["eccentricity_mm"][1] == pytest.approx(10 * factor, rel=0.15)


def test_a_rig_ten_times_as_large_is_recovered(rows: Observations) -> None:
    """Its axis stands 250 mm off: more than 12 standard deviations of the absolute prior."""
    large = enlarged(rows, 10.0)
    fit = fit_model(large, Priors(scaled_defaults(large)), model="axis-offset")
    error = fit.values - 10 * TRUTH[[INDEX[name] for name in fit.names]]
    error[1] = fit.values[1] - TRUTH[1]
    assert np.abs(error / np.sqrt(np.diag(fit.covariance))).max() < 3
    assert 0.6 < fit.noise_scale < 1.5
    # Negative control: the absolute prior of 20 mm holds the axis back, or the rows are blamed.
    absolute = fit_model(large, NO_PRIORS, model="axis-offset")
    axis = absolute.names.index("axis_z_mm")
    off = abs(absolute.values[axis] + 250) / np.sqrt(absolute.covariance[axis, axis])
    held = abs(fit.values[axis] + 250) / np.sqrt(fit.covariance[axis, axis])
    assert off > 2 * held or absolute.noise_scale > 1.5 * fit.noise_scale


def test_rows_without_a_start_have_no_scale(rows: Observations) -> None:
    same = replace(rows.take(np.zeros(6, dtype=np.int64)))
    assert scaled_defaults(same) == {}
