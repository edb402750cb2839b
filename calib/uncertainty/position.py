"""Positions from gazes, their derivatives, and the first-order error law of Xu and Wang.

x = x1c z, y = y1c z (eq. 5 of Xu and Wang, doi 10.1177/1729881417715984), z from the gaze plane.
Frame C1, lengths in mm, angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.plane import OBSERVABLE, Gaze, depth


@dataclass(frozen=True)
class PositionJacobian:
    """Positions with their derivatives.

    Parameters
    ----------
    position
        mm, shape (n, 3).
    by_theta
        Shape (n, 3, COUNT), mm per unit of each parameter.
    by_reading
        Shape (n, 3, 4), mm per unit of x1c, y1c, alpha2 and gaze residual.
    """

    position: FloatArray
    by_theta: FloatArray
    by_reading: FloatArray


def in_front(z: FloatArray) -> FloatArray:
    """Return depths, mm, with infinity for those that are not in front of C1.

    Where the ray does not meet the plane there the point lies, as far as the readings can tell,
    beyond any distance.
    """
    depths: FloatArray = np.where(z > 0, z, np.inf)
    return depths


def positions(theta: FloatArray, gaze: Gaze) -> FloatArray:
    """Return positions, mm, shape (n, 3), with depths as of `in_front`.

    `theta` is of shape (COUNT,), or one for each gaze, (n, COUNT).
    """
    z = in_front(depth(theta, gaze))
    with np.errstate(invalid="ignore"):
        return np.stack([gaze.x1c * z, gaze.y1c * z, z], axis=-1)


def position_jacobian(theta: FloatArray, gaze: Gaze) -> PositionJacobian:
    """Return positions for one parameter vector, shape (COUNT,), with their derivatives.

    dx = x1c dz + z dx1c and dy = y1c dz + z dy1c are eq. (11) of Xu and Wang.
    """
    j = depth_jacobian(theta, gaze)
    ray = np.stack([gaze.x1c, gaze.y1c, np.ones(len(gaze))], axis=-1)
    by_reading = ray[:, :, None] * j.by_observable[:, None, :]
    by_reading[:, 0, OBSERVABLE.x1c] += j.z
    by_reading[:, 1, OBSERVABLE.y1c] += j.z
    return PositionJacobian(
        position=ray * j.z[:, None],
        by_theta=ray[:, :, None] * j.by_theta[:, None, :],
        by_reading=by_reading,
    )


def depth_error_terms(
    theta: FloatArray, gaze: Gaze, *, by_theta: FloatArray, by_reading: FloatArray
) -> FloatArray:
    """Return the terms of the first-order depth error, mm, shape (n, COUNT + 4), all positive.

    For `base` these are the terms of eq. (10) of Xu and Wang; their sum is the largest depth error
    that errors within the given limits can cause, to first order. It bounds, it is no uncertainty.

    Parameters
    ----------
    by_theta
        Largest error of each parameter, shape (COUNT,).
    by_reading
        Largest errors of x1c, y1c, alpha2 and gaze residual, shape (4,).
    """
    j = depth_jacobian(theta, gaze)
    return np.abs(np.hstack([j.by_theta * by_theta, j.by_observable * by_reading]))


def lateral_error(
    *, coordinate: FloatArray, z: FloatArray, coordinate_error: float, z_error: FloatArray
) -> FloatArray:
    """Return the largest error of x or y, mm, shape (n,): eq. (11) of Xu and Wang.

    Parameters
    ----------
    coordinate
        x1c or y1c, shape (n,).
    z, z_error
        Depth and its largest error, mm, shape (n,).
    coordinate_error
        Largest error of the coordinate.
    """
    error: FloatArray = z * coordinate_error + np.abs(coordinate) * z_error
    return error
