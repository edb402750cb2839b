"""Poses of the board among which the next one is chosen.

They are such as a hand can show: every place of the picture, near and far, upright, tilted about
any axis. Each shows the whole board, with some room for a hand that does not fill the outline
exactly.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.board import Board
from calib.geometry.camera import Camera, project, radius_limit
from calib.geometry.poses import pose_matrix, pose_vector, rotation

FILLS: Final = (0.45, 0.85)
"""Shares of the picture, the tighter way, that the board's outer squares span."""

TILTS_DEG: Final = (20.0, 40.0)
DIRECTIONS: Final = 8
"""Tilts and the axes about which they are made. Beyond 45 degrees squares are so short that
detectors miss corners."""

ROOM: Final = 0.03
"""Share of the picture's width that outlines keep from its edge, for hands that miss them."""

REPEAT_SPACINGS: Final = 0.5
"""A pose that differs by less, root mean square in spacings of corners, is not asked for again; the
chain takes half of that for a repetition (`calib.images.repeats`)."""

EDGE_PX: Final = 8.0
"""Detectors want some white around the outer squares."""

THINNED: Final = (5, 4)
"""Columns and rows of corners by which poses are compared: a third of the time, the same order."""

_ROUNDS: Final = 4


def rim(board: Board) -> FloatArray:
    """Return the outline of the outer squares, mm, shape (8, 3): corners and middles of sides."""
    x = board.square_mm * np.array([-1.0, (board.columns - 1) / 2, board.columns])
    y = board.square_mm * np.array([-1.0, (board.rows - 1) / 2, board.rows])
    way = ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1))
    return np.array([[x[i], y[j], 0.0] for i, j in way])


def turns() -> FloatArray:
    """Return rotation vectors of boards facing a camera, rad, shape (n, 3): flat, then tilted."""
    about = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    axes = np.stack([np.cos(about), np.sin(about), np.zeros_like(about)], axis=-1)
    tilted = [np.radians(tilt) * axes for tilt in TILTS_DEG]
    return np.concatenate([np.zeros((1, 3)), *tilted])


def in_picture(camera: Camera, board: Board, *, fills: tuple[float, ...] = FILLS) -> FloatArray:
    """Return poses that show the whole board, camera from board, rad and mm, shape (n, 6).

    At each size and tilt nine places: the board moved as far as it goes to each side and corner of
    the picture, and its middle.
    """
    each = np.array([(f, t, i, j) for f in fills for t in range(len(turns()))
                     for i in (-1, 0, 1) for j in (-1, 0, 1)], dtype=float)  # fmt: skip
    vectors = turns()[each[:, 1].astype(int)]
    outline, middle = rim(board), rim(board).mean(axis=0)
    turned = np.array([(outline - middle) @ rotation(v).T for v in vectors])
    size = np.array(camera.image_size, dtype=float)
    room = ROOM * size[0]
    focal = np.diag(camera.matrix)[:2]
    span = np.ptp(outline[:, :2], axis=0)
    depth = np.max(span * focal / size) / each[:, 0]
    at = np.tile((size - 1) / 2, (len(each), 1))
    for _ in range(_ROUNDS):
        low, high = _box(camera, turned, _centre(camera, at, depth))
        growth = np.max((high - low) / size, axis=1) / each[:, 0]
        depth = depth * growth
        # About its middle the box shrinks as the board goes away.
        low, high = (
            (low + high) / 2 + side * (high - low) / growth[:, None] / 2 for side in (-1, 1)
        )
        # To either side as far as the picture goes, or into its middle.
        wanted = np.where(each[:, 2:] < 0, room - low, size - 1 - room - high)
        at = at + np.where(each[:, 2:] == 0, (size - 1 - low - high) / 2, wanted)
    centre = _centre(camera, at, depth)
    shift = centre - np.array([rotation(v) @ middle for v in vectors])
    poses = np.concatenate([vectors, shift], axis=1)
    return poses[seen_whole(camera, board, poses)]


