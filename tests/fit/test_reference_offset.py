"""From where z_mm counts. Evidence: simulated truth, repeated simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.geometry.plane import depth
from calib.study import trial
from calib.study.conditions import Condition
from calib.study.rigs import set_up
from tests.fit.fit_rows import simulated

DEFAULT = PARAMETERS[INDEX[REFERENCE_OFFSET]].prior_std or 0.0
OPEN = Priors({REFERENCE_OFFSET: (0.0, DEFAULT)})


def offset_of(fit: RobustFit) -> tuple[float, float]:
    i = fit.names.index(REFERENCE_OFFSET)
    return float(fit.values[i]), float(np.sqrt(fit.covariance[i, i]))


def test_depths_counted_from_elsewhere_meet_the_plane_at_their_offset() -> None:
    """Closed form: z_mm = depth - o has no misclosure at o, tilts and all, and has some without."""
    rows, theta = simulated(
        np.random.default_rng(0), count=30, noise=0.0,
        axis_z_mm=-20.0, axis_tilt_x_rad=0.02, axis_tilt_z_rad=-0.01, gaze_roll_rad=0.03,
    )  # fmt: skip
    moved = theta.copy()
    moved[INDEX[REFERENCE_OFFSET]] = 35.0
    np.testing.assert_allclose(
        misclosure_value(moved, rows.gaze, rows.z_mm - 35.0), 0, rtol=0, atol=1e-15
    )
    assert np.abs(misclosure_value(theta, rows.gaze, rows.z_mm - 35.0)).min() > 1e-3
    np.testing.assert_array_equal(depth(moved, rows.gaze), depth(theta, rows.gaze))


@pytest.mark.parametrize("model", ["axis-offset", "axis-tilt", "encoder"])
def test_an_offset_is_found_and_depths_count_from_the_centre(model: str) -> None:
    """Nearly without noise, within five standard deviations and 1e-4 of the depth."""
    rows, _ = simulated(np.random.default_rng(1), count=40, noise=0.01, axis_z_mm=-15.0)
    sharp = replace(rows, std=0.01 * rows.std, z_mm=rows.z_mm - 35.0)
    fit = fit_model(sharp, OPEN, model=model)
    found, u = offset_of(fit)
    assert u < 0.5
    assert abs(found - 35.0) < 5 * u
    np.testing.assert_allclose(depth(fit.theta, rows.gaze), rows.z_mm, rtol=5e-4)
    unaware = fit_model(sharp, Priors({}), model=model)
    assert REFERENCE_OFFSET not in unaware.names
    assert np.abs(depth(unaware.theta, rows.gaze) / rows.z_mm - 1).max() > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("ahead_mm", [0.0, 5.0, 10.0, 20.0, 40.0, 60.0])
def test_depth_intervals_hold_when_nobody_says_where_depths_count_from(ahead_mm: float) -> None:
    """Repeated simulation, 120 rigs of 20 depths; depths of one rig err alike, so that the standard
    error of the coverage is 0.02 and three of them are allowed below 0.95."""
    condition = Condition("offset", "z_mm counts from elsewhere", rows=24)
    held = []
    for number in range(120):
        bench = set_up(condition, seed=4711, number=number)
        rows = replace(bench.rows, z_mm=bench.rows.z_mm - ahead_mm)
        bench = replace(bench, rows=rows, priors=OPEN)
        seeds = np.random.SeedSequence((4711, number, 1)).spawn(4)
        found = trial.calibrated(condition, bench, seeds)
        held.append(np.mean(found["depths"]["inside"]["measure95"]))
    assert 0.89 < np.mean(held) <= 0.995
