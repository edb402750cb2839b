"""Views of a board by a wide lens with known truth: corners out to 75 degrees off the axis."""

from __future__ import annotations

import cv2
import lens_scenes as scenes
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, project

SIZE = (1280, 960)
COEFFICIENTS = (-0.02, 0.004, -0.002, 3e-4)
BOARD = scenes.BOARD
NEAR_MM, FAR_MM = 300, 900


def lens(half_field_deg: float = 75.0) -> Camera:
    """A lens that sees this far to the left and to the right."""
    f = SIZE[0] / 2 / np.deg2rad(half_field_deg)
    matrix = np.array([[f, 0, SIZE[0] / 2 + 3], [0, 1.002 * f, SIZE[1] / 2 - 4], [0, 0, 1]])
    return Camera(matrix, np.array(COEFFICIENTS), SIZE, "equidistant")


CAMERA = lens()


def views(
    count: int,
    rng: np.random.Generator,
    *,
    sigma_px: float = 0.1,
    camera: Camera = CAMERA,
    board: Board = BOARD,
    warp_mm: tuple[float, float] | None = None,
) -> Corners:
    """Noisy corners of boards that face the camera, tilted, all over its field."""
    half = min(SIZE[0] / 2 / camera.matrix[0, 0] * 1.1, np.deg2rad(80.0))
    points = scenes.deformed(board.object_points(), warp_mm)
    points = points - board.object_points().mean(axis=0)
    found: list[FloatArray] = []
    while len(found) < count:
        away, about = half * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        place = rng.uniform(NEAR_MM, FAR_MM) * np.array(
            [np.sin(away) * np.cos(about), np.sin(away) * np.sin(about), np.cos(away)]
        )
        facing = cv2.Rodrigues(away * np.array([-np.sin(about), np.cos(about), 0.0]))[0]
        moved = points @ (facing @ scenes.tilted(rng, high_deg=40)).T + place
        pixels = project(camera, moved)
        if np.isfinite(pixels).all() and (pixels > 5).all() and (pixels < np.array(SIZE) - 6).all():
            found.append(pixels)
    exact = np.array(found)
    return scenes.corners(exact + rng.normal(0, sigma_px, exact.shape), SIZE)
