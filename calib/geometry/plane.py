r"""A ray of C1 meets the turning gaze plane of C2.

With the unit normal :math:`n(\alpha)`, a point :math:`p` of the yaw axis, its signed distance
:math:`e` to the plane and the ray :math:`r = (x_{1c}, y_{1c}, 1)`, depth is

.. math:: z = \frac{n(\alpha) \cdot p + e}{n(\alpha) \cdot r}.

Untilted it reads z (x1c + cot a) = L_b + Z_a cot a + e / sin a; with Z_a = e = 0 it is eq. (10)'s
parent, eq. (6) of Xu and Wang (doi 10.1177/1729881417715984) with the cotangent that the geometry
needs in place of the printed tangent.

Frame C1 throughout: X right, Y down, Z forward, origin at C1's optical centre; lengths in mm,
angles in rad. The yaw axis has direction R Y with R = Rz(tilt_z) Rx(tilt_x) and crosses Y = 0 at p.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.parameters import (
    ENCODER_CENTRE_RAD,
    PARAMETERS,
    AxisPoint,
    AxisTilt,
    EncoderTerm,
    GazeRoll,
    PlaneOffset,
)


@dataclass(frozen=True)
class Gaze:
    """Gazes at targets: what C1, C2 and the encoder say of them.

    Parameters
    ----------
    x1c, y1c
        Normalised, undistorted coordinates in C1, shape (n,).
    alpha2
        Encoder readings, rad, shape (n,).
    residual
        Angle from C2's centre column to the target, rad, shape (n,); it adds to the gaze angle.
    """

    x1c: FloatArray
    y1c: FloatArray
    alpha2: FloatArray
    residual: FloatArray

    def __len__(self) -> int:
        return len(self.x1c)


class Observable(NamedTuple):
    """Column of each observed quantity in jacobians and covariances."""

    x1c: int = 0
    y1c: int = 1
    alpha2: int = 2
    residual: int = 3
    z: int = 4


OBSERVABLE = Observable()


def gaze_angle(theta: FloatArray, gaze: Gaze) -> FloatArray:
    """Return true gaze angles, rad, shape (..., n), for parameters of shape (..., COUNT)."""
    angle: FloatArray = gaze.alpha2 + gaze.residual
    for i, parameter in enumerate(PARAMETERS):
        if isinstance(parameter.effect, EncoderTerm):
            angle = angle + theta[..., i, None] * parameter.effect.basis(gaze.alpha2)
    return angle


def encoder_reading(theta: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the readings, rad, shape (n,), at which C2 stands at true gaze angles `angle`.

    Inverse of `gaze_angle` without gaze residual, for one parameter vector, shape (COUNT,). Solved
    by fixed-point iteration: the encoder's errors turn far less than the reading itself, so each
    round gains two digits or more.
    """
    reading = np.array(angle, dtype=float)
    still = np.zeros_like(reading)
    for _ in range(50):
        error = gaze_angle(theta, Gaze(still, still, reading, still)) - angle
        reading -= error
        if np.all(np.abs(error) < 1e-15 * ENCODER_CENTRE_RAD):
            break
    return reading


_GENERATORS = {
    0: np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    2: np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]]),
}


def _rotation(axis: int, angle: FloatArray) -> FloatArray:
    """Return rotations about a coordinate axis, shape (..., 3, 3) (Rodrigues' formula)."""
    k = _GENERATORS[axis]
    a = np.asarray(angle)[..., None, None]
    rotation: FloatArray = np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * (k @ k)
    return rotation


