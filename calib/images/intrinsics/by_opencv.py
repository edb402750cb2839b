"""Intrinsics of one camera by OpenCV's solvers, with outliers rejected and covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera, camera_from_vector, project_points
from calib.geometry.poses import transform
from calib.images.detection.grid import seen
from calib.images.intrinsics.by_views import equidistant_start
from calib.images.intrinsics.covariance import view_scores
from calib.images.intrinsics.inliers import without_outliers
from calib.images.intrinsics.lenses import LENSES
from calib.images.mrcal.solves import MIN_CORNERS, MIN_VIEWS, focal_start

MAX_STEPS, DONE = 300, 1e-9
"""When OpenCV's solver stops: its own default of 30 steps falls short, and along the valley of
nearly equal cost of a rational lens 300 steps reach the rms of 1000 to 7 digits."""

_ROUNDS = 12
_FLAGS: Mapping[int, int] = MappingProxyType({5: 0, 8: cv2.CALIB_RATIONAL_MODEL})
_FISHEYE_FLAGS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, MAX_STEPS, DONE)


@dataclass(frozen=True)
class OpencvSolution:
    """What a least-squares solve over given corners found.

    Parameters
    ----------
    camera
        The estimate.
    poses
        Camera from board, rad and mm, shape (views, 6); NaN for a view not used.
    """

    camera: Camera
    poses: FloatArray


def fit_opencv(
    corners: Corners,
    board: Board,
    *,
    lens: str,
    points: FloatArray | None = None,
    start: Camera | None = None,
) -> LensFit:
    """Return intrinsics by OpenCV's calibrateCamera, of wide lenses by that of cv2.fisheye.

    Corners whose residuals stand out, largest first, and views that lose too many are left out and
    the rest is solved again. The covariance is that of least squares, from the jacobian at the
    solution, poses included, with the variance of a corner coordinate estimated from the residuals.

    Parameters
    ----------
    lens
        A key of `LENSES`.
    points
        Corners in the board's frame, mm, shape (corners, 3), if the board is not flat.
    start
        A camera to start from; its distortion is used if it is of the same lens model.

    Raises
    ------
    EstimationError
        If OpenCV finds no solution, or the views leave a parameter open.
    """
    points = board.object_points() if points is None else points
    used = seen(corners.pixels)
    used[used.sum(axis=-1) < MIN_CORNERS] = False
    for _ in range(_ROUNDS):
        solution = solve_views(corners, board, used, lens=lens, points=points, start=start)
        residuals = residuals_of(solution, corners, points)
        kept = without_outliers(residuals, used)
        if np.array_equal(kept, used):
            break
        used, start = kept, solution.camera
    residuals[~used] = np.nan
    scores = view_scores(solution.camera, solution.poses, residuals, points)
    rejected = seen(corners.pixels) & ~used
    rejected[seen(corners.pixels).sum(axis=-1) < MIN_CORNERS] = False
    return LensFit(
        backend="opencv",
        lens_model=lens,
        camera=solution.camera,
        covariance=scores.covariance(),
        rms_px=float(np.sqrt(np.nanmean(residuals**2))),
        residuals=residuals,
        poses=solution.poses,
        rejected=int(rejected.sum()),
    )


def solve_views(
    corners: Corners,
    board: Board,
    used: BoolArray,
    *,
    lens: str,
    points: FloatArray,
    start: Camera | None = None,
) -> OpencvSolution:
    """Solve over the corners `used`, shape (views, corners); parameters as `fit_opencv`.

    Raises
    ------
    EstimationError
        If there are too few views, or OpenCV fails or ends nowhere.
    """
    count = LENSES[lens].count
    views = np.flatnonzero(used.any(axis=-1))
    if len(views) < MIN_VIEWS:
        raise EstimationError(
            f"OpenCV: {len(views)} usable views and {MIN_VIEWS} are needed; take more board images"
        )
    boards = [points[used[i]] for i in views]
    found = [corners.pixels[i][used[i]] for i in views]
    try:
        if LENSES[lens].projection == "equidistant":
            begin = equidistant_start(corners, points) if start is None else start
            _, matrix, distortion, turns, shifts = cv2.fisheye.calibrate(
                [shown[None] for shown in boards],
                [view[None] for view in found],
                corners.image_size,
                begin.matrix.copy(),
                begin.distortion[:, None].copy(),
                flags=_FISHEYE_FLAGS,
                criteria=_CRITERIA,
            )
        else:
            focal = focal_start(corners, board) if start is None else 0.0
            matrix, distortion = _start(start, focal, count, corners.image_size)
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                [shown.astype(np.float32) for shown in boards],
                [view.astype(np.float32) for view in found],
                corners.image_size,
                matrix,
                distortion,
                flags=cv2.CALIB_USE_INTRINSIC_GUESS | _FLAGS[count],
                criteria=_CRITERIA,
            )
    except cv2.error as error:
        raise EstimationError(
            f"OpenCV found no solution for the {lens} lens ({error.err}); check the board's size "
            "in [board] and that the images are of one camera"
        ) from error
    poses = np.full((len(used), 6), np.nan)
    poses[views] = np.concatenate([np.reshape(turns, (-1, 3)), np.reshape(shifts, (-1, 3))], axis=1)
    core = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    vector = np.concatenate([core, np.ravel(distortion)[:count]])
    if not (np.isfinite(vector).all() and np.isfinite(poses[views]).all()):
        raise EstimationError(
            f"OpenCV's solution for the {lens} lens is not finite; take board images with other "
            "tilts and distances"
        )
    projection = LENSES[lens].projection
    return OpencvSolution(camera_from_vector(vector, corners.image_size, projection), poses)


def _start(
    start: Camera | None, focal: float, count: int, image_size: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return matrix and distortion to start from."""
    distortion = np.zeros(count)
    if start is not None:
        if len(start.distortion) <= count:
            distortion[: len(start.distortion)] = start.distortion
        return start.matrix.copy(), distortion
    width, height = image_size
    middle = ((width - 1) / 2, (height - 1) / 2)
    return np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]]), distortion


def residuals_of(solution: OpencvSolution, corners: Corners, points: FloatArray) -> FloatArray:
    """Return observed minus projected, px, shape (views, corners, 2); NaN where there is none."""
    residuals = np.full_like(corners.pixels, np.nan)
    for i in np.flatnonzero(seen(solution.poses)):
        moved = transform(solution.poses[i], points)
        residuals[i] = corners.pixels[i] - project_points(solution.camera, moved).pixels
    return residuals
