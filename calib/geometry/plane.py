r"""A ray of C1 meets the turning gaze plane of C2.

With the unit normal :math:`n(\alpha)`, a point :math:`p` of the yaw axis, its signed distance
:math:`e` to the plane and the ray :math:`r = (x_{1c}, y_{1c}, 1)`, depth is

.. math:: z = \frac{n(\alpha) \cdot p + e}{n(\alpha) \cdot r}.

Untilted it reads z (x1c + cot a) = L_b + Z_a cot a + e / sin a; with Z_a = e = 0 it is eq. (10)'s
parent, eq. (6) of Xu and Wang (doi 10.1177/1729881417715984) with the cotangent that the geometry
needs in place of the printed tangent.

That is the plane of a target on C2's centre column. A target at the angle r beside it, as C2's
image shows it, lies on the plane through C2's centre and image y axis that is turned by r: about
C2's centre, which stands the standoff f ahead of the axis along the optical axis g. Its normal is
cos(r) n - sin(r) g and its distance from the axis e cos(r) - f sin(r). With :math:`\rho` the roll
of C2 and :math:`R_X, R_Y, R_Z` the turned axes, both are

.. math:: (\cos r \cos\rho \sin\alpha + \sin r \cos\alpha) R_X
          + (\cos r \cos\rho \cos\alpha - \sin r \sin\alpha) R_Z + \cos r \sin\rho\, R_Y,

without roll simply :math:`n(\alpha + r)`. A pitch of C2 by p, which the model does not have, adds
p r times the target's height in C2's image to the angle.

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
    ReferenceOffset,
    Standoff,
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
        Angle at C2's centre from its centre column to the target, rad, shape (n,).
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
    """Return true gaze angles, rad, shape (..., n), for parameters of shape (..., COUNT).

    With the gaze residual: the bearing of the target, seen from C2, in the plane square to an axis
    parallel to C2's image y axis.
    """
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


@dataclass(frozen=True)
class FixedParts:
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
        Signed distance from `point` to the plane of targets on the centre column, mm, shape (...).
    standoff
        C2's centre ahead of the axis along its optical axis, mm, shape (...).
    origin
        How far in front of C1's centre reference depths are counted from, mm, shape (...).
    """

    rotation: FloatArray
    generators: Mapping[int, FloatArray]
    roll: FloatArray
    point: FloatArray
    offset: FloatArray
    standoff: FloatArray
    origin: FloatArray

    @property
    def axes(self) -> Axes:
        """The turned X, Z and Y, each (..., 3): what the parts of `Turn` multiply."""
        r = self.rotation
        return r[..., :, 0], r[..., :, 2], r[..., :, 1]

    def basis(self) -> Axes:
        """Return u, v, w, each (..., 3): the normal at angle a is sin(a) u + cos(a) v + w."""
        cos, sin = np.cos(self.roll)[..., None], np.sin(self.roll)[..., None]
        x, z, y = self.axes
        return cos * x, cos * z, sin * y


Axes: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""Three vectors, each (..., 3)."""


def frame(theta: FloatArray) -> FixedParts:
    """Return the fixed parts of the plane for parameters `theta`, shape (..., COUNT)."""
    shape = theta.shape[:-1]
    rotation = np.broadcast_to(np.eye(3), (*shape, 3, 3))
    generators: dict[int, FloatArray] = {}
    point, roll = np.zeros((*shape, 3)), np.zeros(shape)
    offset, standoff, origin = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for i, parameter in enumerate(PARAMETERS):
        match parameter.effect:
            case AxisPoint(direction=direction):
                point = point + theta[..., i, None] * np.array(direction)
            case PlaneOffset():
                offset = offset + theta[..., i]
            case Standoff():
                standoff = standoff + theta[..., i]
            case ReferenceOffset():
                origin = origin + theta[..., i]
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
    return FixedParts(rotation, generators, roll, point, offset, standoff, origin)


@dataclass(frozen=True)
class Turn:
    """Normals of the planes of gazes, as parts along `FixedParts.axes`, and their distances.

    Parameters
    ----------
    sine, cosine, level
        Parts along the turned X, Z and Y: shape (n,) each, `level` also a number.
    beside, ahead
        What eccentricity and standoff are multiplied with to give the distance from the axis:
        cos(r) and -sin(r) of the gaze residual r, shape (n,), or 1 and 0 where all are 0.
    """

    sine: FloatArray
    cosine: FloatArray
    level: FloatArray | float
    beside: FloatArray | float
    ahead: FloatArray | float

    def offset(self, eccentricity: FloatArray, standoff: FloatArray) -> FloatArray:
        """Return the planes' distances from the axis, mm, shape (n,) or ()."""
        distance: FloatArray = eccentricity * self.beside + standoff * self.ahead
        return distance