@dataclass(frozen=True)
class Frame:
    """The parts of the turning plane that do not turn, for parameters of shape (..., COUNT).

    Parameters
    ----------
    rotation
        Turns the untilted yaw axis, Y, into its true direction, shape (..., 3, 3).
    generators
        For each `AxisTilt`, by its place in `PARAMETERS`: the matrix G, shape (..., 3, 3), with
        d(rotation)/d(tilt) = G rotation.
    roll
        Roll of C2, rad, shape (...).
    point
        Where the yaw axis crosses Y = 0, mm, shape (..., 3).
    offset
        Signed distance from `point` to the plane, mm, shape (...).
    """

    rotation: FloatArray
    generators: Mapping[int, FloatArray]
    roll: FloatArray
    point: FloatArray
    offset: FloatArray

    def basis(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return u, v, w, each (..., 3): the normal at angle a is sin(a) u + cos(a) v + w."""
        cos, sin = np.cos(self.roll)[..., None], np.sin(self.roll)[..., None]
        r = self.rotation
        return cos * r[..., :, 0], cos * r[..., :, 2], sin * r[..., :, 1]

    def basis_by_roll(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the derivatives of `basis` by the roll, per rad."""
        cos, sin = np.cos(self.roll)[..., None], np.sin(self.roll)[..., None]
        r = self.rotation
        return -sin * r[..., :, 0], -sin * r[..., :, 2], cos * r[..., :, 1]


def frame(theta: FloatArray) -> Frame:
    """Return the fixed parts of the plane for parameters `theta`, shape (..., COUNT)."""
    shape = theta.shape[:-1]
    rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    generators: dict[int, FloatArray] = {}
    point, offset, roll = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape)
    for i, parameter in enumerate(PARAMETERS):
        match parameter.effect:
            case AxisPoint(direction=direction):
                point = point + theta[..., i, None] * np.array(direction)
            case PlaneOffset():
                offset = offset + theta[..., i]
            case AxisTilt(about=axis):
                turn = _rotation(axis, theta[..., i])
                rotation = turn @ rotation
                # A tilt applied earlier is carried along by this one.
                generators = {j: turn @ g @ turn.swapaxes(-1, -2) for j, g in generators.items()}
                generators[i] = _GENERATORS[axis]
            case GazeRoll():
                roll = roll + theta[..., i]
    return Frame(rotation, generators, roll, point, offset)


def _combine(basis: tuple[FloatArray, FloatArray, FloatArray], angle: FloatArray) -> FloatArray:
    """Return sin(angle) u + cos(angle) v + w, shape (n, 3), for one basis or one each."""
    u, v, w = basis
    return np.sin(angle)[:, None] * u + np.cos(angle)[:, None] * v + w


