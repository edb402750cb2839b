"""Scenes of boards with known truth, for the tests of the image stages: corners, no pictures."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.images.bundle import deformed
from calib.simulate.rig import TrueRig, c2_pose

BOARD = Board("chessboard", 9, 6, 30.0, (4, 3))

C1 = Camera(
    np.array([[820.0, 0, 643], [0, 822, 476], [0, 0, 1]]),
    np.array([-0.21, 0.08, 3e-4, -2e-4, -0.01]),
    (1280, 960),
)
C2 = Camera(
    np.array([[836.0, 0, 634], [0, 835, 489], [0, 0, 1]]),
    np.array([-0.2, 0.07, -3e-4, 1e-4, -0.008]),
    (1280, 960),
)
POSE_12 = np.array([0.02, -0.12, 0.015, 150.0, 4.0, -9.0])


def matrix(pose: FloatArray) -> FloatArray:
    result = np.eye(4)
    result[:3, :3] = cv2.Rodrigues(np.asarray(pose[:3], dtype=float))[0]
    result[:3, 3] = pose[3:]
    return result


def project(camera: Camera, points: FloatArray) -> FloatArray:
    """Pixels, with NaN where a point is off the imager."""
    still = np.zeros(3)
    by = cv2.fisheye if camera.projection == "equidistant" else cv2
    pixels = by.projectPoints(points[None], still, still, camera.matrix, camera.distortion)[0]
    pixels = pixels.reshape(-1, 2)
    width, height = camera.image_size
    inside = ((pixels > 0) & (pixels < [width - 1, height - 1])).all(axis=-1) & (points[:, 2] > 0)
    pixels[~inside] = np.nan
    return pixels


def board_pose(
    rng: np.random.Generator,
    board: Board,
    *,
    depth: tuple[float, float],
    tilt: float,
    spread: float,
) -> FloatArray:
    """A board before the camera, tilted up to `tilt` rad, its middle off the axis by `spread`."""
    turn = rng.uniform(-tilt, tilt, 3)
    z = rng.uniform(*depth)
    middle = np.array([*(rng.uniform(-spread, spread, 2) * z), z])
    rotation = cv2.Rodrigues(turn)[0]
    shift = middle - rotation @ board.object_points().mean(axis=0)
    return np.concatenate([turn, shift])


def corners(camera: Camera, pixels: list[FloatArray]) -> Corners:
    names = tuple(f"{i:02d}.png" for i in range(len(pixels)))
    return Corners(names, np.array(pixels), ("cache",) * len(names), camera.image_size)


@dataclass(frozen=True)
class Pairs:
    """Exact corners of pairs, and the board poses behind them."""

    c1: Corners
    c2: Corners
    poses: FloatArray
    pose_12: FloatArray


def pairs(
    rng: np.random.Generator,
    count: int,
    *,
    cameras: tuple[Camera, Camera] = (C1, C2),
    pose_12: FloatArray = POSE_12,
    board: Board = BOARD,
    warp_mm: tuple[float, float] | None = None,
) -> Pairs:
    """Boards spread over the view of C1; C2 sees what it sees."""
    points = deformed(board.object_points(), warp_mm)
    back = np.linalg.inv(matrix(pose_12))
    one, two, poses = [], [], []
    while len(one) < count:
        pose = board_pose(rng, board, depth=(450, 1100), tilt=0.6, spread=0.35)
        at_c1 = points @ matrix(pose)[:3, :3].T + pose[3:]
        first = project(cameras[0], at_c1)
        second = project(cameras[1], at_c1 @ back[:3, :3].T + back[:3, 3])
        if np.isfinite(first).all() and np.isfinite(second).all():
            one.append(first)
            two.append(second)
            poses.append(pose)
    return Pairs(corners(cameras[0], one), corners(cameras[1], two), np.array(poses), pose_12)


def noisy(rng: np.random.Generator, found: Corners, sigma_px: float) -> Corners:
    pixels = found.pixels + rng.normal(0, sigma_px, found.pixels.shape)
    return Corners(found.images, pixels, found.detector, found.image_size)


@dataclass(frozen=True)
class Sweep:
    """Exact corners of a sweep, the readings that the encoder shows, the placements."""

    found: Corners
    alpha2_rad: FloatArray
    placements: tuple[str, ...]


def sweep(
    rng: np.random.Generator,
    rig: TrueRig,
    *,
    readings: FloatArray,
    depths: tuple[float, ...] = (700.0, 1000.0),
    board: Board = BOARD,
) -> Sweep:
    """C2 of a rig turns before boards at rest; the encoder rounds to its counts."""
    pixels, shown, placements = [], [], []
    ahead = c2_pose(rig, np.array(float(np.mean(readings))))
    for k, depth in enumerate(depths):
        local = board_pose(rng, board, depth=(depth, depth), tilt=0.4, spread=0.02)
        world = ahead @ matrix(local)
        points = board.object_points() @ world[:3, :3].T + world[:3, 3]
        for reading in readings:
            count = np.round(reading / rig.resolution_rad) * rig.resolution_rad
            actual = count + rng.uniform(-0.5, 0.5) * rig.resolution_rad
            back = np.linalg.inv(c2_pose(rig, np.array(actual)))
            pixels.append(project(rig.c2, points @ back[:3, :3].T + back[:3, 3]))
            shown.append(count)
            placements.append(f"p{k}")
    return Sweep(corners(rig.c2, pixels), np.array(shown), tuple(placements))
