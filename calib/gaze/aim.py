"""Where C2 has to look for what C1 sees: the readings along the epipolar plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from calib.core.arrays import FloatArray
from calib.gaze.centre import Aim
from calib.geometry.camera import Camera, normalise
from calib.geometry.plane import gaze_at
from calib.rig.protocols import Refused

NEARER, FARTHER = 0.6, 1.7
"""A target is looked for from so much nearer to so much farther than the calibrated depths."""

DEPTHS: Final = 9
"""Depths at which the readings of an interval are computed; they change one way but for a lens
that sees the axis itself."""


class Aiming(Protocol):
    """Tells where to look for a target."""

    def aim(self, pixel_c1: FloatArray, *, depth_mm: float | None) -> Aim:
        """Return where C2 has to look for a pixel of C1, shape (2,).

        Parameters
        ----------
        depth_mm
            Depth at which the target is expected, mm; None if nothing is known.
        """


@dataclass(frozen=True)
class EpipolarAiming:
    """By a calibration, or by what is known of a rig before it.

    Parameters
    ----------
    theta
        Parameters of the model, shape (COUNT,).
    c1
        Its lens.
    depths_mm
        Nearest and farthest depth of a target, mm.
    slack_rad
        Uncertainty of the readings, rad: the interval is so much longer at either end.
    """

    theta: FloatArray
    c1: Camera
    depths_mm: tuple[float, float]
    slack_rad: float = 0.0

    def aim(self, pixel_c1: FloatArray, *, depth_mm: float | None) -> Aim:
        """Return where C2 has to look; see `Aiming.aim`."""
        near, far = self.depths_mm
        expected = 2 / (1 / near + 1 / far) if depth_mm is None else min(max(depth_mm, near), far)
        ray = normalise(self.c1, pixel_c1[None], strict=False)[0]
        if not np.isfinite(ray).all():
            raise Refused("the target lies where C1's lens has no ray; move it inwards")
        depths = np.append(1 / np.linspace(1 / near, 1 / far, DEPTHS), expected)
        points = depths[:, None] * np.append(ray, 1.0)
        try:
            readings = gaze_at(self.theta, points).alpha2
        except ValueError as error:
            raise Refused(f"{error}; move the target") from None
        low, high = float(readings.min()), float(readings.max())
        return Aim(float(readings[-1]), low - self.slack_rad, high + self.slack_rad)


@dataclass(frozen=True)
class BlindAiming:
    """Without any knowledge of the rig: anywhere within the axis' range.

    Parameters
    ----------
    range_rad
        Of the axis, rad.
    """

    range_rad: tuple[float, float]

    def aim(self, pixel_c1: FloatArray, *, depth_mm: float | None) -> Aim:  # noqa: ARG002 - of the protocol
        """Return the whole range, from its middle."""
        low, high = self.range_rad
        return Aim((low + high) / 2, low, high)