def turn_planes(angle: FloatArray, residual: FloatArray, roll: FloatArray) -> Turn:
    """Return the planes at gaze angles, their residuals r in them, under a roll.

    Parameters
    ----------
    angle, residual
        As `gaze_angle` and `Gaze.residual`, rad, shape (n,).
    roll
        Roll of C2, rad, shape (n,) or ().
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    off_centre, rolled = bool(np.any(residual)), bool(np.any(roll))
    cos_r = np.cos(residual) if off_centre else 1.0
    sin_r = np.sin(residual) if off_centre else 0.0
    if not rolled:
        return Turn(sine, cosine, 0.0, cos_r, -sin_r)
    cos_roll, level = np.cos(roll), np.sin(roll) * cos_r
    if not off_centre:
        return Turn(cos_roll * sine, cos_roll * cosine, level, cos_r, -sin_r)
    still = angle - residual
    less = (1 - cos_roll) * cos_r
    return Turn(sine - less * np.sin(still), cosine - less * np.cos(still), level, cos_r, -sin_r)


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
    if theta.ndim > 1:
        return drawn_planes(theta).depth(gaze)
    f = frame(theta)
    turn = turn_planes(gaze_angle(theta, gaze), gaze.residual, f.roll)
    x, z, y = f.axes
    n = np.asarray(turn.sine)[:, None] * x + turn.cosine[:, None] * z
    n = n + np.broadcast_to(turn.level, len(gaze))[:, None] * y
    with np.errstate(divide="ignore"):
        found: FloatArray = (_dot(n, f.point) + turn.offset(f.offset, f.standoff)) / _dot(
            n, _rays(gaze)
        )
    return found


@dataclass(frozen=True)
class DrawnPlanes:
    """Gaze planes of many parameter vectors, with what does not turn computed once.

    Parameters
    ----------
    theta
        Shape (t, COUNT).
    frame
        Their frames.
    reach
        For each of the axes, its product with the axis point, mm, shape (t,) each.
    """

    theta: FloatArray
    frame: FixedParts
    reach: tuple[FloatArray, FloatArray, FloatArray]

    def depth(self, gaze: Gaze) -> FloatArray:
        """Return the depths, mm, shape (t,), of gazes, one a vector: `depth` for the same target.

        Of the t gazes each belongs to one vector; signs and infinities as there.
        """
        f = self.frame
        turn = turn_planes(_own_angles(self.theta, gaze), gaze.residual, f.roll)
        rays = _rays(gaze)
        along = [_dot(b, rays) for b in f.axes]
        numerator = turn.sine * self.reach[0] + turn.cosine * self.reach[1]
        numerator = numerator + (turn.level * self.reach[2] + turn.offset(f.offset, f.standoff))
        with np.errstate(divide="ignore"):
            z: FloatArray = numerator / (
                turn.sine * along[0] + turn.cosine * along[1] + turn.level * along[2]
            )
        return z


def drawn_planes(theta: FloatArray) -> DrawnPlanes:
    """Return the planes of parameter vectors, shape (t, COUNT)."""
    f = frame(theta)
    x, z, y = f.axes
    return DrawnPlanes(theta, f, (_dot(x, f.point), _dot(z, f.point), _dot(y, f.point)))


def _own_angles(thetas: FloatArray, gaze: Gaze) -> FloatArray:
    """Return the true gaze angle, rad, shape (n,), of each gaze under its own parameters."""
    angle: FloatArray = gaze.alpha2 + gaze.residual
    for i, parameter in enumerate(PARAMETERS):
        if isinstance(parameter.effect, EncoderTerm) and thetas[:, i].any():
            angle = angle + thetas[:, i] * parameter.effect.basis(gaze.alpha2)
    return angle


class OutOfGazeError(ValueError):
    """A point lies so near the yaw axis that no gaze plane reaches it."""


def gaze_at(theta: FloatArray, points: FloatArray) -> Gaze:
    """Return the gazes, without residual, at points of frame C1, mm, shape (n, 3).

    The measurement run backwards: C1 sees the point, C2 turns until its plane holds it.

    Raises
    ------
    OutOfGazeError
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
        raise OutOfGazeError(
            "a point lies within the eccentricity of the yaw axis: C2 cannot gaze at it"
        )
    angle = np.pi - np.arcsin(c / reach) - np.arctan2(b, a)
    x1c, y1c = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    return Gaze(x1c, y1c, encoder_reading(theta, angle), np.zeros(len(points)))
