"""Points seen by both cameras, and by C1 as part of a board, with all their uncertainties.

Frame C1, mm. The error of a position is ``own + by_shared @ common``: `own` comes from the corners
of that pair, `common` is the error of what all pairs share: intrinsics of C1, intrinsics of C2, the
pose of C2 in C1 (rotation vector, rad, and translation, mm), in this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board
from calib.geometry.camera import Camera, intrinsic_names, normalise, project_points
from calib.geometry.poses import rotated_by_vector, rotation, transform, transformed_by_pose
from calib.images.bundle import deformed, finite, inverse
from calib.images.pairs import single_view_pose

POSE_NAMES = ("r12.x", "r12.y", "r12.z", "t12.x", "t12.y", "t12.z")
"""Names of the pose of C2 in C1: rotation vector, rad, and translation, mm."""

_NEWTON_STEPS = 5


@dataclass(frozen=True)
class PairPositions:
    """Positions of one point a pair.

    Parameters
    ----------
    position_mm
        Shape (n, 3).
    covariance
        Of the pair's own errors, mm^2, shape (n, 3, 3).
    by_shared
        Derivative by the shared quantities, shape (n, 3, s).
    miss_px
        Root mean square over coordinates by which the images contradict the position, px, (n,).
    """

    position_mm: FloatArray
    covariance: FloatArray
    by_shared: FloatArray
    miss_px: FloatArray

    def depth_std(self, shared_covariance: FloatArray) -> FloatArray:
        """Return the standard uncertainty of each depth, own and shared errors, mm, shape (n,)."""
        loading = self.by_shared[:, 2]
        shared = np.einsum("ij,jk,ik->i", loading, shared_covariance, loading)
        std: FloatArray = np.sqrt(self.covariance[:, 2, 2] + shared)
        return std


@dataclass(frozen=True)
class PairTargets:
    """The gazed corner in each pair.

    Parameters
    ----------
    stems
        Pairs in which both cameras found it, n.
    triangulated
        Its positions, of record.
    shared_names, shared_covariance
        What all pairs share, s quantities; shape (s, s).
    depth_std_mm
        Standard uncertainty of each triangulated depth, own and shared errors, mm, shape (n,).
    by_board
        Its positions by the board's pose in C1 alone.
    board_sigmas
        Depth by the board less triangulated depth, in standard deviations, shape (n,).
    """

    stems: tuple[str, ...]
    triangulated: PairPositions
    shared_names: tuple[str, ...]
    shared_covariance: FloatArray
    depth_std_mm: FloatArray
    by_board: PairPositions
    board_sigmas: FloatArray


def shared_names(cameras: tuple[Camera, Camera]) -> tuple[str, ...]:
    """Return the names of the shared quantities, in the order of `PairPositions.by_shared`."""
    lenses = [
        f"{place}.{name}"
        for place, camera in zip(("c1", "c2"), cameras, strict=True)
        for name in intrinsic_names(camera)
    ]
    return (*lenses, *POSE_NAMES)


def triangulate(
    pixels: FloatArray, *, cameras: tuple[Camera, Camera], pose_12: FloatArray, sigma_px: float
) -> PairPositions:
    """Triangulate points: the position whose images are nearest to the observed ones.

    Parameters
    ----------
    pixels
        The point in C1 and in C2, px, shape (2, n, 2).
    pose_12
        Pose of C2 in C1, shape (6,).
    sigma_px
        Standard deviation of a coordinate, px.
    """
    points = midpoints(pixels, cameras, pose_12)
    for _ in range(_NEWTON_STEPS):
        error, by_point, _ = _errors(points, pixels, cameras, pose_12)
        points = points - np.einsum("nak,nk->na", np.linalg.pinv(by_point), error)
    error, by_point, by_shared = _errors(points, pixels, cameras, pose_12)
    back = np.linalg.pinv(by_point)
    return PairPositions(
        points,
        sigma_px**2 * back @ back.transpose(0, 2, 1),
        -back @ by_shared,
        np.sqrt((error**2).mean(axis=-1)),
    )


def position_on_board(
    pixels: FloatArray,
    board: Board,
    *,
    cameras: tuple[Camera, Camera],
    sigma_px: float,
    warp_mm: tuple[float, float] | None,
) -> PairPositions:
    """Return the gazed corner's position by the board's pose in C1 alone.

    It needs no C2; the side of a square sets its scale.

    Parameters
    ----------
    pixels
        Corners in C1, shape (n, corners, 2), NaN where not found.
    warp_mm
        Board deformation along x and y, mm, where it is known.
    """
    shape = deformed(board.object_points(), warp_mm)
    target = shape[[board.target_index]]
    count = 4 + len(cameras[0].distortion)
    n, shared = len(pixels), len(shared_names(cameras))
    found = PairPositions(
        np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros((n, 3, shared)), np.empty(n)
    )
    for i, view in enumerate(pixels):
        seen = finite(view)
        points = shape[seen]
        pose, found.miss_px[i] = single_view_pose(cameras[0], points=shape, pixels=view)
        image = project_points(cameras[0], transform(pose, points))
        by_pose = (image.by_point @ transformed_by_pose(pose, points)).reshape(-1, 6)
        spread = inverse(by_pose.T @ by_pose)
        by_intrinsics = -spread @ by_pose.T @ image.by_intrinsics.reshape(-1, count)
        arm = transformed_by_pose(pose, target)[0]
        found.position_mm[i] = transform(pose, target)[0]
        found.covariance[i] = sigma_px**2 * arm @ spread @ arm.T
        found.by_shared[i, :, :count] = arm @ by_intrinsics
    return found


def find_targets(
    pixels: FloatArray,
    board: Board,
    *,
    cameras: tuple[Camera, Camera],
    stems: tuple[str, ...],
    pose_12: FloatArray,
    shared_covariance: FloatArray,
    sigma_px: float,
    warp_mm: tuple[float, float] | None,
) -> PairTargets:
    """Return the gazed corner of each pair in which both cameras found it.

    Parameters
    ----------
    pixels
        Corners in C1 and C2, px, shape (2, pairs, corners, 2).
    stems
        Names of the pairs.
    pose_12
        Pose of C2 in C1, shape (6,).
    shared_covariance
        Of the quantities `shared_names`, shape (s, s).
    sigma_px
        Standard deviation of a corner coordinate, px.
    warp_mm
        Board deformation along x and y, mm, where it is known.

    Raises
    ------
    EstimationError
        If the rays of a pair do not meet in front of the cameras.
    """
    points = pixels[:, :, board.target_index]
    found = np.flatnonzero(finite(points).all(axis=0))
    _require_ahead(points[:, found], cameras, pose_12, tuple(stems[i] for i in found))
    triangulated = triangulate(
        points[:, found], cameras=cameras, pose_12=pose_12, sigma_px=sigma_px
    )
    by_board = position_on_board(
        pixels[0, found], board, cameras=cameras, sigma_px=sigma_px, warp_mm=warp_mm
    )
    difference = by_board.position_mm - triangulated.position_mm
    spread = PairPositions(
        difference,
        by_board.covariance + triangulated.covariance,
        by_board.by_shared - triangulated.by_shared,
        by_board.miss_px,
    ).depth_std(shared_covariance)
    return PairTargets(
        stems=tuple(stems[i] for i in found),
        triangulated=triangulated,
        shared_names=shared_names(cameras),
        shared_covariance=shared_covariance,
        depth_std_mm=triangulated.depth_std(shared_covariance),
        by_board=by_board,
        board_sigmas=difference[:, 2] / spread,
    )


def _require_ahead(
    pixels: FloatArray,
    cameras: tuple[Camera, Camera],
    pose_12: FloatArray,
    stems: tuple[str, ...],
) -> None:
    """Raise EstimationError, with the pairs' names, unless all rays meet in front of C1."""
    behind = midpoints(pixels, cameras, pose_12)[:, 2] <= 0
    if behind.any():
        raise EstimationError(
            f"stereo: the rays of {np.sum(behind)} of {len(stems)} pairs meet behind C1, in "
            f"{', '.join(s for s, b in zip(stems, behind, strict=True) if b)}; check that C1 and "
            "C2 are not swapped and that the two pictures belong together"
        )


