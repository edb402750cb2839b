"""Pose of a board in one picture of a wide lens."""

from __future__ import annotations

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.camera import Camera, normalise, project_points
from calib.geometry.poses import (
    pose_matrix,
    pose_vector,
    rotation,
    transform,
    transformed_by_pose,
)
from calib.images.bundle import Block, finite, minimise

_FEWEST = 4
"""Corners that determine the pose of a flat board."""

_COSINE_MIN = 0.05
"""Of a ray and the mean ray: a board fills less than half of all directions."""


def wide_view_pose(camera: Camera, *, points: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the pose camera from board, rad and mm, shape (6,).

    The one that minimises the squares of the residuals in the picture, started from `first_pose`.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    pixels
        Shape (corners, 2), finite.

    Raises
    ------
    EstimationError
        If the lens has rays for fewer than four corners.
    """
    pose = first_pose(camera, points=points, pixels=pixels)

    def evaluate(pose: FloatArray) -> list[Block]:
        view = project_points(camera, transform(pose, points))
        jacobian = view.by_point @ transformed_by_pose(pose, points)
        return [Block((view.pixels - pixels).ravel(), jacobian.reshape(-1, 6), np.arange(6))]

    try:
        return minimise(evaluate, pose).x
    except EstimationError:
        return pose


def first_pose(camera: Camera, *, points: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the pose by a pinhole camera that looks at the middle of the board.

    No ray is far off its axis. Parameters and errors as of `wide_view_pose`.
    """
    xy = normalise(camera, pixels, strict=False)
    seen = finite(xy)
    rays = np.concatenate([xy[seen], np.ones((int(seen.sum()), 1))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    turned, back = _towards_axis(rays)
    near = turned[:, 2] > _COSINE_MIN
    if near.sum() < _FEWEST:
        raise EstimationError(
            f"the lens has rays for {int(near.sum())} of {len(pixels)} corners of a board: it is "
            "another lens, or the board is miscounted"
        )
    flat = turned[near, :2] / turned[near, 2:]
    _, turn, shift = cv2.solvePnP(points[seen][near], flat, np.eye(3), None)
    return pose_vector(back @ pose_matrix(np.concatenate([turn.ravel(), shift.ravel()])))


def _towards_axis(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit rays, (n, 3), turned until their mean is the axis, and the way back, (4, 4)."""
    x, y, z = rays.mean(axis=0)
    across = np.hypot(x, y)
    turn = np.eye(3)
    if across > 0:
        turn = rotation(np.arctan2(across, z) / across * np.array([y, -x, 0.0]))
    back = np.eye(4)
    back[:3, :3] = turn.T
    return rays @ turn.T, back
