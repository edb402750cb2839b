"""calibration.json as far as it is read; keys that are not known are passed over."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.cameras import MeasuringCamera
from calib.document.findings import GatePart
from calib.document.measurement import Measurement
from calib.document.part import FinitePart
from calib.document.stereo import MeasuringPose


class RigSerial(FinitePart):
    """Which rig was calibrated."""

    serial: str | None = None


class CameraFile(FinitePart):
    """The document, as far as its cameras are read."""

    format: Literal[1]
    gates: tuple[GatePart, ...] = ()
    intrinsics: dict[Literal["c1", "c2"], MeasuringCamera]
    stereo: MeasuringPose | None = None


class MeasuringFile(FinitePart):
    """The document, as far as measuring reads it."""

    format: Literal[1]
    gates: tuple[GatePart, ...] = ()
    rig: RigSerial = RigSerial()
    method: Literal["rows", "adjustment"] = "rows"
    measurement: Measurement
    intrinsics: dict[Literal["c1", "c2"], MeasuringCamera] = Field(default_factory=dict)