def midpoints(
    pixels: FloatArray, cameras: tuple[Camera, Camera], pose_12: FloatArray
) -> FloatArray:
    """Return where the two rays of each point are nearest to each other, shape (n, 3)."""
    one, two = (
        np.concatenate([normalise(camera, view), np.ones((len(view), 1))], axis=-1)
        for camera, view in zip(cameras, pixels, strict=True)
    )
    # a one = t + b (R two), least squares in a and b.
    turned = two @ rotation(pose_12[:3]).T
    lengths = np.linalg.pinv(np.stack([one, -turned], axis=-1)) @ pose_12[3:]
    middle: FloatArray = (one * lengths[:, :1] + pose_12[3:] + turned * lengths[:, 1:]) / 2
    return middle


def _errors(
    points: FloatArray, pixels: FloatArray, cameras: tuple[Camera, Camera], pose_12: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return projected minus observed, (n, 4), with derivatives by point and by shared."""
    back = rotation(-pose_12[:3])
    arm = points - pose_12[3:]
    one, two = project_points(cameras[0], points), project_points(cameras[1], arm @ back.T)
    error = np.concatenate([one.pixels - pixels[0], two.pixels - pixels[1]], axis=-1)
    by_point = np.concatenate([one.by_point, two.by_point @ back], axis=1)
    counts = [4 + len(c.distortion) for c in cameras]
    by_shared = np.zeros((len(points), 4, sum(counts) + 6))
    by_shared[:, :2, : counts[0]] = one.by_intrinsics
    by_shared[:, 2:, counts[0] : sum(counts)] = two.by_intrinsics
    by_shared[:, 2:, -6:-3] = two.by_point @ -rotated_by_vector(-pose_12[:3], arm)
    by_shared[:, 2:, -3:] = two.by_point @ -back
    return error, by_point, by_shared
