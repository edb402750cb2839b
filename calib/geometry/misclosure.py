r"""How far rows miss the gaze plane, and what depth does when anything changes: all derivatives.

The misclosure of a row whose depth z is known is :math:`F = (n \cdot p + e) / z - n \cdot r`, in
the notation of `calib.geometry.plane`. F = 0 defines depth, so that depth's derivatives follow from
those of F. Lengths in mm, angles in rad.
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
)
from calib.geometry.plane import OBSERVABLE, Basis, Gaze, depth, frame, gaze_angle


@dataclass(frozen=True)
class Misclosure:
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


@dataclass(frozen=True)
class _Turned:
    """Gaze planes at their angles: sine and cosine, shape (n,), of each."""

    sine: FloatArray
    cosine: FloatArray

    @classmethod
    def at(cls, theta: FloatArray, gaze: Gaze) -> _Turned:
        angle = gaze_angle(theta, gaze)
        return cls(np.sin(angle), np.cos(angle))

    def quarter_on(self) -> _Turned:
        """Return the planes a quarter turn on: by it the normal changes per rad, w left out."""
        return _Turned(self.cosine, -self.sine)

    def along(self, basis: Basis, direction: FloatArray) -> FloatArray:
        """Return the normals' component along a fixed vector, shape (n,)."""
        u, v, w = basis
        component: FloatArray = self.sine * (u @ direction)
        component += self.cosine * (v @ direction)
        component += w @ direction
        return component

    def on_arm(self, basis: Basis, point: FloatArray, gaze: Gaze, z: FloatArray) -> FloatArray:
        """Return n . (point / z - r), shape (n,)."""
        product = self.along(basis, point)
        product /= z
        product -= self.on_ray(basis, gaze)
        return product

    def on_ray(self, basis: Basis, gaze: Gaze) -> FloatArray:
        """Return n . r for the ray r = (x1c, y1c, 1) of each gaze, shape (n,)."""
        x, y, z = np.eye(3)
        product = self.along(basis, z)
        product += self.along(basis, x) * gaze.x1c
        product += self.along(basis, y) * gaze.y1c
        return product


def misclosure_value(theta: FloatArray, gaze: Gaze, z: FloatArray) -> FloatArray:
    """Return the value of `misclosure` alone, shape (n,): a fifth of its work."""
    f, turned = frame(theta), _Turned.at(theta, gaze)
    value = turned.on_arm(f.basis(), f.point, gaze, z)
    value += f.offset / z
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
    f, turned = frame(theta), _Turned.at(theta, gaze)
    basis, on = f.basis(), turned.quarter_on()
    still = (basis[0], basis[1], np.zeros(3))
    by_angle = on.on_arm(still, f.point, gaze, z)
    numerator = turned.along(basis, f.point) + f.offset
    wanted = range(len(PARAMETERS)) if parameters is None else parameters
    # Columns are contiguous: they are made, scaled and summed one by one.
    by_theta = np.empty((len(wanted), len(z))).T
    for column, i in enumerate(wanted):
        match PARAMETERS[i].effect:
            case EncoderTerm(basis=term):
                by_theta[:, column] = by_angle * term(gaze.alpha2)
            case AxisPoint(direction=direction):
                by_theta[:, column] = turned.along(basis, np.array(direction, dtype=float)) / z
            case PlaneOffset():
                by_theta[:, column] = 1 / z
            case AxisTilt():
                u, v, w = (f.generators[i] @ b for b in basis)
                by_theta[:, column] = turned.on_arm((u, v, w), f.point, gaze, z)
            case GazeRoll():
                by_theta[:, column] = turned.on_arm(f.basis_by_roll(), f.point, gaze, z)
    x, y, _ = np.eye(3)
    by_observable = np.stack(
        [
            -turned.along(basis, x),
            -turned.along(basis, y),
            by_angle * _reading_slope(theta, gaze),
            by_angle,
            -numerator / z**2,
        ]
    ).T
    return Misclosure(numerator / z - turned.on_ray(basis, gaze), by_theta, by_observable)


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


def depth_jacobian(theta: FloatArray, gaze: Gaze) -> DepthJacobian:
    """Return depths for one parameter vector, shape (COUNT,), with their derivatives.

    For `base` these are eqs. (10) and (12) of Xu and Wang with the full angle alpha2 + delta2.
    """
    z = depth(theta, gaze)
    c = misclosure(theta, gaze, z)
    # F(theta, q, z) = 0 defines z, so dz = -F_q dq / F_z.
    slope = -1 / c.by_observable[:, OBSERVABLE.z, None]
    return DepthJacobian(z, slope * c.by_theta, slope * c.by_observable[:, : OBSERVABLE.z])
