"""Poses as a rotation vector and a translation, with derivatives.

A pose (r, t), six numbers in rad and mm, takes a point of one frame to another: Q = R(r) P + t with
R(r) a turn by the length of r about its direction. Derivatives are by the numbers themselves.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.core.arrays import FloatArray


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix, shape (3, 3), of a rotation vector, rad, shape (3,)."""
    matrix: FloatArray = cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0]
    return matrix


def rotated_by_vector(vector: FloatArray, points: FloatArray) -> FloatArray:
    """Return d(R(r) P)/dr, shape (n, 3, 3), of points, shape (n, 3)."""
    jacobian = cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[1]
    derivative: FloatArray = np.einsum("jab,nb->naj", jacobian.reshape(3, 3, 3), points)
    return derivative


def transform(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Return points, shape (n, 3), taken along by a pose, shape (6,)."""
    moved: FloatArray = points @ rotation(pose[:3]).T + pose[3:]
    return moved


def transformed_by_pose(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Return d(R(r) P + t)/d(r, t), shape (n, 3, 6)."""
    by_translation = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    return np.concatenate([rotated_by_vector(pose[:3], points), by_translation], axis=-1)


def pose_matrix(pose: FloatArray) -> FloatArray:
    """Return a pose as a homogeneous matrix, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(pose[:3])
    matrix[:3, 3] = pose[3:]
    return matrix


def pose_vector(matrix: FloatArray) -> FloatArray:
    """Return a homogeneous matrix, shape (4, 4), as a pose, shape (6,)."""
    vector = cv2.Rodrigues(np.ascontiguousarray(matrix[:3, :3]))[0].ravel()
    return np.concatenate([vector, matrix[:3, 3]])


def invert_pose(pose: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse of a pose with its covariance, shapes (6,) and (6, 6).

    The inverse of (r, t) is (-r, -R(-r) t).
    """
    back = rotation(-pose[:3])
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -np.eye(3)
    jacobian[3:, :3] = rotated_by_vector(-pose[:3], pose[None, 3:])[0]
    jacobian[3:, 3:] = -back
    inverse = np.concatenate([-pose[:3], -back @ pose[3:]])
    return inverse, jacobian @ covariance @ jacobian.T
