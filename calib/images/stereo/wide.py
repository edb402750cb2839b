"""What stands beside the pose of C2 where a camera has a wide lens.

mrcal has no equidistant lens, and OpenCV none beside a pinhole. With the lenses held neither is
needed: mrcal is shown both cameras as stereographic ones (LENSMODEL_STEREOGRAPHIC, which has rays
up to 180 degrees off the axis), each corner where such a camera would see its ray; and where both
are equidistant, cv2.fisheye solves the pairs, the board flat.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.camera import Camera, normalise
from calib.images.opencv import steady_opencv
from calib.images.pairs import MIN_PAIRS, PairStart

STEREOGRAPHIC = "LENSMODEL_STEREOGRAPHIC"

_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-12)


def any_wide(cameras: tuple[Camera, Camera]) -> bool:
    """Return whether one of the cameras is not perspective."""
    return any(camera.projection != "perspective" for camera in cameras)


def as_stereographic(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return where a stereographic camera of the same matrix sees the rays, px, shape (..., 2).

    At the angle t off the axis its image height is 2 f tan(t / 2): near that of an equidistant lens
    (1.37 times at 75 degrees, along the radius 1.6 times as large), so that noise stays much alike
    over the picture. NaN where the lens has no ray.
    """
    xy = normalise(camera, pixels.reshape(-1, 2), strict=False)
    bent = 2 * xy / (1 + np.sqrt(1 + (xy**2).sum(axis=-1, keepdims=True)))
    seen: FloatArray = bent * np.diag(camera.matrix)[:2] + camera.matrix[:2, 2]
    return seen.reshape(pixels.shape)


def fisheye_calibrate(
    start: PairStart, points: FloatArray, cameras: tuple[Camera, Camera], *, used: BoolArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the pose of C1 in C2, (6,), C1 from board, (k, 6), and the pairs used, (k,).

    Parameters
    ----------
    used
        Pairs to use, all of their corners, shape (n,).

    Raises
    ------
    EstimationError
        If OpenCV has no function for these cameras, or finds no solution.
    """
    if not all(camera.projection == "equidistant" for camera in cameras):
        raise EstimationError("OpenCV does not solve a pinhole and a fisheye together")
    views = np.flatnonzero(used)
    if len(views) < MIN_PAIRS:
        raise EstimationError(f"cv2.fisheye takes whole boards, and {len(views)} pairs show them")
    c1, c2 = cameras
    try:
        with steady_opencv():
            result = cv2.fisheye.stereoCalibrate(
                [points[None] for _ in views],
                [start.pixels[0, i][None] for i in views],
                [start.pixels[1, i][None] for i in views],
                c1.matrix.copy(),
                c1.distortion.copy(),
                c2.matrix.copy(),
                c2.distortion.copy(),
                c1.image_size,
                flags=cv2.CALIB_FIX_INTRINSIC,
                criteria=_CRITERIA,
            )
    except cv2.error as error:
        raise EstimationError(f"cv2.fisheye found no pose of the pairs ({error.err})") from error
    turn, shift, turns, shifts = result[5], result[6], result[7], result[8]
    pose_21 = np.concatenate([cv2.Rodrigues(turn)[0].ravel(), np.ravel(shift)])
    poses = np.concatenate([np.reshape(turns, (-1, 3)), np.reshape(shifts, (-1, 3))], axis=1)
    return pose_21, poses, views
