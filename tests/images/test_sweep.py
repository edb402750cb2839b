"""The yaw sweep. Evidence: simulated truth (rigs of `calib.simulate.rig`, whose geometry is coded
apart from the sweep's), with coverage by repetition; jacobians; negative controls."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle, islice

import board_scenes as scenes
import numpy as np
import pytest
from sweep_scenes import (
    LENS_STD,
    NARROW,
    SIGMA_PX,
    WIDE,
    drawn_rig,
    solve,
    true_values,
)

from calib.core.arrays import FloatArray
from calib.geometry.board import Corners
from calib.geometry.parameters import INDEX
from calib.geometry.poses import pose_vector
from calib.images.bundle import sum_blocks
from calib.images.sweep.model import AXIS, ENCODER, SweepProblem, blocks_of, residuals_of
from calib.images.sweep.solve import SweepReadings, solve_sweep
from calib.images.sweep.yaw_axis import NAMES, yaw_sweep
from calib.simulate.rig import c2_pose, draw_rig, yaw_axis_in_c2


def test_exact_images_give_the_exact_axis() -> None:
    rng = np.random.default_rng(0)
    rig = replace(drawn_rig(rng), resolution_rad=1e-9)
    result = solve(
        rng, rig, sigma_px=1e-6, lens_std=np.zeros(9), readings=np.deg2rad(np.linspace(60, 120, 25))
    )
    axis = yaw_axis_in_c2(rig)
    # All by least squares from the same exact corners: what is left is of the order of the
    # 1e-6 px put in, against 0.2 mm at 0.1 px.
    assert result.axis_direction_c2 == pytest.approx(axis.direction, abs=1e-8)
    assert result.axis_foot_c2_mm == pytest.approx(axis.foot_mm, abs=1e-4)
    assert result.names == NAMES
    assert result.mean == pytest.approx(true_values(rig, NAMES), abs=1e-4)
    assert result.eccentricity_mm == pytest.approx(rig.theta[INDEX["eccentricity_mm"]], abs=1e-4)
    assert result.gaze_roll_rad == pytest.approx(rig.theta[INDEX["gaze_roll_rad"]], abs=1e-8)
    # The height of C1 above the foot matters with a rolled C2 alone; without 1T2 it is uncertain.
    assert rig.height_mm != 0


def test_height_of_c1_enters_by_the_roll() -> None:
    rng = np.random.default_rng(1)
    rig = replace(
        draw_rig(rng, model="axis-tilt", fixed={"gaze_roll_rad": 0.03}),
        height_mm=25.0,
        resolution_rad=1e-9,
    )
    scene = scenes.sweep(rng, rig, readings=WIDE)
    shown = SweepReadings(scene.alpha2_rad, scene.placements, 0.0, 0.0)
    arguments = {"camera": rig.c2, "covariance": np.zeros((9, 9))}
    pose_12 = pose_vector(c2_pose(rig, np.array(1.4)))
    found = scenes.noisy(rng, scene.found, 1e-5)
    known = yaw_sweep(found, shown, scenes.BOARD, **arguments, pose_12=pose_12)
    alone = yaw_sweep(found, shown, scenes.BOARD, **arguments)
    e = rig.theta[INDEX["eccentricity_mm"]]
    assert known.eccentricity_mm == pytest.approx(e, abs=1e-3)
    height = -rig.mount_mm @ yaw_axis_in_c2(rig).direction  # from the foot to C1's plane Y = 0
    assert height == pytest.approx(-25.0, abs=2.0)
    assert alone.eccentricity_mm - e == pytest.approx(height * np.sin(0.03), abs=1e-3)
    assert alone.eccentricity_std_mm == pytest.approx(20.0 * np.sin(0.03), rel=0.01)


def test_a_rolled_camera_at_unknown_height_is_told_so() -> None:
    rng = np.random.default_rng(1)
    drawn = draw_rig(rng, model="axis-tilt", fixed={"gaze_roll_rad": 0.09})
    rig = replace(drawn, resolution_rad=1e-9)
    scene = scenes.sweep(rng, rig, readings=WIDE)
    shown = SweepReadings(scene.alpha2_rad, scene.placements, 0.0, 0.0)
    found = scenes.noisy(rng, scene.found, 1e-3)
    alone = yaw_sweep(found, shown, scenes.BOARD, camera=rig.c2, covariance=np.zeros((9, 9)))
    (failed,) = (gate for gate in alone.gates if not gate.passed)
    assert failed.name == "sweep-eccentricity"
    assert "rolled by 5.2 deg against its yaw axis" in failed.detail
    assert "sweep further" not in failed.detail


def test_jacobian_agrees_with_differences() -> None:
    rng = np.random.default_rng(2)
    rig = drawn_rig(rng)
    scene = scenes.sweep(rng, rig, readings=WIDE[::4])
    terms = len(ENCODER)
    problem = SweepProblem(
        points=scenes.BOARD.object_points(),
        pixels=scene.found.pixels,
        readings_rad=scene.alpha2_rad,
        placement=np.repeat([0, 1], 5),
        camera=rig.c2,
        intrinsics_root=np.diag(LENS_STD),
        turn_std_rad=3e-4,
        sigma_px=0.5,
        foot_std_mm=100.0,
        encoder_prior=tuple(islice(cycle(((0.0, 0.01), (0.001, 0.002), (0.0, np.inf))), terms)),
    )
    x = np.zeros(problem.size)
    x[:AXIS] = 0.03, -0.02, 4.0, -30.0
    x[AXIS : AXIS + terms] = np.linspace(0.01, -0.005, terms)
    x[problem.at_intrinsics] = rng.normal(size=9)
    x[problem.at_turns] = rng.normal(size=10)
    for k in range(2):
        x[problem.at_pose(k)] = 0.2, -0.3, 0.1, -100.0, -80.0, 800.0

    def residuals(at: FloatArray) -> FloatArray:
        return np.concatenate([block.residuals for block in blocks_of(problem, at)])

    steps = np.full(problem.size, 1e-6)
    rows = np.cumsum([0, *(len(b.residuals) for b in blocks_of(problem, x))])
    jacobian = np.zeros((rows[-1], problem.size))
    for first, block in zip(rows, blocks_of(problem, x), strict=False):
        jacobian[first : first + len(block.residuals), block.columns] = block.jacobian
    for k, step in enumerate(steps):
        shift = step * np.eye(problem.size)[k]
        slope = (residuals(x + shift) - residuals(x - shift)) / (2 * step)
        assert slope == pytest.approx(
            jacobian[:, k], rel=1e-5, abs=1e-3 * max(1, np.abs(jacobian[:, k]).max() * 1e-3)
        )
    normal = sum_blocks(blocks_of(problem, x), problem.size)
    assert normal.matrix == pytest.approx(jacobian.T @ jacobian, rel=1e-9, abs=1e-6)
    observed = -residuals_of(problem, x)[np.isfinite(problem.pixels)] / problem.sigma_px
    assert residuals(x)[-len(observed) :] == pytest.approx(observed, abs=1e-9)


@pytest.mark.parametrize(
    ("readings", "runs", "limits"),
    [
        # The rms of 8 normal numbers lies within these but for 1 in 5,000 either side.
        pytest.param(WIDE, 8, (0.27, 1.94), id="wide, a few"),
        # The rms of 20 normal numbers: standard deviation 0.16.
        pytest.param(WIDE, 20, (0.6, 1.5), id="wide", marks=pytest.mark.slow),
        pytest.param(NARROW, 20, (0.6, 1.5), id="narrow", marks=pytest.mark.slow),
    ],
)
def test_stated_uncertainties_hold_over_rigs(
    readings: FloatArray, runs: int, limits: tuple[float, float]
) -> None:
    pulls = []
    for seed in range(runs):
        rng = np.random.default_rng(100 + seed)
        rig = drawn_rig(rng)
        result = solve(rng, rig, readings=readings)
        axis = yaw_axis_in_c2(rig)
        estimate = [
            result.eccentricity_mm,
            result.gaze_roll_rad,
            result.encoder_scale,
            *result.axis_foot_c2_mm[[0, 2]],
            result.axis_direction_c2[2],
        ]
        truth = [
            *true_values(rig, ("eccentricity_mm", "gaze_roll_rad", "encoder_scale")),
            *axis.foot_mm[[0, 2]],
            axis.direction[2],
        ]
        own = np.sqrt(np.diag(result.axis_covariance))
        stds = [
            result.eccentricity_std_mm,
            result.gaze_roll_std_rad,
            result.encoder_scale_std,
            *own[[2, 3]],
            own[1],
        ]
        pulls.append((np.array(estimate) - truth) / stds)
        failed = {g.name for g in result.gates if not g.passed}
        # A narrow sweep is honest about its uncertainty and is refused all the same.
        assert failed == set() if readings is WIDE else "sweep-span" in failed
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((rms > limits[0]) & (rms < limits[1])), rms


@pytest.mark.parametrize("stated_rad", [1e-3, 3e-4, 6e-5])
def test_images_tell_how_far_readings_err(stated_rad: float) -> None:
    """Readings rounded to 0.3 mrad, stated too large, right, and too small."""
    rng = np.random.default_rng(8)
    rig = replace(draw_rig(rng, model="axis-offset"), resolution_rad=3e-4)
    scene = scenes.sweep(rng, rig, readings=WIDE)
    solution = solve_sweep(
        scenes.noisy(rng, scene.found, SIGMA_PX),
        SweepReadings(scene.alpha2_rad, scene.placements, stated_rad, 0.0),
        scenes.BOARD,
        camera=rig.c2,
        covariance=np.zeros((9, 9)),
        warp_mm=None,
        priors={},
    )
    # Of 34 rounded readings; what is too large comes down to one standard error above.
    assert solution.problem.turn_std_rad == pytest.approx(3e-4 / np.sqrt(12), rel=0.35)


def test_two_degrees_leave_the_eccentricity_open() -> None:
    rng = np.random.default_rng(3)
    rig = drawn_rig(rng)
    wide = solve(rng, rig)
    narrow = solve(rng, rig, readings=NARROW)
    assert wide.eccentricity_std_mm < 0.4
    assert narrow.eccentricity_std_mm > 4 * wide.eccentricity_std_mm
    detail = {g.name: g.detail for g in narrow.gates if not g.passed}
    assert "2.0 deg" in detail["sweep-span"]
    assert "encoder_cos_rad" not in narrow.names


def test_once_per_turn_error_is_measured_where_the_sweep_is_wide() -> None:
    rng = np.random.default_rng(4)
    rig = replace(drawn_rig(rng), resolution_rad=float(np.deg2rad(0.005)))
    wide = solve(rng, rig, readings=np.deg2rad(np.linspace(50, 130, 33)))
    assert wide.names == NAMES
    error = wide.mean - true_values(rig, NAMES)
    assert error @ np.linalg.solve(wide.covariance, error) < 20.5  # 0.999 of chi squared, 5
    assert "encoder_cos_rad" not in solve(rng, rig).names


def test_stated_prior_of_the_encoder_is_used() -> None:
    rng = np.random.default_rng(5)
    rig = replace(drawn_rig(rng), resolution_rad=1e-4)
    scene = scenes.sweep(rng, rig, readings=WIDE)
    shown = SweepReadings(scene.alpha2_rad, scene.placements, rig.resolution_rad, 0.0)
    found = scenes.noisy(rng, scene.found, SIGMA_PX)
    arguments = {"camera": rig.c2, "covariance": np.diag(LENS_STD**2)}
    default = yaw_sweep(found, shown, scenes.BOARD, **arguments)
    exact = {"encoder_cos_rad": (float(rig.theta[INDEX["encoder_cos_rad"]]), 1e-6)}
    known = yaw_sweep(found, shown, scenes.BOARD, **arguments, priors=exact)
    # Near 90 degrees the cosine term is scale again: its prior of 1.75 mrad widens the scale.
    assert default.encoder_scale_std > np.deg2rad(0.1) * 0.9
    assert known.encoder_scale_std < 0.5 * default.encoder_scale_std


def test_outliers_and_boards_read_from_the_other_end() -> None:
    rng = np.random.default_rng(6)
    board = replace(scenes.BOARD, columns=8)

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        found.pixels[3, 10] += 6.0
        for view in (5, 20, 21):
            found.pixels[view] = found.pixels[view, ::-1]
        found.pixels[8] = np.nan
        found.pixels[9, :20] = np.nan
        return found, shown

    rig = drawn_rig(rng)
    result = solve(rng, rig, board=board, edit=edit)
    assert len(result.images) == 33
    assert result.rejected == 1
    assert np.isnan(result.residuals[3, 10]).all()
    assert result.sigma_px == pytest.approx(SIGMA_PX, rel=0.06)  # 3000 residuals: 1.3 %
    error = result.mean - true_values(rig, result.names)
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(result.covariance)))
    assert result.poses.shape == (2, 6)
    assert result.reading_errors_rad.shape == (33,)


# Negative controls: each is recognised and named.