def _rays(gaze: Gaze) -> FloatArray:
    return np.stack([gaze.x1c, gaze.y1c, np.ones_like(gaze.x1c)], axis=-1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of rows, shape (n,)."""
    product: FloatArray = (a * b).sum(axis=-1)
    return product


def depth(theta: FloatArray, gaze: Gaze) -> FloatArray:
    """Return depths, mm, shape (n,).

    `theta` is one parameter vector, shape (COUNT,), or one for each gaze, shape (n, COUNT). A
    depth is negative or infinite where the ray does not meet the plane in front of C1; callers
    decide what that means.
    """
    f = frame(theta)
    angle = gaze_angle(theta, gaze) if theta.ndim == 1 else _own_angles(theta, gaze)
    n = _combine(f.basis(), angle)
    with np.errstate(divide="ignore"):
        z: FloatArray = (_dot(n, f.point) + f.offset) / _dot(n, _rays(gaze))
    return z


def _own_angles(thetas: FloatArray, gaze: Gaze) -> FloatArray:
    """Return the true gaze angle, rad, shape (n,), of each gaze under its own parameters."""
    angle: FloatArray = gaze.alpha2 + gaze.residual
    for i, parameter in enumerate(PARAMETERS):
        if isinstance(parameter.effect, EncoderTerm):
            angle = angle + thetas[:, i] * parameter.effect.basis(gaze.alpha2)
    return angle


def gaze_at(theta: FloatArray, points: FloatArray) -> Gaze:
    """Return the gazes, without residual, at points of frame C1, mm, shape (n, 3).

    The measurement run backwards: C1 sees the point, C2 turns until its plane holds it.

    Raises
    ------
    ValueError
        If a point lies so near the yaw axis that no gaze plane reaches it.
    """
    f = frame(theta)
    u, v, w = f.basis()
    # The plane holds the point where sin(a) A + cos(a) B = C. Of the two solutions the second
    # looks towards the point, the first away from it.
    arm = points - f.point
    a, b, c = arm @ u, arm @ v, f.offset - arm @ w
    reach = np.hypot(a, b)
    if np.any(reach <= np.abs(c)):
        raise ValueError(
            "a point lies within the eccentricity of the yaw axis: C2 cannot gaze at it"
        )
    angle = np.pi - np.arcsin(c / reach) - np.arctan2(b, a)
    x1c, y1c = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    return Gaze(x1c, y1c, encoder_reading(theta, angle), np.zeros(len(points)))


@dataclass(frozen=True)
class Closure:
    """How far rows miss the gaze plane, F = (n . p + e) / z - n . r, with its derivatives.

    Parameters
    ----------
    value
        F, dimensionless, shape (n,); F / sin(a) is the angle-like residual of the reports.
    by_theta
        Shape (n, COUNT), per unit of each parameter.
    by_observable
        Shape (n, 5), columns as in `OBSERVABLE`.
    """

    value: FloatArray
    by_theta: FloatArray
    by_observable: FloatArray


def closure(theta: FloatArray, gaze: Gaze, z: FloatArray) -> Closure:
    """Return the closure of rows whose depth `z`, mm, shape (n,), is known.

    Parameters
    ----------
    theta
        One parameter vector, shape (COUNT,).
    """
    f = frame(theta)
    angle = gaze_angle(theta, gaze)
    u, v, w = f.basis()
    n = _combine((u, v, w), angle)
    rays = _rays(gaze)
    arm = f.point / z[:, None] - rays
    # d(normal)/d(angle) = cos(a) u - sin(a) v, the normal a quarter turn on, without w.
    by_angle = _dot(_combine((u, v, np.zeros(3)), angle + np.pi / 2), arm)
    numerator = _dot(n, f.point) + f.offset

    by_theta = np.empty((len(z), len(PARAMETERS)))
    by_alpha2 = np.ones(len(z))
    for i, parameter in enumerate(PARAMETERS):
        match parameter.effect:
            case EncoderTerm(basis=basis, slope=slope):
                by_theta[:, i] = by_angle * basis(gaze.alpha2)
                by_alpha2 += theta[i] * slope(gaze.alpha2)
            case AxisPoint(direction=direction):
                by_theta[:, i] = n @ np.array(direction, dtype=float) / z
            case PlaneOffset():
                by_theta[:, i] = 1 / z
            case AxisTilt():
                by_theta[:, i] = _dot(n @ f.generators[i].T, arm)
            case GazeRoll():
                by_theta[:, i] = _dot(_combine(f.basis_by_roll(), angle), arm)
    by_observable = np.stack(
        [-n[:, 0], -n[:, 1], by_angle * by_alpha2, by_angle, -numerator / z**2], axis=-1
    )
    return Closure(numerator / z - _dot(n, rays), by_theta, by_observable)


@dataclass(frozen=True)
class DepthJacobian:
    """Depths with their derivatives.

    Parameters
    ----------
    z
        mm, shape (n,).
    by_theta
        Shape (n, COUNT), mm per unit of each parameter.
    by_observable
        Shape (n, 4): x1c, y1c, alpha2 and gaze residual, columns as in `OBSERVABLE`.
    """

    z: FloatArray
    by_theta: FloatArray
    by_observable: FloatArray


def depth_jacobian(theta: FloatArray, gaze: Gaze) -> DepthJacobian:
    """Return depths for one parameter vector, shape (COUNT,), with their derivatives.

    For `base` these are eqs. (10) and (12) of Xu and Wang with the full angle alpha2 + delta2.
    """
    z = depth(theta, gaze)
    c = closure(theta, gaze, z)
    # F(theta, q, z) = 0 defines z, so dz = -F_q dq / F_z.
    slope = -1 / c.by_observable[:, OBSERVABLE.z, None]
    return DepthJacobian(z, slope * c.by_theta, slope * c.by_observable[:, : OBSERVABLE.z])
