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
from typing import NamedTuple, TypeAlias

import numpy as np

from calib.core.arrays import FloatArray
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
        if isinstance(parameter.effect, EncoderTerm) and (theta.ndim > 1 or theta[i]):
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


Basis: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""u, v, w, each (..., 3), of a normal sin(a) u + cos(a) v + w."""


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

    def basis(self) -> Basis:
        """Return u, v, w, each (..., 3): the normal at angle a is sin(a) u + cos(a) v + w."""
        cos, sin = np.cos(self.roll)[..., None], np.sin(self.roll)[..., None]
        r = self.rotation
        return cos * r[..., :, 0], cos * r[..., :, 2], sin * r[..., :, 1]

    def basis_by_roll(self) -> Basis:
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
                if theta[..., i].any():
                    turn = _rotation(axis, theta[..., i])
                    rotation = turn @ rotation
                    # A tilt applied earlier is carried along by this one.
                    back = turn.swapaxes(-1, -2)
                    generators = {j: turn @ g @ back for j, g in generators.items()}
                generators[i] = _GENERATORS[axis]
            case GazeRoll():
                roll = roll + theta[..., i]
    return Frame(rotation, generators, roll, point, offset)


def _combine(basis: Basis, angle: FloatArray) -> FloatArray:
    """Return sin(angle) u + cos(angle) v + w, shape (n, 3), for one basis or one each."""
    u, v, w = basis
    return np.sin(angle)[:, None] * u + np.cos(angle)[:, None] * v + w


def _rays(gaze: Gaze) -> FloatArray:
    return np.stack([gaze.x1c, gaze.y1c, np.ones_like(gaze.x1c)], axis=-1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of rows, shape (n,)."""
    # By columns: sums over rows of three would take several times as long.
    product: FloatArray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
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


@dataclass(frozen=True)
class DrawnPlanes:
    """Gaze planes of many parameter vectors, with what does not turn computed once.

    Parameters
    ----------
    theta
        Shape (t, COUNT).
    basis
        As `Frame.basis`, shape (t, 3) each.
    reach
        For each of the basis, its product with the axis point; the last with the offset added, mm,
        shape (t,) each.
    """

    theta: FloatArray
    basis: tuple[FloatArray, FloatArray, FloatArray]
    reach: tuple[FloatArray, FloatArray, FloatArray]

    def depth(self, gaze: Gaze) -> FloatArray:
        """Return the depths, mm, shape (t,), of gazes, one a vector: `depth` for the same target.

        Of the t gazes each belongs to one vector; signs and infinities as there.
        """
        angle = _own_angles(self.theta, gaze)
        sin, cos = np.sin(angle), np.cos(angle)
        rays = _rays(gaze)
        along = [_dot(b, rays) for b in self.basis]
        numerator = sin * self.reach[0] + cos * self.reach[1] + self.reach[2]
        with np.errstate(divide="ignore"):
            z: FloatArray = numerator / (sin * along[0] + cos * along[1] + along[2])
        return z


def drawn_planes(theta: FloatArray) -> DrawnPlanes:
    """Return the planes of parameter vectors, shape (t, COUNT)."""
    f = frame(theta)
    u, v, w = f.basis()
    return DrawnPlanes(
        theta, (u, v, w), (_dot(u, f.point), _dot(v, f.point), _dot(w, f.point) + f.offset)
    )


def _own_angles(thetas: FloatArray, gaze: Gaze) -> FloatArray:
    """Return the true gaze angle, rad, shape (n,), of each gaze under its own parameters."""
    angle: FloatArray = gaze.alpha2 + gaze.residual
    for i, parameter in enumerate(PARAMETERS):
        if isinstance(parameter.effect, EncoderTerm) and thetas[:, i].any():
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
