"""Pairs of board images: single-view poses, and which way round each board was read.

A board with an even number of inner corners both ways, or an odd number both ways, looks the same
after half a turn, so a detector may start it at either end. Within a pair both cameras must agree.
The pose of C2 in C1 tells: it is the same in every pair only if they do.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, project_points
from calib.geometry.poses import pose_matrix, pose_vector, transform
from calib.images.bundle import finite
from calib.images.checks import require_board
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.wide_view import wide_view_pose

MIN_PAIRS = 3
"""Pairs needed: the poses of two could agree by chance, that of a third checks them."""

_FAR = 0.5
_UPRIGHT = 1e-3


@dataclass(frozen=True)
class PairStart:
    """Where a stereo solve starts.

    Parameters
    ----------
    pairs
        Places of the pairs that can be used, shape (n,).
    pixels
        Corners in C1 and in C2, in one order, px, shape (2, n, corners, 2).
    turned
        Pairs in which C2's corners were put into reverse order, shape (n,).
    pose_12
        Pose of C2 in C1, rotation vector (rad) and translation (mm), shape (6,).
    poses
        C1 from board, shape (n, 6).
    """

    pairs: IntArray
    pixels: FloatArray
    turned: BoolArray
    pose_12: FloatArray
    poses: FloatArray

    def keep(self, chosen: BoolArray) -> PairStart:
        """Return the start of some of the pairs only, shape (n,)."""
        return PairStart(
            pairs=self.pairs[chosen],
            pixels=self.pixels[:, chosen],
            turned=self.turned[chosen],
            pose_12=self.pose_12,
            poses=self.poses[chosen],
        )


def half_turn_looks_same(board: Board) -> bool:
    """Return whether the board's corners can be read from either end."""
    return board.type == "chessboard" and (board.columns + board.rows) % 2 == 0


def single_view_pose(
    camera: Camera, *, points: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, float]:
    """Return the pose camera from board, shape (6,), of one view and its rms, px, per coordinate.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    pixels
        Shape (corners, 2), NaN where not found; `MIN_CORNERS` at least must be there.
    """
    seen = finite(pixels)
    points = points[seen]
    if camera.projection == "perspective":
        lens = camera.distortion if len(camera.distortion) else None
        _, turn, shift = cv2.solvePnP(points, pixels[seen], camera.matrix, lens)
        pose = np.concatenate([turn.ravel(), shift.ravel()])
    else:
        pose = wide_view_pose(camera, points=points, pixels=pixels[seen])
    residuals = project_points(camera, transform(pose, points)).pixels - pixels[seen]
    return pose, float(np.sqrt(np.mean(residuals**2)))


def start_pairs(
    corners: tuple[Corners, Corners], board: Board, *, cameras: tuple[Camera, Camera]
) -> PairStart:
    """Return poses to start from, and corners of both cameras in one order.

    Parameters
    ----------
    corners
        Of C1 and C2; view i of both is pair i.
    cameras
        C1 and C2.

    Raises
    ------
    EstimationError
        If fewer than `MIN_PAIRS` pairs show the board in both images, or what they show is no
        board of the stated size.
    """
    pixels = np.stack([c.pixels for c in corners])
    enough = finite(pixels).sum(axis=-1) >= MIN_CORNERS
    pairs = np.flatnonzero(enough.all(axis=0))
    if len(pairs) < MIN_PAIRS:
        raise EstimationError(
            f"stereo: {len(pairs)} pairs show the board in both images and {MIN_PAIRS} are needed; "
            "take more pairs, with the whole board in view of both cameras"
        )
    pixels = pixels[:, pairs]
    poses, errors = _single_views(cameras, board, pixels)
    for camera, missed in zip(("C1", "C2"), errors, strict=True):
        require_board(board, missed, where=f"stereo, {camera}")
    pose_12, turned = _agree(poses, board)
    pixels[1, turned] = pixels[1, turned, ::-1]
    return PairStart(pairs, pixels, turned, pose_12, poses[0])


def _single_views(
    cameras: tuple[Camera, Camera], board: Board, pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return poses, shape (2, n, 6), and rms, px, shape (2, n), of each view by itself."""
    poses = np.empty((*pixels.shape[:2], 6))
    errors = np.empty(pixels.shape[:2])
    points = board.object_points()
    for c, camera in enumerate(cameras):
        for i, view in enumerate(pixels[c]):
            poses[c, i], errors[c, i] = single_view_pose(camera, points=points, pixels=view)
    return poses, errors


def _agree(poses: FloatArray, board: Board) -> tuple[FloatArray, BoolArray]:
    """Return the pose of C2 in C1 that most pairs support, (6,), and the pairs to turn, (n,).

    Every pair proposes its own pose, and where the board may be read from either end a second one.
    The proposal nearest to the nearest ones of all pairs wins; of two as near, which a rig with
    all boards turned would yield, the one with the cameras less rolled against each other.
    """
    turns = [np.eye(4)]
    if half_turn_looks_same(board):
        half = np.diag([-1.0, -1.0, 1.0, 1.0])
        half[:3, 3] = board.object_points()[-1]
        turns.append(half)
    # Shape (pairs, turns, 4, 4): C1 from C2 by way of the board, read either way in C2.
    proposals = np.array(
        [
            [pose_matrix(one) @ np.linalg.inv(pose_matrix(two) @ turn) for turn in turns]
            for one, two in zip(*poses, strict=True)
        ]
    )
    depth = float(np.median(poses[:, :, 5]))
    flat = proposals.reshape(-1, 4, 4)
    distance = np.array([_distances(one, proposals, depth) for one in flat])
    away = np.minimum(distance.min(axis=-1), _FAR).sum(axis=-1)
    best = int(np.argmin(away + _UPRIGHT * np.array([_angle(m[:3, :3]) for m in flat])))
    return pose_vector(flat[best]), distance[best].argmin(axis=-1) == 1


def _distances(one: FloatArray, proposals: FloatArray, depth: float) -> FloatArray:
    """Return how far proposals, (n, k, 4, 4), are from one: angle plus shift as seen at `depth`."""
    relative = np.einsum("ba,nkbc->nkac", one[:3, :3], proposals[..., :3, :3])
    cosine = (np.trace(relative, axis1=-2, axis2=-1) - 1) / 2
    shift = np.linalg.norm(proposals[..., :3, 3] - one[:3, 3], axis=-1)
    distance: FloatArray = np.arccos(np.clip(cosine, -1, 1)) + shift / depth
    return distance


def _angle(matrix: FloatArray) -> float:
    return float(np.arccos(np.clip((np.trace(matrix) - 1) / 2, -1, 1)))
