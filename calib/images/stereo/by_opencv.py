"""The pose of C2 in C1 by OpenCV, lenses held, the board taken to be flat."""

from __future__ import annotations

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.geometry.poses import invert_pose, rotation
from calib.images.bundle import finite
from calib.images.checks import outlier_limit
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.opencv import steady_opencv
from calib.images.pairs import PairStart
from calib.images.stereo.solve import CameraPair, StereoSolve, residuals_of_pairs, with_covariance
from calib.images.stereo.wide import any_wide, fisheye_calibrate

CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-12)
"""Some releases of OpenCV stop after 30 iterations by default, short of the minimum."""

_REJECTION_ROUNDS = 3
_PLUMB_BOB = 5


def opencv_beside(
    start: PairStart, board: Board, known: CameraPair
) -> tuple[list[StereoSolve], tuple[str, ...]]:
    """Return OpenCV's solve, or why a wide lens has none."""
    try:
        return [solve_opencv(start, board, known)], ()
    except EstimationError as error:
        if not any_wide(known.cameras):
            raise
        return [], (f"no check by OpenCV: {error}",)


def solve_opencv(start: PairStart, board: Board, rig: CameraPair) -> StereoSolve:
    """Solve with OpenCV's stereoCalibrate, intrinsics held, the board taken to be flat.

    It has no outlier rejection, so gross outliers are left out and the rest solved again; of wide
    lenses, whole pairs, as cv2.fisheye takes whole boards.

    Raises
    ------
    EstimationError
        If the pairs do not determine the pose, or only one of the cameras is a fisheye.
    """
    points = board.object_points()
    seen: BoolArray = np.asarray(finite(start.pixels).all(axis=0))
    wide = any_wide(rig.cameras)
    used = seen & seen.all(axis=-1, keepdims=True) if wide else seen.copy()
    for _ in range(_REJECTION_ROUNDS):
        pose_12, poses = _stereo_calibrate(start, points, rig.cameras, used=used)
        residuals = residuals_of_pairs(
            start.pixels, points, rig.cameras, pose_12=pose_12, poses=poses
        )
        size = np.abs(residuals).max(axis=(0, -1))
        limit = outlier_limit(residuals[:, used])
        if not np.any(used & (size > limit)):
            break
        used &= size <= limit
        if wide:
            used &= used.all(axis=-1, keepdims=True)
    used[used.sum(axis=-1) < MIN_CORNERS] = False  # no pose of their own, nor a word on 1T2
    residuals[:, ~used] = np.nan
    solve = StereoSolve(
        backend="opencv",
        intrinsics="held",
        pose_12=pose_12,
        covariance=np.zeros((6, 6)),
        noise_covariance=np.zeros((6, 6)),
        dispersion=1.0,
        by_intrinsics=np.zeros((6, 0)),
        rms_px=float(np.sqrt(np.nanmean(residuals**2))),
        sigma_px=0.0,
        residuals=residuals,
        poses=poses,
        rejected=2 * int(seen.sum() - used.sum()),
        board_warp_mm=None,
        cameras=rig.cameras,
    )
    return with_covariance(solve, board, rig, warp_free=False)


def _stereo_calibrate(
    start: PairStart, points: FloatArray, cameras: tuple[Camera, Camera], *, used: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the pose of C2 in C1, shape (6,), and C1 from board, shape (n, 6)."""
    poses = np.array(start.poses)
    if any_wide(cameras):
        whole = np.asarray(used.all(axis=-1))
        vector, own, chosen = fisheye_calibrate(start, points, cameras, used=whole)
        poses[chosen] = own
        return invert_pose(vector, np.zeros((6, 6)))[0], poses
    views = np.flatnonzero(used.sum(axis=-1) >= MIN_CORNERS)
    pose_21 = invert_pose(start.pose_12, np.zeros((6, 6)))[0]
    c1, c2 = cameras
    # Without its flag OpenCV takes k4 to k6 for 0, which of a rational lens is another lens.
    count = max(len(camera.distortion) for camera in cameras)
    lenses = [np.pad(camera.distortion, (0, count - len(camera.distortion))) for camera in cameras]
    rational = cv2.CALIB_RATIONAL_MODEL if count > _PLUMB_BOB else 0
    with steady_opencv():
        result = cv2.stereoCalibrateExtended(
            [points[used[i]].astype(np.float32) for i in views],
            [start.pixels[0, i][used[i]].astype(np.float32) for i in views],
            [start.pixels[1, i][used[i]].astype(np.float32) for i in views],
            c1.matrix,
            lenses[0],
            c2.matrix,
            lenses[1],
            c1.image_size,
            rotation(pose_21[:3]),
            pose_21[3:, None].copy(),
            flags=cv2.CALIB_FIX_INTRINSIC | cv2.CALIB_USE_EXTRINSIC_GUESS | rational,
            criteria=CRITERIA,
        )
    turn, shift, turns, shifts = result[5], result[6], result[9], result[10]
    vector = np.concatenate([cv2.Rodrigues(turn)[0].ravel(), shift.ravel()])
    poses[views] = np.concatenate([np.array(turns), np.array(shifts)], axis=1).reshape(-1, 6)
    return invert_pose(vector, np.zeros((6, 6)))[0], poses
