"""Where the pairs saw C2 stand, against where the calibrated rig has it.

The rows find the yaw axis and the encoder's zero from depths alone; how C2 stood in the pairs, 1T2
tells by itself. Both meet in two numbers: the angle of C2's gaze plane, which `alpha2_deg` of
[stereo] states as well, and the distance of that plane from the yaw axis, which is e.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.contents import Dataset
from calib.fit.robust import RobustFit
from calib.geometry.parameters import embed
from calib.geometry.plane import Gaze, frame, gaze_angle
from calib.geometry.poses import rotation
from calib.images.stereo.reference import StereoReference
from calib.results.calibration import GazeResult

SIGMAS = 5.0
"""Intrinsics are in the pose and in the rows, whose uncertainties are taken as independent here: at
worst their sum counts, of which this is 3.5 standard deviations."""

FREE_TURN_RAD = float(np.deg2rad(0.05))
"""Play of a yaw drive, which no uncertainty states."""

FREE_SHIFT_MM = 0.2
"""Play of a mount."""

STEP = 1e-6
"""Of the difference quotients, rad and mm."""


@dataclass(frozen=True)
class YawCheck:
    """What the pairs say of C2's gaze plane less what the fit says.

    Parameters
    ----------
    turn_rad, turn_limit_rad
        Of the true gaze angle at the reading, and what chance explains.
    shift_mm, shift_limit_mm
        Of the distance of the plane from the yaw axis, and what chance explains.
    """

    turn_rad: float
    turn_limit_rad: float
    shift_mm: float
    shift_limit_mm: float


def check_yaw(
    fit: RobustFit,
    *,
    pose_12: FloatArray,
    covariance: FloatArray,
    alpha2_rad: float,
    u_alpha2_rad: float,
) -> YawCheck:
    """Compare C2's gaze plane in the pairs with that of a fit at the same reading.

    Parameters
    ----------
    pose_12, covariance
        C2 in C1, rad and mm, shape (6,), and its covariance, shape (6, 6).
    alpha2_rad, u_alpha2_rad
        Reading while the pairs were taken, and its standard uncertainty, the count's included.
    """

    def apart(values: FloatArray, pose: FloatArray) -> FloatArray:
        return _apart(embed(values, fit.names), pose, alpha2_rad)

    difference = apart(fit.values, pose_12)
    by_fit = np.stack(
        [(apart(fit.values + step, pose_12) - difference) / STEP for step in _steps(fit.values)],
        axis=1,
    )
    by_pose = np.stack(
        [(apart(fit.values, pose_12 + step) - difference) / STEP for step in _steps(pose_12)],
        axis=1,
    )
    variance = np.diag(by_fit @ fit.covariance @ by_fit.T + by_pose @ covariance @ by_pose.T)
    turn, shift = (float(d) for d in difference)
    return YawCheck(
        turn_rad=turn,
        turn_limit_rad=max(
            FREE_TURN_RAD, SIGMAS * float(np.hypot(variance[0] ** 0.5, u_alpha2_rad))
        ),
        shift_mm=shift,
        shift_limit_mm=max(FREE_SHIFT_MM, SIGMAS * float(variance[1] ** 0.5)),
    )


def pose_warnings(
    dataset: Dataset, stereo: StereoReference | None, gaze: GazeResult | None
) -> tuple[str, ...]:
    """Return warnings where the pairs contradict the selected model; none without either."""
    stated, encoder = dataset.manifest.stereo, dataset.manifest.encoder
    if stereo is None or stereo.source == "given" or stated is None or stated.alpha2_deg is None:
        return ()
    if gaze is None or gaze.comparison is None or encoder is None:
        return ()
    check = check_yaw(
        gaze.robust[gaze.comparison.selected],
        pose_12=stereo.pose_12,
        covariance=stereo.covariance,
        alpha2_rad=float(np.deg2rad(stated.alpha2_deg)),
        u_alpha2_rad=encoder.std_rad,
    )
    return yaw_warnings(check)


def yaw_warnings(check: YawCheck) -> tuple[str, ...]:
    """Return what of it is no chance."""
    found = []
    if abs(check.turn_rad) > check.turn_limit_rad:
        found.append(
            f"the pairs saw C2 turned {np.degrees(check.turn_rad):+.2f} deg from where the rows "
            f"have it at alpha2_deg of [stereo] (limit {np.degrees(check.turn_limit_rad):.2f}): "
            "check that reading, and whether C2 was moved in its mount between pairs and rows"
        )
    if abs(check.shift_mm) > check.shift_limit_mm:
        found.append(
            f"C2's gaze plane passed the yaw axis {check.shift_mm:+.2f} mm farther in the pairs "
            f"than in the rows (limit {check.shift_limit_mm:.2f}): C2 was moved in its mount "
            "between them, or the selected model is too simple"
        )
    return tuple(found)


def _apart(theta: FloatArray, pose_12: FloatArray, alpha2_rad: float) -> FloatArray:
    """Return turn, rad, and shift, mm, of C2's gaze plane against the model's, shape (2,)."""
    still = np.zeros(1)
    angle = gaze_angle(theta, Gaze(still, still, np.array([alpha2_rad]), still))[0]
    fixed = frame(theta)
    sine, cosine, _ = fixed.basis()
    normal = rotation(pose_12[:3])[:, 0]
    seen = np.arctan2(normal @ sine, normal @ cosine)
    turn = (seen - angle + np.pi) % (2 * np.pi) - np.pi
    shift = normal @ (pose_12[3:] - fixed.point) - fixed.offset
    return np.array([turn, float(shift)])


def _steps(x: FloatArray) -> FloatArray:
    return STEP * np.eye(len(x))
