r"""How far rows miss the gaze plane, and what depth does when anything changes: all derivatives.

The misclosure of a row whose depth z is known is :math:`F = (n \cdot p + e) / z - n \cdot r`, in
the notation of `calib.geometry.plane`. A reference depth z that counts from o in front of C1's
centre is the depth z + o: then :math:`F = (n \cdot p + e - o\, n \cdot r) / z - n \cdot r`, the
same but for the factor (z + o) / z, and linear in o. F = 0 defines depth, so that depth's
derivatives follow from those of F (there o = 0); for a target off C2's centre column n and e are
those of its own plane there. Lengths in mm, angles in rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import (
    PARAMETERS,
    AxisPoint,
    AxisTilt,
    EncoderTerm,
    GazeRoll,
    PlaneOffset,
    ReferenceOffset,
    Standoff,
)
from calib.geometry.plane import (
    OBSERVABLE,
    Axes,
    FixedParts,
    Gaze,
    Turn,
    depth,
    frame,
    gaze_angle,
    turn_planes,
)


@dataclass(frozen=True)
class Misclosure:
    """How far rows miss the gaze plane, F = (n . p + e - o n . r) / z - n . r, with derivatives.

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


@dataclass(frozen=True)
class _Arm:
    """From targets to the yaw axis, over their depths.

    Parameters
    ----------
    point
        Of the axis, mm, shape (3,).
    gaze, z
        Rows, and their depths as stated, mm, shape (n,).
    stretch
        Depth z' from C1's centre over stated depth, shape (n,) or 1.
    """

    point: FloatArray
    gaze: Gaze
    z: FloatArray
    stretch: FloatArray | float

    @classmethod
    def of(cls, f: FixedParts, gaze: Gaze, z: FloatArray) -> _Arm:
        return cls(f.point, gaze, z, 1 + f.origin / z if f.origin else 1.0)


@dataclass(frozen=True)
class _Direction:
    """Vectors of gazes as parts along three fixed ones: shape (n,), or numbers, each."""

    sine: FloatArray
    cosine: FloatArray
    level: FloatArray | float

    def along(self, axes: Axes, direction: FloatArray) -> FloatArray:
        """Return the component along a fixed vector, shape (n,)."""
        x, z, y = axes
        component: FloatArray = self.sine * (x @ direction)
        component += self.cosine * (z @ direction)
        component += self.level * (y @ direction)
        return component

    def on_arm(self, axes: Axes, arm: _Arm) -> FloatArray:
        """Return n . (point / z - r z' / z), shape (n,)."""
        product = self.along(axes, arm.point)
        product /= arm.z
        product -= self.on_ray(axes, arm.gaze) * arm.stretch
        return product

    def on_ray(self, axes: Axes, gaze: Gaze) -> FloatArray:
        """Return n . r for the ray r = (x1c, y1c, 1) of each gaze, shape (n,)."""
        x, y, z = np.eye(3)
        product = self.along(axes, z)
        product += self.along(axes, x) * gaze.x1c
        product += self.along(axes, y) * gaze.y1c
        return product


@dataclass(frozen=True)
class _Turned:
    """The planes of gazes, and how their normals change.

    Parameters
    ----------
    normal
        Of the planes.
    by_angle, by_residual, by_roll
        Its derivatives, per rad; `by_residual` at constant gaze angle less residual.
    turn
        The distances from the axis.
    """

    normal: _Direction
    by_angle: _Direction
    by_residual: _Direction
    by_roll: _Direction
    turn: Turn

    @classmethod
    def at(cls, theta: FloatArray, gaze: Gaze, roll: FloatArray) -> _Turned:
        angle, r = gaze_angle(theta, gaze), gaze.residual
        turn = turn_planes(angle, r, roll)
        sine, cosine = turn.sine, turn.cosine
        by_angle = by_residual = _Direction(cosine, -sine, 0.0)
        nought = np.zeros_like(sine)
        by_roll = _Direction(nought, nought, turn.beside * np.cos(roll))
        if roll != 0:
            still = angle - r
            sine_0, cosine_0 = np.sin(still), np.cos(still)
            less = -turn.beside * np.sin(roll)
            by_roll = _Direction(less * sine_0, less * cosine_0, turn.beside * np.cos(roll))
            # d/dr of cos(r) cos(roll) sin(a) + sin(r) cos(a), and so on, at constant a.
            tilted = turn.ahead * np.cos(roll)
            by_residual = _Direction(
                tilted * sine_0 + turn.beside * cosine_0,
                tilted * cosine_0 - turn.beside * sine_0,
                turn.ahead * np.sin(roll),
            )
        return cls(_Direction(sine, cosine, turn.level), by_angle, by_residual, by_roll, turn)


