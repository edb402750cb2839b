"""Evidence: property. The pose of C2 against the gaze plane, two formulas written independently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry.camera import normalise
from calib.geometry.parameters import (
    INDEX,
    MODELS,
    NAMES,
    PARAMETERS,
    REFERENCE_OFFSET,
    STANDOFF,
    vector,
)
from calib.geometry.plane import Gaze, depth, frame, gaze_angle
from calib.simulate.rig import TrueRig, c2_pose, draw_rig, yaw_axis_in_c2
from calib.simulate.scene import rotation

SPREADS = {
    "axis_z_mm": 20.0,
    "eccentricity_mm": 15.0,
    "axis_tilt_x_rad": 0.1,
    "axis_tilt_z_rad": 0.1,
    "gaze_roll_rad": 0.1,
    "encoder_scale": 0.03,
    "encoder_cos_rad": 0.01,
    "encoder_sin_rad": 0.01,
}


def rig_with_everything(seed: int) -> TrueRig:
    """A rig with every parameter of the family far from neutral."""
    rng = np.random.default_rng(seed)
    fixed = {name: float(rng.normal(0, spread)) for name, spread in SPREADS.items()}
    return replace(draw_rig(rng, model="base", fixed=fixed), pitch_rad=float(rng.normal(0, 0.1)))


def plain_rig(**fixed: float) -> TrueRig:
    rig = draw_rig(np.random.default_rng(0), model="base")
    theta = vector({"baseline_mm": 100.0, "standoff_mm": 20.0} | fixed)
    return replace(rig, theta=theta, height_mm=3.0, pitch_rad=0.0)


@pytest.mark.parametrize("seed", range(20))
def test_plane_of_the_pose_is_the_gaze_plane(seed: int) -> None:
    rig = rig_with_everything(seed)
    rng = np.random.default_rng([seed, 1])
    reading = rng.uniform(0.6, 2.5, 30)
    pose = c2_pose(rig, reading)
    normal, centre = pose[:, :3, 0], pose[:, :3, 3]
    x, y = rng.uniform(-0.5, 0.5, (2, 30))
    rays = np.column_stack([x, y, np.ones(30)])
    met = (normal * centre).sum(axis=1) / (normal * rays).sum(axis=1)
    np.testing.assert_allclose(met, depth(rig.theta, Gaze(x, y, reading, np.zeros(30))), rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_c2_turns_rigidly_about_the_axis_by_the_true_angle(seed: int) -> None:
    rig = rig_with_everything(seed)
    readings = np.array([0.9, 1.7])
    still = np.zeros(2)
    angle = np.diff(gaze_angle(rig.theta, Gaze(still, still, readings, still)))[0]
    first, second = c2_pose(rig, readings)
    fixed = frame(rig.theta)
    turn = rotation(angle * fixed.rotation[:, 1])
    np.testing.assert_allclose(second[:3, :3], turn @ first[:3, :3], atol=1e-12)
    moved = fixed.point + turn @ (first[:3, 3] - fixed.point)
    np.testing.assert_allclose(second[:3, 3], moved, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_pose_is_a_rigid_right_handed_transform(seed: int) -> None:
    turn = c2_pose(rig_with_everything(seed), np.array([[1.0, 1.5], [1.8, 2.0]]))[..., :3, :3]
    np.testing.assert_allclose(
        turn @ turn.swapaxes(-1, -2), np.tile(np.eye(3), (2, 2, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turn), 1)


def test_untilted_rig_has_the_centre_and_the_axes_of_the_definition() -> None:
    rig = plain_rig(eccentricity_mm=5.0, axis_z_mm=-7.0)
    ahead = c2_pose(rig, np.array(np.pi / 2))
    np.testing.assert_allclose(ahead[:3, :3], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(ahead[:3, 3], [105.0, 3.0, 13.0])
    inward = c2_pose(rig, np.deg2rad(np.array(80.0)))
    np.testing.assert_allclose(inward[:3, 2], [-np.sin(np.deg2rad(10)), 0, np.cos(np.deg2rad(10))])


def test_positive_pitch_looks_up() -> None:
    rig = replace(plain_rig(), pitch_rad=0.1)
    np.testing.assert_allclose(c2_pose(rig, np.array(np.pi / 2))[1, 2], -np.sin(0.1))


@pytest.mark.parametrize("seed", range(5))
def test_yaw_axis_in_c2_is_the_axis_at_every_reading(seed: int) -> None:
    rig = rig_with_everything(seed)
    seen, fixed = yaw_axis_in_c2(rig), frame(rig.theta)
    assert abs(seen.direction @ seen.foot_mm) < 1e-10
    for pose in c2_pose(rig, np.array([0.8, 1.6, 2.2])):
        direction = pose[:3, :3] @ seen.direction
        foot = pose[:3, :3] @ seen.foot_mm + pose[:3, 3]
        np.testing.assert_allclose(direction, fixed.rotation[:, 1], atol=1e-12)
        off = np.cross(foot - fixed.point, direction)
        np.testing.assert_allclose(off, np.zeros(3), atol=1e-9)


def test_eccentricity_is_what_the_sweep_sees_of_the_axis_without_roll() -> None:
    rig = plain_rig(eccentricity_mm=6.5, axis_tilt_x_rad=0.05)
    assert yaw_axis_in_c2(rig).foot_mm[0] == pytest.approx(-6.5)


@pytest.mark.parametrize("model", sorted(MODELS))
def test_drawn_rig_moves_the_parameters_of_its_model_only(model: str) -> None:
    theta = draw_rig(np.random.default_rng(3), model=model).theta
    moved = {n for n, v in zip(NAMES, theta, strict=True) if v != 0}
    assert moved == {*MODELS[model].free, STANDOFF}


def test_models_of_one_seed_differ_in_nothing_else() -> None:
    base, offset = (
        draw_rig(np.random.default_rng(4), model=model) for model in ("base", "axis-offset")
    )
    np.testing.assert_array_equal(base.theta[:2], offset.theta[:2])
    np.testing.assert_array_equal(base.c2.distortion, offset.c2.distortion)
    assert base.noise == offset.noise


def test_drawn_parameters_follow_the_default_priors() -> None:
    count = 800
    rng = np.random.default_rng(5)
    thetas = np.array(
        [
            draw_rig(rng, model=model).theta
            for model in ("axis-tilt", "encoder")
            for _ in range(count)
        ]
    ).reshape(2, count, -1)
    for parameter in PARAMETERS:
        # The standoff is uniform, within its prior, in every model; no rig has an offset of rows.
        if parameter.prior_std is None or parameter.name in (STANDOFF, REFERENCE_OFFSET):
            continue
        drawn = thetas[:, :, INDEX[parameter.name]]
        drawn = drawn[np.abs(drawn).max(axis=1) > 0].ravel() / parameter.prior_std
        # Standard errors of mean and standard deviation of n normal draws, five of them.
        assert abs(drawn.mean()) < 5 / np.sqrt(len(drawn))
        assert abs(drawn.std() - 1) < 5 / np.sqrt(2 * len(drawn))


def test_fixed_parameters_are_kept_and_unknown_ones_refused() -> None:
    rng = np.random.default_rng(6)
    rig = draw_rig(rng, model="base", fixed={"baseline_mm": 123.0, "axis_z_mm": 9.0})
    assert rig.theta[INDEX["baseline_mm"]] == 123.0
    assert rig.theta[INDEX["axis_z_mm"]] == 9.0
    with pytest.raises(KeyError):
        draw_rig(rng, model="base", fixed={"baseline": 1.0})


def test_drawn_lenses_have_a_ray_for_every_pixel() -> None:
    rng = np.random.default_rng(7)
    for _ in range(100):
        camera = draw_rig(rng, model="base").c1
        width, height = camera.image_size
        border = np.array([[0, 0], [width, 0], [0, height], [width, height], [width / 2, 0]])
        # Raises EstimationError where the lens model folds back.
        assert np.isfinite(normalise(camera, border.astype(float))).all()
