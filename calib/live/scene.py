"""The rig from above, as numbers that a page can draw. Frame C1: X right, Z forward, mm."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, normalise
from calib.geometry.plane import Gaze, frame, gaze_angle

CHI2_95_2: Final = 5.991
"""95 % of a bivariate normal distribution lie within this squared Mahalanobis distance."""


def rig_scene(
    theta: FloatArray, c1: Camera, c2: Camera, depths_mm: tuple[float, float]
) -> dict[str, Any]:
    """Return what of a rig does not move: axis, fields of view, depths.

    Fields are slopes X/Z of a camera's outermost columns, left and right.
    """
    point = frame(theta).point
    return {
        "axis_mm": [float(point[0]), float(point[2])],
        "field_c1": _field(c1),
        "field_c2": _field(c2),
        "depths_mm": [float(d) for d in depths_mm],
    }


def heading(theta: FloatArray, reading_rad: float) -> list[float]:
    """Return C2's optical axis at a reading: X and Z of the unit vector."""
    nothing = np.zeros(1)
    angle = float(gaze_angle(theta, Gaze(nothing, nothing, np.array([reading_rad]), nothing))[0])
    rotation = frame(theta).rotation
    level = -math.cos(angle) * rotation[:, 0] + math.sin(angle) * rotation[:, 2]
    return [float(level[0]), float(level[2])]


def ellipse95(covariance_mm2: FloatArray) -> dict[str, float]:
    """Return the 95 % ellipse of X and Z of a position.

    Parameters
    ----------
    covariance_mm2
        Of X, Y and Z, shape (3, 3).

    Returns
    -------
    dict
        Semi-axes, mm, and the angle of the longer one from X towards Z, rad.
    """
    part = covariance_mm2[np.ix_([0, 2], [0, 2])]
    values, vectors = np.linalg.eigh(part)
    long = vectors[:, 1]
    semi = np.sqrt(CHI2_95_2 * np.clip(values, 0.0, None))
    return {
        "long_mm": float(semi[1]),
        "short_mm": float(semi[0]),
        "angle_rad": math.atan2(float(long[1]), float(long[0])),
    }


def _field(lens: Camera) -> list[float]:
    width, row = lens.image_size[0], lens.matrix[1, 2]
    ends = normalise(lens, np.array([[0.0, row], [width - 1.0, row]]), strict=False)[:, 0]
    if not np.isfinite(ends).all():
        ends = (np.array([0.0, width - 1.0]) - lens.matrix[0, 2]) / lens.matrix[0, 0]
    return [float(ends[0]), float(ends[1])]
