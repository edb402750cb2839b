"""The pose of C2 in C1 by two backends, and its covariance.

Intrinsics are held at what the intrinsics stage found, so that every later step uses one camera.
Their uncertainty is carried through: with u the pose of C2, the board poses and the warp of the
board, and k the intrinsics, least squares makes

    d u = -N_uu^-1 N_uk d k + N_uu^-1 J_u' noise,      N = J'J.

The two terms are independent even where the same images gave intrinsics and pose: an error of
intrinsics estimated camera by camera is a sum of corner errors orthogonal to every shift of a
board's pose in that camera, and the pose of C2 acts on a view by shifting the board's pose in C2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, intrinsic_vector, project_points
from calib.geometry.poses import (
    invert_pose,
    rotated_by_vector,
    rotation,
    transform,
    transformed_by_pose,
)
from calib.images.bundle import Block, deformed, dispersion, finite, inverse, sum_blocks
from calib.images.mrcal import solves
from calib.images.pairs import PairStart
from calib.images.stereo.wide import (
    STEREOGRAPHIC,
    any_wide,
    as_stereographic,
)


@dataclass(frozen=True)
class CameraPair:
    """C1 and C2 as the intrinsics stage found them.

    Parameters
    ----------
    cameras
        C1 and C2.
    covariances
        Of fx, fy, cx, cy and the distortion of each, px and 1, shapes (p1, p1) and (p2, p2); zeros
        where nothing is stated.
    is_left
        Whether C2 stands at -X of C1.
    free
        Whether each was calibrated from pictures, which a joint solve may use again, or given.
    """

    cameras: tuple[Camera, Camera]
    covariances: tuple[FloatArray, FloatArray]
    is_left: bool = False
    free: tuple[bool, bool] = (False, False)


@dataclass(frozen=True)
class StereoSolve:
    """The pose of C2 in C1 by one backend.

    Parameters
    ----------
    backend
        "opencv" or "mrcal".
    intrinsics
        "held" at those of the intrinsics stage, or "free".
    pose_12
        P1 = R P2 + t: rotation vector, rad, and translation, mm, shape (6,).
    covariance
        Of `pose_12`, with the uncertainty of the intrinsics and, of the joint solve, what lenses
        that change with distance may add, shape (6, 6).
    noise_covariance
        Where intrinsics are held, the part of it that the pairs' own errors give at these: that of
        independent corner noise times `dispersion`; else all but what such lenses may add, (6, 6).
    dispersion
        Variance of the pose as the pairs show it over that which independent corner noise
        explains, see `calib.images.bundle.dispersion`; 1 where it was not looked at.
    by_intrinsics
        d(pose_12)/d(intrinsics of C1, then C2) where they are held, shape (6, p1 + p2).
    rms_px
        Root mean square of the residual per coordinate over inliers, px.
    sigma_px
        The same per degree of freedom: the standard deviation of a corner coordinate.
    residuals
        Observed minus projected, px, shape (2, pairs, corners, 2); NaN where missing or rejected.
    poses
        C1 from board, rad and mm, shape (pairs, 6).
    rejected
        Corners discarded as outliers.
    board_warp_mm
        Board deformation along x and y, mm, where the backend solves it; else None.
    cameras
        C1 and C2 as held or solved.
    """

    backend: str
    intrinsics: str
    pose_12: FloatArray
    covariance: FloatArray
    noise_covariance: FloatArray
    dispersion: float
    by_intrinsics: FloatArray
    rms_px: float
    sigma_px: float
    residuals: FloatArray
    poses: FloatArray
    rejected: int
    board_warp_mm: tuple[float, float] | None
    cameras: tuple[Camera, Camera]


def solve_mrcal(start: PairStart, board: Board, rig: CameraPair, *, seed: int) -> StereoSolve:
    """Solve with mrcal, intrinsics held, deformation of the board free.

    Raises
    ------
    MrcalMissingError
        If this machine has no mrcal.
    EstimationError
        If it fails, or the pairs do not determine the pose.
    """
    wide = any_wide(rig.cameras)
    model, count = (STEREOGRAPHIC, 0) if wide else solves.lens_model(rig.cameras)
    intrinsics = np.zeros((2, 4 + count))
    for row, camera in zip(intrinsics, rig.cameras, strict=True):
        vector = intrinsic_vector(camera)[: 4 + count]
        row[: len(vector)] = vector
    shown = start
    if wide:
        both = zip(rig.cameras, start.pixels, strict=True)
        shown = replace(start, pixels=np.stack([as_stereographic(c, p) for c, p in both]))
    pose_21 = invert_pose(start.pose_12, np.zeros((6, 6)))[0]
    held = solves.StartingPoint(intrinsics, pose_21[None], start.poses)
    solution = solves.solve(
        _as_corners(shown, rig.cameras),
        board,
        lens_model=model,
        seed=seed,
        held=held,
    )
    solve = from_mrcal(solution, "held", rig.cameras)
    if wide:
        solve = _in_pictures(solve, start, board, rig)
    return with_covariance(solve, board, rig, warp_free=True)


def _in_pictures(
    solve: StereoSolve, start: PairStart, board: Board, rig: CameraPair
) -> StereoSolve:
    """Return a solve of rays with its residuals in the pictures themselves."""
    points = deformed(board.object_points(), solve.board_warp_mm)
    residuals = residuals_of_pairs(
        start.pixels, points, rig.cameras, pose_12=solve.pose_12, poses=solve.poses
    )
    residuals[~finite(solve.residuals)] = np.nan
    return replace(solve, residuals=residuals, rms_px=float(np.sqrt(np.nanmean(residuals**2))))


def joint_covariance(rig: CameraPair, solve: StereoSolve) -> FloatArray:
    """Return the covariance of the intrinsics of C1, those of C2, and the pose of C2 in C1.

    `solve` is one with intrinsics held; shape (p1 + p2 + 6, p1 + p2 + 6).
    """
    edges = np.cumsum([0, *(len(c) for c in rig.covariances)])
    size = int(edges[-1])
    joint = np.zeros((size + 6, size + 6))
    for (low, high), covariance in zip(pairwise(edges), rig.covariances, strict=True):
        joint[low:high, low:high] = covariance
    cross = joint[:size, :size] @ solve.by_intrinsics.T
    joint[:size, size:], joint[size:, :size] = cross, cross.T
    joint[size:, size:] = solve.noise_covariance + solve.by_intrinsics @ cross
    return joint


def residuals_of_pairs(
    pixels: FloatArray,
    points: FloatArray,
    cameras: tuple[Camera, Camera],
    *,
    pose_12: FloatArray,
    poses: FloatArray,
) -> FloatArray:
    """Return observed minus projected, px, shape (2, n, corners, 2)."""
    residuals = np.array(pixels)
    back = invert_pose(pose_12, np.zeros((6, 6)))[0]
    for i, pose in enumerate(poses):
        one = transform(pose, points)
        residuals[0, i] -= project_points(cameras[0], one).pixels
        residuals[1, i] -= project_points(cameras[1], transform(back, one)).pixels
    return residuals


def _as_corners(start: PairStart, cameras: tuple[Camera, Camera]) -> list[Corners]:
    names = tuple(str(i) for i in start.pairs)
    detector = ("cache",) * len(names)
    return [
        Corners(names, pixels, detector, camera.image_size)
        for pixels, camera in zip(start.pixels, cameras, strict=True)
    ]


def from_mrcal(
    solution: solves.MrcalSolution, intrinsics: str, cameras: tuple[Camera, Camera]
) -> StereoSolve:
    """Return mrcal's answer, which is C2 from C1, as the pose of C2 in C1."""
    covariance = solution.covariance
    if covariance is None:
        raise ValueError(f"{solution.lens_model} tells no covariance")
    pose_12, noise = invert_pose(solution.camera_from_first[0], covariance[-6:, -6:])
    return StereoSolve(
        backend="mrcal",
        intrinsics=intrinsics,
        pose_12=pose_12,
        covariance=noise,
        noise_covariance=noise,
        dispersion=1.0,
        by_intrinsics=np.zeros((6, 0)),
        rms_px=solution.rms_px,
        sigma_px=solution.sigma_px,
        residuals=solution.residuals,
        poses=solution.poses,
        rejected=int(solution.rejected.sum()),
        board_warp_mm=solution.board_warp_mm,
        cameras=cameras,
    )


