"""Where C2 stands at a reading, by the parameters of the rig, with derivatives.

C2 turns rigidly about the yaw axis. Its pose in C1 at the turn phi from 90 degrees is

    R12 = Rz(tau_z) Rx(tau_x) Ry(phi) Rz(rho) Rx(pitch),     t12 = p + R12 m,

with p = (L_b, 0, Z_a) the point of the axis in C1's plane Y = 0 and m = (e, h, f) C2's centre from
there in C2's own axes: eccentricity, height, standoff. Its image x axis is then the normal of the
gaze plane of `calib.geometry.plane`. A point P of C1 is seen at R12' (P - p) - m.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import ENCODER_CENTRE_RAD, NAMES, PARAMETERS, EncoderTerm

HEIGHT, PITCH = "height_mm", "pitch_rad"
"""C2's centre down its image y axis from the axis point, and its turn about its image x axis: they
leave the gaze plane where it is, but pictures show them."""

_SHIFTS = {
    "baseline_mm": 0,
    "axis_z_mm": 2,
}
_MOUNT = ("eccentricity_mm", HEIGHT, "standoff_mm")
_TURNS = ("axis_tilt_z_rad", "axis_tilt_x_rad", "gaze_roll_rad", PITCH)

ENCODER: dict[str, EncoderTerm] = {
    p.name: p.effect for p in PARAMETERS if isinstance(p.effect, EncoderTerm)
}
"""Parameters that change the turn, with their effects."""

RIG: tuple[str, ...] = (
    *(name for name in NAMES if name in {*_SHIFTS, *ENCODER, *_TURNS, *_MOUNT}),
    HEIGHT,
    PITCH,
)
"""Unknowns of the rig: those of the model's parameters that move C2, and two that move it alone."""

_X = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_Y = np.array([[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]])
_Z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])


class Turned(NamedTuple):
    """C2 at m readings.

    Parameters
    ----------
    back
        R12', shape (m, 3, 3).
    by_turn
        Its derivative by the turn phi, shape (m, 3, 3).
    by_angle
        Its derivatives by the tilts about Z and X, roll and pitch, shape (4, m, 3, 3).
    point
        p, mm, shape (3,).
    mount
        m, mm, shape (3,).
    basis
        Derivative of the turns by each of `ENCODER`, shape (m, terms).
    """

    back: FloatArray
    by_turn: FloatArray
    by_angle: FloatArray
    point: FloatArray
    mount: FloatArray
    basis: FloatArray


