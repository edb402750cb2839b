"""What a reading of the yaw axis is, and how uncertain that makes it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from pydantic import model_validator

from calib.dataset.fields import StepDeg, UAngleDeg, refuse
from calib.dataset.section import Section

Reads = Literal["load encoder", "motor encoder", "counts"]

MICROSTEPS = 16
"""Counts a full step of a stepper, where the manifest does not say."""

FULL_STEP_SHARE = 0.05
"""Amplitude of a stepper's error within a full step, in full steps: the 5 % that makers state of a
step. Gazing simulated with it scatters by 0.59 mrad, twice what a uniform count would."""

MOTOR_ENCODER_U_DEG = 0.012
"""Coupling, gear and axle wind up between an encoder on the motor and C2: gazing simulated with
them scatters by 0.21 mrad where the encoder's count is 0.05."""

FURTHER: Mapping[str | None, str] = MappingProxyType(
    {
        "motor encoder": "what lies between motor and camera",
        "counts": "the motor's error between full steps",
    }
)
"""What is uncertain of a reading beside its count, by what is read."""


class Encoder(Section):
    """The yaw encoder: one count or microstep, and what else is uncertain of a reading.

    `reads` says what a reading is; `full_step_deg` is a stepper's full step at the axis, in which
    microsteps repeat their error. Where `u_alpha2_deg` is not stated it follows from these.
    """

    resolution_deg: StepDeg
    u_alpha2_deg: UAngleDeg | None = None
    reads: Reads | None = None
    full_step_deg: StepDeg | None = None

    @property
    def further_u_deg(self) -> float:
        """Standard uncertainty of a reading beside its rounding, deg.

        Counts of an open-loop motor are what it was told, not where it stands: within a full step
        it errs as a sine does.
        """
        if self.u_alpha2_deg is not None:
            return self.u_alpha2_deg
        if self.reads == "counts":
            full = self.full_step_deg or MICROSTEPS * self.resolution_deg
            return float(FULL_STEP_SHARE * full / np.sqrt(2))
        return MOTOR_ENCODER_U_DEG if self.reads == "motor encoder" else 0.0

    @property
    def std_rad(self) -> float:
        """Standard uncertainty of a reading, rad: a uniform step and the rest."""
        step = self.resolution_deg / np.sqrt(12)
        return float(np.deg2rad(np.hypot(step, self.further_u_deg)))

    @model_validator(mode="after")
    def _check_step(self) -> Encoder:
        if self.full_step_deg is not None and self.full_step_deg < self.resolution_deg:
            refuse(
                f"full_step_deg = {self.full_step_deg:g} is smaller than one count, "
                f"resolution_deg = {self.resolution_deg:g}",
                "give both at the yaw axis, in degrees",
            )
        return self
