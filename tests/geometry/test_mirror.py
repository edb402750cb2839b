"""The mirror image of a rig: the formula of depth, the lens and readings know no left and right."""

from __future__ import annotations

import numpy as np
import pytest
from general_rigs import general_rig
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry.camera import Camera, project
from calib.geometry.mirror import (
    OBSERVABLE_SIGN,
    SIGN,
    mirror_camera,
    mirror_readings,
    signs,
)
from calib.geometry.misclosure import depth_jacobian, misclosure
from calib.geometry.parameters import NAMES, REFERENCE_OFFSET
from calib.geometry.plane import Gaze, depth, gaze_at
from calib.simulate.rig import c2_pose, draw_rig, mirror_rig, yaw_axis_in_c2


def _gazes() -> Gaze:
    rng = np.random.default_rng(5)
    x = rng.uniform(-0.3, 0.5, 40)
    y, r = rng.uniform(-0.3, 0.3, 40), rng.uniform(-0.05, 0.05, 40)
    return Gaze(x, y, np.pi / 2 + np.arctan(x) - rng.uniform(0.05, 0.2, 40), r)


def _mirrored(gaze: Gaze) -> Gaze:
    return Gaze(-gaze.x1c, gaze.y1c, np.pi - gaze.alpha2, -gaze.residual)


def test_parameters_that_change_their_sign() -> None:
    """Published in docs/conventions.md; of all others, the depths below decide."""
    assert signs(("baseline_mm", "eccentricity_mm", "encoder_sin_rad")).tolist() == [-1.0] * 3
    assert signs(("axis_z_mm", "standoff_mm", "encoder_cos_rad")).tolist() == [1.0] * 3
    assert signs(("log_noise_scale", "delta2_rad")).tolist() == [1.0, -1.0]


def test_depth_and_misclosure_in_the_mirror() -> None:
    theta, gaze = general_rig(), _gazes()
    z = depth(theta, gaze)
    np.testing.assert_allclose(depth(SIGN * theta, _mirrored(gaze)), z, rtol=1e-12)
    here, there = (
        misclosure(theta, gaze, 0.9 * z),
        misclosure(SIGN * theta, _mirrored(gaze), 0.9 * z),
    )
    np.testing.assert_allclose(there.value, -here.value, atol=1e-14)
    own, other = depth_jacobian(theta, gaze), depth_jacobian(SIGN * theta, _mirrored(gaze))
    # Where reference depths are counted from moves no depth.
    scale = np.where(np.array(NAMES) == REFERENCE_OFFSET, 1, np.abs(own.by_theta).max(axis=0))
    np.testing.assert_allclose(other.by_theta * SIGN / scale, own.by_theta / scale, atol=1e-11)
    np.testing.assert_allclose(
        other.by_observable * np.array(OBSERVABLE_SIGN[:4]), own.by_observable, rtol=1e-9, atol=1e-9
    )


def test_each_parameter_counts_in_the_depths_compared() -> None:
    theta, gaze = general_rig(), _gazes()
    z = depth(theta, gaze)
    for i in np.flatnonzero(np.array(NAMES) != REFERENCE_OFFSET):
        wrong = SIGN * theta
        wrong[i] *= -1
        assert np.abs(depth(wrong, _mirrored(gaze)) / z - 1).max() > 1e-4, NAMES[i]


@pytest.mark.parametrize("count", [0, 5, 8, 12, 14])
def test_a_mirrored_camera_takes_the_mirrored_picture(count: int) -> None:
    lens = np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.02, -0.01, 0.003, 1e-3, -2e-3, 3e-3, 1e-3,
                     0.02, -0.03])[:count]  # fmt: skip
    camera = Camera(np.array([[700.0, 0, 330], [0, 710, 250], [0, 0, 1]]), lens, (640, 480))
    rays = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    u, v = project(camera, rays).T
    seen = project(mirror_camera(camera), rays * [-1, 1])
    np.testing.assert_allclose(seen, np.stack([639 - u, v], axis=1), atol=1e-9)


def test_readings_from_tables_mirror_to_the_last_bit() -> None:
    """A table's 86.22 and the mirrored table's 93.78 are the same numbers after the mirror."""
    thousandths = np.arange(1, 180_000)
    read, other = np.deg2rad([thousandths / 1000, thousandths[::-1] / 1000])
    np.testing.assert_array_equal(mirror_readings(read), other)
    cotangent = np.arange(-20_000, 20_001) / 1000
    given_as, mirrored = np.arctan2(1.0, [cotangent, -cotangent])
    np.testing.assert_array_equal(mirror_readings(given_as), mirrored)


@given(st.floats(0.05, 3.09))
def test_any_reading_mirrors_to_rounding(alpha2: float) -> None:
    assert abs(mirror_readings(np.array([alpha2]))[0] - (np.pi - alpha2)) <= 1e-15


def test_poses_of_a_mirrored_rig() -> None:
    rig = draw_rig(np.random.default_rng(3), model="axis-tilt")
    left, readings = mirror_rig(rig), np.linspace(1.2, 1.9, 5)
    flip = np.diag([-1.0, 1, 1, 1])
    expected = flip @ c2_pose(rig, readings) @ flip
    np.testing.assert_allclose(c2_pose(left, np.pi - readings), expected, atol=1e-9)
    axis, mirrored = yaw_axis_in_c2(rig), yaw_axis_in_c2(left)
    np.testing.assert_allclose(mirrored.direction, axis.direction * [-1, 1, 1], atol=1e-12)
    assert left.depth_range_mm == rig.depth_range_mm
    points = np.array([[100.0, 20, 900], [-50, 10, 1500]])
    np.testing.assert_allclose(
        gaze_at(left.theta, points * [-1, 1, 1]).alpha2, np.pi - gaze_at(rig.theta, points).alpha2
    )