def with_covariance(
    solve: StereoSolve, board: Board, rig: CameraPair, *, warp_free: bool
) -> StereoSolve:
    """Return the solution with the covariance of its pose, linearised around it."""
    points = deformed(board.object_points(), solve.board_warp_mm)
    known = sum(4 + len(c.distortion) for c in rig.cameras)
    pairs = [_pair_blocks(solve, i, points, rig.cameras) for i in range(len(solve.poses))]
    matrix = sum_blocks([b for pair in pairs for b in pair], known + 8 + 6 * len(pairs)).matrix
    # Unknowns in order: intrinsics (known), pose of C2, deformation of the board, board poses.
    solved = np.arange(known, len(matrix))
    if not warp_free:
        solved = np.delete(solved, [6, 7])
    solved = solved[np.diag(matrix)[solved] > 0]  # a pair may have lost all its corners
    spread = inverse(matrix[np.ix_(solved, solved)])[:6]
    square_sum = float(np.nansum(solve.residuals**2))
    freedom = max(1, int(np.isfinite(solve.residuals).sum()) - len(solved))
    factor = _dispersion(pairs, known)
    done = replace(
        solve,
        noise_covariance=factor * square_sum / freedom * spread[:, :6],
        by_intrinsics=-spread @ matrix[np.ix_(solved, np.arange(known))],
        sigma_px=float(np.sqrt(square_sum / freedom)),
        dispersion=factor,
    )
    return replace(done, covariance=joint_covariance(rig, done)[-6:, -6:])


