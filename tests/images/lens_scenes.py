"""Views of a board with known truth, for the tests of detection and intrinsics."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, project
from calib.images.bundle import deformed

BOARD = Board("chessboard", 9, 6, 25.0, (4, 3))
SIZE = (640, 480)
CAMERA = Camera(
    np.array([[540.0, 0, 322.3], [0, 541.5, 236.8], [0, 0, 1]]),
    np.array([-0.25, 0.08, 8e-4, -5e-4, -0.01]),
    SIZE,
)
MARGIN_SQUARES = 1.9
"""The whole sheet must be in view: an outer square and its rim."""

Draw = Callable[[np.random.Generator], FloatArray]


def tilted(rng: np.random.Generator, *, low_deg: float = 5, high_deg: float = 35) -> FloatArray:
    """A rotation: tilt in any direction, then roll within 20 deg."""
    around, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(low_deg, high_deg))
    axis = np.array([np.cos(around), np.sin(around), 0]) * tilt
    roll = np.array([0, 0, np.radians(rng.uniform(-20, 20))])
    return cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(roll)[0]


def anywhere(rng: np.random.Generator) -> FloatArray:
    return np.array([rng.uniform(-220, 220), rng.uniform(-170, 170), rng.uniform(380, 750)])


def poses(
    count: int,
    rng: np.random.Generator,
    *,
    camera: Camera = CAMERA,
    board: Board = BOARD,
    turn: Draw = tilted,
    place: Draw = anywhere,
) -> list[FloatArray]:
    """Poses, (4, 4), camera from board, with the whole sheet in the picture."""
    middle = board.object_points().mean(axis=0)
    low, high = -MARGIN_SQUARES, np.array([board.columns, board.rows]) - 1 + MARGIN_SQUARES
    rim = board.square_mm * np.array(
        [[low, low, 0], [high[0], low, 0], [low, high[1], 0], [high[0], high[1], 0]]
    )
    found: list[FloatArray] = []
    while len(found) < count:
        rotation = turn(rng)
        shift = place(rng) - rotation @ middle
        pixels = project(camera, rim @ rotation.T + shift)
        size = np.array(camera.image_size)
        if np.isfinite(pixels).all() and (pixels > 0).all() and (pixels < size - 1).all():
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, shift
            found.append(pose)
    return found


def seen_by(
    camera: Camera, pose: FloatArray, board: Board, warp_mm: tuple[float, float] | None = None
) -> FloatArray:
    """Exact corners of a board, px, shape (corners, 2)."""
    points = deformed(board.object_points(), warp_mm)
    return project(camera, points @ pose[:3, :3].T + pose[:3, 3])


def corners(pixels: FloatArray, image_size: tuple[int, int] = SIZE) -> Corners:
    names = tuple(f"{i:02d}.png" for i in range(len(pixels)))
    who = tuple("cascade:classic" if np.isfinite(view).any() else "none" for view in pixels)
    return Corners(names, pixels, who, image_size)


def views(
    count: int,
    rng: np.random.Generator,
    *,
    sigma_px: float = 0.05,
    camera: Camera = CAMERA,
    board: Board = BOARD,
    turn: Draw = tilted,
    place: Draw = anywhere,
    warp_mm: tuple[float, float] | None = None,
) -> Corners:
    """Noisy corners of a board held here and there."""
    held = poses(count, rng, camera=camera, board=board, turn=turn, place=place)
    exact = np.array([seen_by(camera, pose, board, warp_mm) for pose in held])
    return corners(exact + rng.normal(0, sigma_px, exact.shape), camera.image_size)