def _about(generator: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Return rotations, shape (..., 3, 3) (Rodrigues' formula)."""
    a = np.asarray(angle, dtype=float)[..., None, None]
    turn: FloatArray = np.eye(3) + np.sin(a) * generator + (1 - np.cos(a)) * generator @ generator
    return turn


def turned(rig: FloatArray, readings: FloatArray, errors: FloatArray) -> Turned:
    """Return C2 at readings.

    Parameters
    ----------
    rig
        Values of `RIG`, shape (13,).
    readings, errors
        Of the encoder, and by how much C2 truly stands farther, rad, shape (m,).
    """
    value = dict(zip(RIG, rig, strict=True))
    basis = np.stack([term.basis(readings) for term in ENCODER.values()], axis=-1)
    phi = readings - ENCODER_CENTRE_RAD + errors
    phi = phi + basis @ np.array([value[name] for name in ENCODER])
    tilt_z, tilt_x, roll, pitch = (float(value[name]) for name in _TURNS)
    level, rolled = _about(_X, -pitch), _about(_Z, -roll)
    nod, lean = _about(_X, -tilt_x), _about(_Z, -tilt_z)
    yaw = _about(_Y, -phi)
    inner, outer = level @ rolled, nod @ lean
    back = inner @ yaw @ outer
    by_turn = inner @ (-_Y @ yaw) @ outer
    by_angle = np.stack(
        [
            inner @ yaw @ (nod @ -_Z @ lean),
            inner @ yaw @ (-_X @ outer),
            level @ -_Z @ rolled @ yaw @ outer,
            -_X @ back,
        ]
    )
    point = np.array([value["baseline_mm"], 0.0, value["axis_z_mm"]])
    mount = np.array([value[name] for name in _MOUNT])
    return Turned(back, by_turn, by_angle, point, mount, basis)


def seen(c2: Turned, points: FloatArray) -> FloatArray:
    """Return points of C1, shape (m, k, 3), one set a reading, in C2, mm."""
    return (points - c2.point) @ c2.back.swapaxes(-1, -2) - c2.mount


def seen_by_turn(c2: Turned, points: FloatArray) -> FloatArray:
    """Return the derivative of `seen` by the turns, mm/rad, shape (m, k, 3)."""
    by: FloatArray = (points - c2.point) @ c2.by_turn.swapaxes(-1, -2)
    return by


def seen_by_rig(c2: Turned, points: FloatArray) -> FloatArray:
    """Return the derivative of `seen` by `RIG`, shape (m, k, 3, 13)."""
    arm = points - c2.point
    by = np.zeros((*points.shape, len(RIG)))
    by_turn = seen_by_turn(c2, points)
    for k, name in enumerate(ENCODER):
        by[..., RIG.index(name)] = by_turn * c2.basis[:, k, None, None]
    for name, slope in zip(_TURNS, c2.by_angle, strict=True):
        by[..., RIG.index(name)] = arm @ slope.swapaxes(-1, -2)
    for name, axis in _SHIFTS.items():
        by[..., RIG.index(name)] = -c2.back[:, None, :, axis]
    for axis, name in enumerate(_MOUNT):
        by[..., axis, RIG.index(name)] = -1.0
    return by


def pose_of(rig: FloatArray, reading: float, error: float = 0.0) -> FloatArray:
    """Return 1T2, the pose of C2 in C1 at a reading, shape (4, 4), mm."""
    c2 = turned(rig, np.array([reading]), np.array([error]))
    pose = np.eye(4)
    pose[:3, :3] = c2.back[0].T
    pose[:3, 3] = c2.point + pose[:3, :3] @ c2.mount
    return pose


LINE = ("baseline_mm", "axis_z_mm", "axis_tilt_z_rad", "axis_tilt_x_rad", "delta2_rad")
"""Unknowns that move C2 and its axis as one rigid body; a shift of C2 along the axis makes six."""


def rig_by_turn_of_c1(rig: FloatArray) -> FloatArray:
    """Return d(`RIG`)/d(w), shape (13, 3), for a turn w of C1 about its own centre, rad.

    Points P of its frame move to P + w x P, and with them C2 and its axis.
    """
    reading = ENCODER_CENTRE_RAD
    pose, by_rig = pose_by_rig(rig, reading)
    turn = pose_of(rig, reading)[:3, :3]
    slope = cv2.Rodrigues(turn)[1].reshape(-1, 3).T
    by_turn = np.stack(
        [np.concatenate([slope @ (spin @ turn).ravel(), spin @ pose[3:]]) for spin in (_X, _Y, _Z)],
        axis=1,
    )
    value = dict(zip(RIG, rig, strict=True))
    axis_in_c2 = (_about(_X, -value[PITCH]) @ _about(_Z, -value["gaze_roll_rad"]))[:, 1]
    free = np.zeros((len(RIG), len(LINE) + 1))
    free[[RIG.index(name) for name in LINE], np.arange(len(LINE))] = 1.0
    free[[RIG.index(name) for name in _MOUNT], -1] = axis_in_c2
    moved: FloatArray = free @ np.linalg.solve(by_rig @ free, by_turn)
    return moved


def pose_by_rig(rig: FloatArray, reading: float) -> tuple[FloatArray, FloatArray]:
    """Return 1T2 as rotation vector and translation, shape (6,), with d/d(`RIG`), shape (6, 13)."""
    pose = pose_of(rig, reading)
    turn, slope = cv2.Rodrigues(pose[:3, :3])
    c2 = turned(rig, np.array([reading]), np.zeros(1))
    by_turn = np.zeros((len(RIG), 3, 3))
    for k, name in enumerate(ENCODER):
        by_turn[RIG.index(name)] = c2.by_turn[0].T * c2.basis[0, k]
    for name, part in zip(_TURNS, c2.by_angle, strict=True):
        by_turn[RIG.index(name)] = part[0].T
    by = np.zeros((6, len(RIG)))
    # cv2 returns d(vector)/d(matrix), shape (9, 3), entries of the matrix row by row.
    by[:3] = slope.reshape(-1, 3).T @ by_turn.reshape(len(RIG), 9).T
    by[3:] = (by_turn @ c2.mount).T
    for name, axis in _SHIFTS.items():
        by[3 + axis, RIG.index(name)] += 1.0
    for axis, name in enumerate(_MOUNT):
        by[3:, RIG.index(name)] += pose[:3, axis]
    return np.concatenate([turn.ravel(), pose[:3, 3]]), by