def seen_whole(camera: Camera, board: Board, poses: FloatArray) -> BoolArray:
    """Return at which poses, camera from board, shape (n, 6), the whole board is in the picture."""
    points = placed(poses, rim(board))
    depth = points[..., 2]
    rays = points[..., :2] / np.where(depth > 0, depth, 1.0)[..., None]
    within = np.hypot(rays[..., 0], rays[..., 1]) < radius_limit(camera)
    pixels = project(camera, rays.reshape(-1, 2)).reshape(rays.shape)
    last = np.array(camera.image_size) - 1
    inside = ((pixels > EDGE_PX) & (pixels < last - EDGE_PX)).all(axis=-1)
    return np.asarray((inside & within & (depth > 0)).all(axis=1))


def thinned(board: Board) -> IntArray:
    """Return the places of corners that stand for all of them where poses are only compared."""
    columns = np.unique(np.linspace(0, board.columns - 1, THINNED[0]).round().astype(int))
    rows = np.unique(np.linspace(0, board.rows - 1, THINNED[1]).round().astype(int))
    places: IntArray = (rows[:, None] * board.columns + columns).ravel().astype(np.int64)
    return places


def placed(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Return board points, mm, shape (m, 3), at poses, shape (n, 6), in the camera: (n, m, 3)."""
    matrices = matrices_of(poses)
    found: FloatArray = points @ matrices[:, :3, :3].swapaxes(-1, -2) + matrices[:, None, :3, 3]
    return found


def repeats(shown: FloatArray, taken: FloatArray, board: Board) -> BoolArray:
    """Return which boards, px, shape (n, corners, 2), would nearly repeat a picture taken.

    Parameters
    ----------
    taken
        Corners, px, shape (v, corners, 2); NaN where not found.
    """
    found = np.zeros(len(shown), dtype=np.bool_)
    last = board.columns - 1
    spacing = np.linalg.norm(shown[:, last] - shown[:, 0], axis=-1) / last
    for view in taken:
        shift = np.sqrt(np.nanmean(np.sum((shown - view) ** 2, axis=-1), axis=-1))
        found |= shift < REPEAT_SPACINGS * spacing
    return found


def matrices_of(poses: FloatArray) -> FloatArray:
    """Return poses, shape (n, 6), as homogeneous matrices, shape (n, 4, 4)."""
    found = np.tile(np.eye(4), (len(poses), 1, 1))
    found[:, :3, :3] = np.array([rotation(pose[:3]) for pose in poses]).reshape(-1, 3, 3)
    found[:, :3, 3] = poses[:, 3:]
    return found


def _centre(camera: Camera, at: FloatArray, depth: FloatArray) -> FloatArray:
    """Return points about where pixels, (n, 2), are seen, at a depth, mm, shape (n, 3).

    Without distortion: where they are truly seen is told by the box, round by round.
    """
    rays = (at - camera.matrix[:2, 2]) / np.diag(camera.matrix)[:2]
    points: FloatArray = depth[:, None] * np.concatenate([rays, np.ones((len(at), 1))], axis=1)
    return points


def _box(camera: Camera, turned: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the boxes around boards in the picture, px, shape (n, 2) each."""
    points = turned + centre[:, None]
    points[..., 2] = np.maximum(points[..., 2], 1.0)
    pixels = project(camera, points.reshape(-1, 3)).reshape(len(turned), -1, 2)
    return pixels.min(axis=1), pixels.max(axis=1)


def moved(by: FloatArray, poses: FloatArray) -> FloatArray:
    """Return poses, shape (n, 6), seen through a rigid transform, shape (4, 4)."""
    seen = by @ matrices_of(poses)
    return np.array([pose_vector(m) for m in seen]).reshape(-1, 6)


def back(pose: FloatArray) -> FloatArray:
    """Return the inverse of a pose, shape (6,), as a matrix, shape (4, 4)."""
    return np.asarray(np.linalg.inv(pose_matrix(pose)), dtype=np.float64)