def misclosure_value(theta: FloatArray, gaze: Gaze, z: FloatArray) -> FloatArray:
    """Return the value of `misclosure` alone, shape (n,): a fifth of its work."""
    f = frame(theta)
    turn = turn_planes(gaze_angle(theta, gaze), gaze.residual, f.roll)
    value = _Direction(turn.sine, turn.cosine, turn.level).on_arm(f.axes, _Arm.of(f, gaze, z))
    value += turn.offset(f.offset, f.standoff) / z
    return value


def misclosure(
    theta: FloatArray, gaze: Gaze, z: FloatArray, *, parameters: Sequence[int] | None = None
) -> Misclosure:
    """Return the misclosure of rows whose depth `z`, mm, shape (n,), is known.

    Parameters
    ----------
    theta
        One parameter vector, shape (COUNT,).
    parameters
        Places in `PARAMETERS` to differentiate by, all of them by default; the columns of
        `by_theta` are in this order.
    """
    f = frame(theta)
    axes, turned, arm = f.axes, _Turned.at(theta, gaze, f.roll), _Arm.of(f, gaze, z)
    normal, turn = turned.normal, turned.turn
    by_angle = turned.by_angle.on_arm(axes, arm)
    on_ray = normal.on_ray(axes, gaze)
    numerator = normal.along(axes, f.point) + turn.offset(f.offset, f.standoff) - f.origin * on_ray
    wanted = range(len(PARAMETERS)) if parameters is None else parameters
    # Columns are contiguous: they are made, scaled and summed one by one.
    by_theta = np.empty((len(wanted), len(z))).T
    for column, i in enumerate(wanted):
        match PARAMETERS[i].effect:
            case EncoderTerm(basis=term):
                by_theta[:, column] = by_angle * term(gaze.alpha2)
            case AxisPoint(direction=direction):
                by_theta[:, column] = normal.along(axes, np.array(direction, dtype=float)) / z
            case PlaneOffset():
                by_theta[:, column] = turn.beside / z
            case Standoff():
                by_theta[:, column] = turn.ahead / z
            case ReferenceOffset():
                by_theta[:, column] = -on_ray / z
            case AxisTilt():
                x_, z_, y_ = (f.generators[i] @ b for b in axes)
                by_theta[:, column] = normal.on_arm((x_, z_, y_), arm)
            case GazeRoll():
                by_theta[:, column] = turned.by_roll.on_arm(axes, arm)
    x, y, _ = np.eye(3)
    by_residual = turned.by_residual.on_arm(axes, arm) if f.roll else by_angle
    # d(e cos r - f sin r) / dr.
    by_residual = by_residual + (f.offset * turn.ahead - f.standoff * turn.beside) / z
    by_observable = np.stack(
        [
            -normal.along(axes, x) * arm.stretch,
            -normal.along(axes, y) * arm.stretch,
            by_angle * _reading_slope(theta, gaze),
            by_residual,
            -numerator / z**2,
        ]
    ).T
    return Misclosure(numerator / z - on_ray, by_theta, by_observable)


def _reading_slope(theta: FloatArray, gaze: Gaze) -> FloatArray:
    """Return d(gaze angle) / d(encoder reading), shape (n,)."""
    slope = np.ones(len(gaze))
    for i, parameter in enumerate(PARAMETERS):
        if isinstance(parameter.effect, EncoderTerm) and theta[i] != 0:
            slope += theta[i] * parameter.effect.slope(gaze.alpha2)
    return slope


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


_OF_ROWS_ALONE = np.array([isinstance(p.effect, ReferenceOffset) for p in PARAMETERS])
"""Parameters that no measured depth has, shape (COUNT,)."""


def depth_jacobian(theta: FloatArray, gaze: Gaze) -> DepthJacobian:
    """Return depths for one parameter vector, shape (COUNT,), with their derivatives.

    For `base` these are eqs. (10) and (12) of Xu and Wang with the full angle alpha2 + delta2.
    """
    z = depth(theta, gaze)
    measured = np.where(_OF_ROWS_ALONE, 0.0, theta)
    c = misclosure(measured, gaze, z)
    # F(theta, q, z) = 0 defines z, so dz = -F_q dq / F_z.
    slope = -1 / c.by_observable[:, OBSERVABLE.z, None]
    return DepthJacobian(
        z, slope * c.by_theta * ~_OF_ROWS_ALONE, slope * c.by_observable[:, : OBSERVABLE.z]
    )
