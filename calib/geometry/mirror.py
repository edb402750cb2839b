"""The rig in a mirror: X of C1 changes its sign, and C2 stands on the other side.

A rig whose C2 stands at -X is the mirror image of one whose C2 stands at +X. Points (X, Y, Z)
become (-X, Y, Z), readings alpha2 become 180 degrees less alpha2, gaze residuals change their sign,
and each parameter of the turning plane is even, and stays, or odd, and changes its sign. Mirrored
twice, everything is as it was. Lengths in mm, angles in rad.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, intrinsic_names
from calib.geometry.lens import PROJECTIONS
from calib.geometry.parameters import (
    INDEX,
    PARAMETERS,
    AxisPoint,
    AxisTilt,
    Effect,
    EncoderTerm,
    GazeRoll,
    PlaneOffset,
    ReferenceOffset,
    Standoff,
)

POINT: Final = (-1.0, 1.0, 1.0)
"""Signs of X, Y and Z."""

OBSERVABLE_SIGN: Final = (-1.0, 1.0, -1.0, -1.0, 1.0)
"""Signs of errors of x1c, y1c, alpha2, gaze residual and z, in the order of `OBSERVABLE`."""

_ODD_INTRINSICS = frozenset[str]().union(*(model.odd for model in PROJECTIONS.values()))
"""No model has an even coefficient of the name of another's odd one."""
_ODD_SHARED = ("r12.y", "r12.z", "t12.x")
_SHORT_DEG, _SHORT_COTANGENT = 10, 12
_ROUNDING_RAD = 1e-15
_PROBE_RAD = 1.0


def _sign(effect: Effect) -> float:
    match effect:
        case EncoderTerm(basis=basis):
            # Of the true angle, which turns into pi less itself, the term is a part.
            here, there = basis(np.array([_PROBE_RAD, np.pi - _PROBE_RAD]))
            return -float(np.sign(here * there))
        case AxisPoint(direction=(x, _, _)):
            return -1.0 if x else 1.0
        case AxisTilt(about=axis):
            return 1.0 if axis == 0 else -1.0
        case PlaneOffset() | GazeRoll():
            return -1.0
        case Standoff() | ReferenceOffset():
            return 1.0


SIGN: Final = np.array([_sign(parameter.effect) for parameter in PARAMETERS])
"""Sign of each parameter, shape (COUNT,)."""


def signs(names: Iterable[str]) -> FloatArray:
    """Return the signs of named quantities, shape (n,): 1 of any that is no parameter."""
    return np.array([SIGN[INDEX[name]] if name in INDEX else 1.0 for name in names])


def shared_signs(names: Iterable[str]) -> FloatArray:
    """Return the signs of intrinsics and pose of C2, ``c1.cx`` to ``t12.z``, shape (n,)."""

    def odd(name: str) -> bool:
        return name in _ODD_SHARED or name.partition(".")[2] in _ODD_INTRINSICS

    return np.array([-1.0 if odd(name) else 1.0 for name in names])


def mirror_readings(alpha2: FloatArray) -> FloatArray:
    """Return readings, rad, shape (n,), in the mirror: pi less each.

    A reading that is a short decimal in degrees, or whose cotangent is one, becomes the nearest
    double of the mirrored decimal, as a table would have it; a few of the one kind are, to the last
    bit, long decimals of the other: the shorter counts. Chains of random numbers tell the
    difference, which is of the last bit.
    """
    plain = np.pi - alpha2
    mirrored = plain.copy()
    degrees = 180.0 - np.rad2deg(alpha2)
    with np.errstate(divide="ignore", invalid="ignore"):
        cotangent = -1 / np.tan(alpha2)
    for digits in range(_SHORT_COTANGENT, -1, -1):
        forms = [np.arctan2(1.0, np.round(cotangent, digits))]
        if digits <= _SHORT_DEG:
            forms.append(np.deg2rad(np.round(degrees, digits)))
        for short in forms:
            near = np.abs(short - plain) < _ROUNDING_RAD
            mirrored[near] = short[near]
    return mirrored


def mirror_camera(camera: Camera) -> Camera:
    """Return the camera that takes the mirrored picture of the mirrored scene."""
    matrix = camera.matrix.copy()
    matrix[0, 2] = camera.image_size[0] - 1 - matrix[0, 2]
    lens = np.array([-1.0 if name in _ODD_INTRINSICS else 1.0 for name in intrinsic_names(camera)])
    return replace(camera, matrix=matrix, distortion=signed(camera.distortion, lens[4:]))


def signed(values: FloatArray, sign: FloatArray | float) -> FloatArray:
    """Return values times their signs, without negative zeros."""
    mirrored: FloatArray = values * sign + 0.0
    return mirrored


def mirror_matrix(matrix: FloatArray, sign: FloatArray) -> FloatArray:
    """Return a matrix, shape (..., n, n), such as a covariance, of quantities with these signs."""
    return signed(matrix, np.outer(sign, sign))
