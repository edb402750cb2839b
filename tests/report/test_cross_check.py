"""C2's gaze plane in the pairs against that of the rows. Evidence: simulated truth; properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report_examples import paper

from calib.checks.stereo_pose import FREE_SHIFT_MM, FREE_TURN_RAD, YawCheck, check_yaw, yaw_warnings
from calib.core.arrays import FloatArray
from calib.geometry.parameters import INDEX, MODELS
from calib.geometry.poses import pose_vector, rotation
from calib.simulate.rig import TrueRig, c2_pose, draw_rig

READING = 1.4
COVARIANCE = np.diag([1e-4, 1e-4, 1e-5, 0.02, 0.02, 0.1]) ** 2


@pytest.fixture(params=range(3))
def rig(request: pytest.FixtureRequest) -> TrueRig:
    return draw_rig(np.random.default_rng(request.param), model="axis-tilt")


def checked(rig: TrueRig, pose_12: FloatArray, *, std: float = 1e-4) -> YawCheck:
    """Check the true rig, its parameters known to `std` in rad and mm, against a pose of C2."""
    found = paper()[0].gaze
    assert found is not None
    names = MODELS["axis-tilt"].free
    fit = replace(
        found.robust["base"],
        names=names,
        values=rig.theta[[INDEX[name] for name in names]],
        covariance=np.eye(len(names)) * std**2,
    )
    return check_yaw(
        fit, pose_12=pose_12, covariance=COVARIANCE, alpha2_rad=READING, u_alpha2_rad=5e-5
    )


def test_the_true_pose_fits_whatever_the_mount(rig: TrueRig) -> None:
    check = checked(rig, pose_vector(c2_pose(rig, np.array(READING))))
    assert check.turn_rad == pytest.approx(0, abs=1e-9)
    assert check.shift_mm == pytest.approx(0, abs=1e-7)
    assert yaw_warnings(check) == ()


def test_another_reading_is_named_with_its_size(rig: TrueRig) -> None:
    check = checked(rig, pose_vector(c2_pose(rig, np.array(READING + np.deg2rad(1.0)))))
    assert check.turn_rad == pytest.approx(np.deg2rad(1.0), rel=1e-6)
    assert check.shift_mm == pytest.approx(0, abs=1e-7)
    (text,) = yaw_warnings(check)
    assert "turned +1.00 deg" in text


def test_a_bumped_camera_is_named_by_turn_and_shift(rig: TrueRig) -> None:
    pose = pose_vector(c2_pose(rig, np.array(READING)))
    pose[3:] += 2.0 * rotation(pose[:3])[:, 0]
    check = checked(rig, pose)
    assert check.shift_mm == pytest.approx(2.0, abs=1e-6)
    (text,) = yaw_warnings(check)
    assert "+2.00 mm farther" in text


def test_limits_are_five_standard_deviations_of_both_and_never_below_play(rig: TrueRig) -> None:
    pose = pose_vector(c2_pose(rig, np.array(READING)))
    sharp = checked(rig, pose, std=1e-9)
    assert sharp.turn_limit_rad >= FREE_TURN_RAD
    assert sharp.shift_limit_mm == pytest.approx(FREE_SHIFT_MM, rel=0.5)
    wide = checked(rig, pose, std=1.0)
    # Baseline and axis_z of 1 mm together move the plane by 1 mm, the eccentricity by another.
    assert wide.shift_limit_mm == pytest.approx(5 * np.sqrt(2), rel=0.02)
