"""The lenses of a joint solve, camera by camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.geometry.camera import Camera
from calib.geometry.poses import invert_pose
from calib.images.joint.solve import JointSolve


@dataclass(frozen=True)
class RefinedLens:
    """The intrinsics of one camera by all its images of the board.

    Parameters
    ----------
    name
        "c1" or "c2".
    camera
        The estimate.
    covariance
        Of fx, fy, cx, cy and distortion, px and 1, shape (4 + k, 4 + k), enlarged by `dispersion`.
    dispersion
        Variance of the estimate as the views show it over that of independent corner noise.
    images, kinds
        The i images, and what each was taken for: "lens", "pair" or "row".
    pixels
        Corners found, px, shape (i, corners, 2); NaN where not.
    residuals
        Observed minus projected, px, shape (i, corners, 2); NaN where missing or rejected.
    poses
        Camera from board, rad and mm, shape (i, 6).
    board_warp_mm
        Board deformation along x and y, mm.
    """

    name: str
    camera: Camera
    covariance: FloatArray
    dispersion: float
    images: tuple[str, ...]
    kinds: tuple[str, ...]
    pixels: FloatArray
    residuals: FloatArray
    poses: FloatArray
    board_warp_mm: tuple[float, float]


def refined_lenses(joint: JointSolve) -> tuple[RefinedLens, ...]:
    """Return the lenses that the joint solve found, C1 before C2."""
    lenses = []
    images = joint.problem.images
    for c in (0, 1):
        if not joint.problem.free[c]:
            continue
        own = np.flatnonzero(images.camera == c)
        at = joint.problem.at_lens(c)
        lenses.append(
            RefinedLens(
                name=f"c{c + 1}",
                camera=joint.cameras[c],
                covariance=joint.covariance[np.ix_(at, at)],
                dispersion=joint.factors[c],
                images=tuple(images.names[i] for i in own),
                kinds=tuple(images.kinds[i] for i in own),
                pixels=images.pixels[own],
                residuals=joint.residuals[own],
                poses=_in_camera(joint, own),
                board_warp_mm=joint.board_warp_mm,
            )
        )
    return tuple(lenses)


def _in_camera(joint: JointSolve, chosen: IntArray) -> FloatArray:
    """Return the board's poses in the camera of some images, shape (k, 6)."""
    images = joint.problem.images
    poses: FloatArray = joint.poses[images.view[chosen]].copy()
    back = invert_pose(joint.pose_12, np.zeros((6, 6)))[0]
    for k in np.flatnonzero(images.in_pair[chosen]):
        turn, shift = cv2.composeRT(poses[k, :3], poses[k, 3:], back[:3], back[3:])[:2]
        poses[k] = np.concatenate([turn.ravel(), shift.ravel()])
    return poses
