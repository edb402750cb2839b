"""Evidence: property. What the scene promises, by OpenCV's projection and the rig's pose."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.geometry.board import Board
from calib.geometry.plane import gaze_at
from calib.simulate import scene
from calib.simulate.rig import TrueRig, c2_pose, draw_rig
from calib.simulate.scene import (
    IntrinsicViews,
    SweepPlan,
    draw_gaze_poses,
    draw_intrinsic_views,
    draw_sweep,
    fitting_board,
    held_reading,
    invert,
    rotation,
    target_in_c1,
    whole_board_seen,
)

SEEDS = range(6)


def rig_of(seed: int) -> tuple[TrueRig, Board]:
    rig = draw_rig(np.random.default_rng(seed), model="encoder")
    return rig, fitting_board(rig, near_mm=rig.depth_range_mm[0])


def corners_inside(rig: TrueRig, board: Board, poses: np.ndarray, name: str) -> bool:
    """Whether OpenCV projects every inner corner into the image, at every pose."""
    camera = getattr(rig, name)
    size = np.array(camera.image_size) - 1
    for pose in poses:
        turn = cv2.Rodrigues(pose[:3, :3])[0]
        pixels, _ = cv2.projectPoints(
            board.object_points(), turn, pose[:3, 3], camera.matrix, camera.distortion
        )
        if not ((pixels > 0) & (pixels < size)).all():
            return False
    return True


@pytest.mark.parametrize("seed", SEEDS)
def test_intrinsic_views_show_the_board_and_fill_the_imager(seed: int) -> None:
    rig, board = rig_of(seed)
    plan = IntrinsicViews(count=20, tilt_deg=(10.0, 40.0))
    poses = draw_intrinsic_views(rig.c1, board, np.random.default_rng(seed), plan)
    assert poses.shape == (20, 4, 4)
    assert corners_inside(rig, board, poses, "c1")
    tilt = np.degrees(np.arccos(poses[:, 2, 2]))
    assert tilt.min() > 9.99
    assert tilt.max() < 40.01
    reached = np.zeros((4, 4), dtype=bool)
    for pose in poses:
        turn = cv2.Rodrigues(pose[:3, :3])[0]
        pixels, _ = cv2.projectPoints(
            board.object_points(), turn, pose[:3, 3], rig.c1.matrix, rig.c1.distortion
        )
        column, row = (pixels[:, 0] / rig.c1.image_size * 4).astype(int).T
        reached[row, column] = True
    assert reached.all()


def test_controls_hold_the_board_parallel_or_in_one_place() -> None:
    rig, board = rig_of(0)
    rng = np.random.default_rng(0)
    flat = draw_intrinsic_views(rig.c1, board, rng, IntrinsicViews(count=8, tilt_deg=(0.0, 0.0)))
    np.testing.assert_allclose(flat[:, 2, 2], 1)
    same = draw_intrinsic_views(rig.c1, board, rng, IntrinsicViews(count=8, one_place=True))
    assert np.ptp(same[:, :3, 3], axis=0).max() < board.square_mm / 2
    assert len(np.unique(same[:, 0, 3])) == 8


@pytest.mark.parametrize("seed", SEEDS)
def test_gazed_boards_are_seen_by_both_cameras(seed: int) -> None:
    rig, board = rig_of(seed)
    near, far = rig.depth_range_mm
    held = held_reading(rig, (near, far))
    poses = draw_gaze_poses(
        rig,
        board,
        np.random.default_rng(seed),
        count=10,
        depth_range_mm=(near, far),
        held=held,
    )
    targets = target_in_c1(board, poses)
    np.testing.assert_array_equal(
        np.floor((targets[:, 2] - near) / (far - near) * 10), np.arange(10)
    )
    reading = gaze_at(rig.theta, targets).alpha2
    assert corners_inside(rig, board, poses, "c1")
    assert corners_inside(rig, board, invert(c2_pose(rig, reading)) @ poses, "c2")
    assert corners_inside(rig, board, invert(c2_pose(rig, np.full(10, held))) @ poses, "c2")


@pytest.mark.parametrize("seed", SEEDS)
def test_sweep_turns_as_far_as_the_board_stays_in_view(seed: int) -> None:
    rig, board = rig_of(seed)
    plan = SweepPlan(placements=3, images=9)
    placements = draw_sweep(rig, board, np.random.default_rng(seed), plan)
    assert len(placements) == 3
    for placement in placements:
        counts = placement.readings / rig.resolution_rad
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
        in_c2 = invert(c2_pose(rig, placement.readings)) @ placement.pose
        assert corners_inside(rig, board, in_c2, "c2")
        # A degree further the board is cut.
        beyond = placement.readings[[0, -1]] + np.deg2rad([-1.0, 1.0])
        outside = invert(c2_pose(rig, beyond)) @ placement.pose
        assert not whole_board_seen(rig.c2, board, outside).any()


def test_sweep_is_as_narrow_as_asked() -> None:
    rig, board = rig_of(1)
    plan = SweepPlan(placements=1, images=5, half_range_deg=1.0)
    (placement,) = draw_sweep(rig, board, np.random.default_rng(1), plan)
    span = np.degrees(np.ptp(placement.readings))
    assert span == pytest.approx(2.0, abs=2 * np.degrees(rig.resolution_rad))
    assert draw_sweep(rig, board, np.random.default_rng(1), SweepPlan(placements=0)) == ()


def test_board_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "_TRIES", 400)
    monkeypatch.setattr(scene, "_TRIES_PER_POSE", 10)
    rig, _ = rig_of(2)
    near, far = rig.depth_range_mm
    large = Board("chessboard", 9, 7, near, (4, 3))
    with pytest.raises(UsageError, match="smaller squares"):
        draw_gaze_poses(
            rig,
            large,
            np.random.default_rng(0),
            count=2,
            depth_range_mm=(near, far),
            held=None,
        )
    tall = Board("chessboard", 5, 40, 30.0, (2, 20))
    with pytest.raises(UsageError, match="hardly fits"):
        draw_intrinsic_views(rig.c1, tall, np.random.default_rng(0), IntrinsicViews())
    with pytest.raises(UsageError, match="fewer rows"):
        draw_sweep(rig, tall, np.random.default_rng(0), SweepPlan())


def test_rotation_equals_opencvs() -> None:
    vector = np.array([0.3, -1.2, 0.4])
    np.testing.assert_allclose(rotation(vector), cv2.Rodrigues(vector)[0], atol=1e-14)
    np.testing.assert_array_equal(rotation(np.zeros(3)), np.eye(3))


def test_inverse_of_poses() -> None:
    rig, _ = rig_of(3)
    poses = c2_pose(rig, np.array([1.0, 1.5, 2.0]))
    np.testing.assert_allclose(invert(poses) @ poses, np.tile(np.eye(4), (3, 1, 1)), atol=1e-12)