def _dispersion(pairs: list[list[Block]], known: int) -> float:
    """Return how much more the pairs contradict each other in the pose than noise explains.

    What an error of the intrinsics does to all pairs alike is no contradiction, so the residuals
    are first cleared of it, by a step of all unknowns, intrinsics and warp included. Where the
    pairs leave these open, 1: too few pairs to tell.
    """
    whole = [pair for pair in pairs if all(len(b.residuals) for b in pair)]
    if not whole:
        return 1.0
    used = np.unique(np.concatenate([b.columns for pair in whole for b in pair]))
    flat = [[b._replace(columns=np.searchsorted(used, b.columns)) for b in p] for p in whole]
    normal = sum_blocks([block for pair in flat for block in pair], len(used))
    try:
        spread = inverse(normal.matrix)
    except EstimationError:
        return 1.0
    step = -spread @ normal.gradient
    freedom = sum(len(b.residuals) for pair in flat for b in pair) - len(used)
    left = normal.cost + float(normal.gradient @ step)
    if left <= 0:  # exact corners
        return 1.0
    sigma = np.sqrt(left / max(freedom, 1))
    cleared = [
        [b._replace(residuals=(b.residuals + b.jacobian @ step[b.columns]) / sigma) for b in pair]
        for pair in flat
    ]
    return dispersion(cleared, spread, known + np.arange(6))


def _pair_blocks(
    solve: StereoSolve, i: int, points: FloatArray, cameras: tuple[Camera, Camera]
) -> list[Block]:
    """Return the blocks of the two images of pair i, unknowns as in `with_covariance`."""
    own, pose = solve.poses[i], solve.pose_12
    back = rotation(-pose[:3])
    one = transform(own, points)
    arm = one - pose[3:]
    by_board = np.concatenate(
        [rotation(own[:3]) @ _points_by_warp(points), transformed_by_pose(own, points)], axis=-1
    )
    by_pose = np.concatenate(
        [-rotated_by_vector(-pose[:3], arm), np.broadcast_to(-back, (len(arm), 3, 3))], axis=-1
    )
    places = (one, arm @ back.T)
    derivatives = (
        np.concatenate([np.zeros_like(by_pose), by_board], axis=-1),
        np.concatenate([by_pose, back @ by_board], axis=-1),
    )
    edges = np.cumsum([0, *(4 + len(c.distortion) for c in cameras)])
    geometry = edges[-1] + np.r_[np.arange(8), 8 + 6 * i + np.arange(6)]
    blocks = []
    for c, camera in enumerate(cameras):
        view = project_points(camera, places[c])
        jacobian = np.concatenate([view.by_intrinsics, view.by_point @ derivatives[c]], axis=-1)
        residuals = solve.residuals[c, i]
        used = finite(residuals)
        columns = np.concatenate([np.arange(edges[c], edges[c + 1]), geometry])
        blocks.append(
            Block(-residuals[used].ravel(), jacobian[used].reshape(-1, len(columns)), columns)
        )
    return blocks


def _points_by_warp(points: FloatArray) -> FloatArray:
    """Return d(board point)/d(warp), shape (n, 3, 2)."""
    flat = points * np.array([1.0, 1.0, 0.0])
    return np.stack([deformed(flat, warp) - flat for warp in ((1.0, 0.0), (0.0, 1.0))], axis=-1)
