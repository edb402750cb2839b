"""Targets beside C2's centre column. Evidence: simulated truth, repeated simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.fit.identifiability import identifiability
from calib.fit.posterior import sample_posterior
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.parameters import INDEX, MODELS, STANDOFF, vector
from calib.geometry.plane import OBSERVABLE, Gaze, depth, gaze_at
from calib.instrument.calibrated import build_instrument
from calib.rows.from_table import RowSettings, Setup
from calib.rows.observations import Observations
from calib.simulate.rig import TrueRig, c2_pose, draw_rig
from calib.simulate.tables import draw_targets, rays_in_c2
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    ReadingSpread,
    with_standoff,
)
from calib.uncertainty.predictive import linear_positions

TRUTH = {
    "baseline_mm": 120.0,
    "delta2_rad": 0.012,
    "axis_z_mm": -21.0,
    "eccentricity_mm": 5.0,
    "standoff_mm": 60.0,
}
TILTS = {"axis_tilt_x_rad": 0.02, "axis_tilt_z_rad": -0.015, "gaze_roll_rad": 0.02}
WIDE_OFF_RAD = float(np.deg2rad(2.0))


def rig_with(**parameters: float) -> TrueRig:
    rig = draw_rig(np.random.default_rng(0), model="base")
    return replace(rig, theta=vector(TRUTH | parameters), pitch_rad=0.0, height_mm=4.0)


def rows_off_centre(
    rig: TrueRig, rng: np.random.Generator, *, count: int, off_rad: float, noise: float = 1.0
) -> Observations:
    """Rows whose targets C2 sees up to `off_rad` beside its centre column, from its pose alone."""
    points = draw_targets(rig, rng, count=count, depth_range_mm=(600, 1400))
    reading = gaze_at(rig.theta, points).alpha2 + rng.uniform(-off_rad, off_rad, count)
    residual = np.arctan(rays_in_c2(rig, reading, points)[:, 0])
    z = points[:, 2]
    std = np.zeros((count, 5))
    std[:, OBSERVABLE.x1c] = std[:, OBSERVABLE.y1c] = std[:, OBSERVABLE.residual] = 1e-4
    std[:, OBSERVABLE.z] = 5e-4 * z
    seen = np.column_stack([points[:, 0] / z, points[:, 1] / z, reading, residual, z])
    seen = seen + noise * std * rng.standard_normal(std.shape)
    ids = tuple(f"r{i}" for i in range(count))
    return Observations(ids, ids, *seen.T, std)


@pytest.mark.parametrize(("model", "tilts"), [("axis-offset", {}), ("axis-tilt", TILTS)])
def test_depths_two_degrees_off_centre_are_exact(model: str, tilts: dict[str, float]) -> None:
    """Without noise, 60 mm ahead of the axis: the model has the pose of C2 itself to be true to."""
    rig = rig_with(**tilts)
    rows = rows_off_centre(rig, np.random.default_rng(3), count=40, off_rad=WIDE_OFF_RAD, noise=0.0)
    assert np.abs(rows.gaze_residual_rad).max() > 0.9 * WIDE_OFF_RAD
    np.testing.assert_allclose(depth(rig.theta, rows.gaze), rows.z_mm, rtol=1e-12)
    sharp = replace(rows, std=1e-4 * rows.std)
    fit = fit_model(sharp, Priors({}), model=model)
    np.testing.assert_allclose(depth(fit.theta, rows.gaze), rows.z_mm, rtol=1e-6)
    assert fit.values[fit.names.index(STANDOFF)] == pytest.approx(60.0, abs=0.05)
    ignored = depth(fit.theta * (np.arange(len(fit.theta)) != INDEX[STANDOFF]), rows.gaze)
    assert np.abs(ignored / rows.z_mm - 1).max() > 5e-3, "the standoff has nothing to explain"


def test_the_standoff_is_free_where_rows_show_residuals_and_nowhere_else() -> None:
    rows = rows_off_centre(rig_with(), np.random.default_rng(1), count=30, off_rad=1e-3)
    assert fit_model(rows, Priors({}), model="axis-offset").names == (
        *MODELS["axis-offset"].free,
        STANDOFF,
    )
    still = replace(rows, gaze_residual_rad=np.zeros(30))
    assert fit_model(still, Priors({}), model="axis-offset").names == MODELS["axis-offset"].free


def test_a_standoff_that_hardly_matters_stays_with_its_prior_without_a_word() -> None:
    rows = rows_off_centre(rig_with(), np.random.default_rng(1), count=30, off_rad=2e-4)
    fit = fit_model(rows, Priors({}), model="axis-offset")
    told = identifiability(rows, fit, Priors({}))
    assert told.idle == (STANDOFF,)
    assert told.decided_by[told.names.index(STANDOFF)] == "prior"
    assert not any(STANDOFF in words.names for words in told.open)
    # Half a degree off, few sharp rows: now it matters, and the words ask for it.
    some = rows_off_centre(rig_with(), np.random.default_rng(1), count=8, off_rad=WIDE_OFF_RAD)
    fit = fit_model(some, Priors({}), model="base")
    assert identifiability(some, fit, Priors({})).idle == ()


@pytest.mark.slow
def test_pulls_of_depths_off_centre_are_of_unit_size() -> None:
    """Repeated simulation, standoffs from their prior: rms of 120 pulls is 1 +- 0.065."""
    pulls = []
    for seed in range(120):
        rng = np.random.default_rng([9, seed])
        rig = rig_with(standoff_mm=float(rng.normal(0, 40)))
        rows = rows_off_centre(rig, rng, count=14, off_rad=WIDE_OFF_RAD)
        fit = fit_model(rows, Priors({}), model="axis-offset")
        fresh = rows_off_centre(rig, rng, count=1, off_rad=WIDE_OFF_RAD, noise=0.0)
        found = linear_positions(_instrument(fit), fresh.gaze, None)
        u = np.sqrt(np.einsum("k,kl,l", found.by_common[0, 2], found.common, found.by_common[0, 2]))
        pulls.append((found.position_mm[0, 2] - fresh.z_mm[0]) / u)
    rms = float(np.sqrt(np.mean(np.square(pulls))))
    assert 0.8 < rms < 1.2


def _instrument(fit: RobustFit) -> Instrument:
    kinds = ("A",) * len(fit.names)
    parameters = ParameterKnowledge(fit.names, fit.values, fit.covariance, None, kinds)
    return Instrument(parameters, ReadingSpread())


def test_a_calibration_that_never_saw_a_residual_doubts_readings_off_centre() -> None:
    """40 mm sin r / (n . r) of depth: what the prior of the standoff makes of 2 degrees."""
    rows = rows_off_centre(rig_with(), np.random.default_rng(1), count=30, off_rad=0.0)
    still = replace(rows, gaze_residual_rad=np.zeros(30), std=1e-4 * rows.std)
    known = _instrument(fit_model(still, Priors({}), model="base"))
    seen = Gaze(np.zeros(1), np.zeros(1), np.array([np.deg2rad(82.0)]), np.array([WIDE_OFF_RAD]))
    wider = with_standoff(known)
    assert with_standoff(wider) is wider
    found = linear_positions(wider, seen, None)
    narrow = linear_positions(known, seen, None)
    variance = [x.by_common[0, 2] @ x.common @ x.by_common[0, 2] for x in (found, narrow)]
    u = np.sqrt(variance[0] - variance[1])
    angle = seen.alpha2[0] + WIDE_OFF_RAD + known.theta[1]
    expected = 40 * np.sin(WIDE_OFF_RAD) / np.cos(angle)
    assert u == pytest.approx(expected, rel=1e-6)


def test_draws_of_an_unknown_standoff_follow_its_prior() -> None:
    rows = rows_off_centre(rig_with(), np.random.default_rng(1), count=30, off_rad=0.0)
    still = replace(rows, gaze_residual_rad=np.zeros(30))
    fit = fit_model(still, Priors({}), model="base")
    posterior = sample_posterior(still, fit, Priors({}), seed=SeedSequence(1))
    known = build_instrument(
        posterior, fit, still, Setup(RowSettings(1e-4, 0.0, 5e-4, 0.0, 0.0))
    ).instrument
    with pytest.raises(ValueError, match="draws of the standoff"):
        with_standoff(known)
    wider = with_standoff(known, np.random.default_rng(0))
    assert wider.own_draws is not None
    assert known.own_draws is not None
    np.testing.assert_array_equal(wider.own_draws[:, :-1], known.own_draws)
    assert np.std(wider.own_draws[:, -1]) == pytest.approx(40.0, rel=0.1)


def test_pose_of_c2_is_the_one_the_rows_come_from() -> None:
    """Control of the simulation above: C2's centre is 60 mm ahead of its axis."""
    pose = c2_pose(rig_with(eccentricity_mm=0.0), np.array(np.pi / 2))
    ahead = (pose[:3, 3] - np.array([120.0, 0.0, -21.0])) @ pose[:3, 2]
    assert ahead == pytest.approx(60.0, abs=1e-9)
