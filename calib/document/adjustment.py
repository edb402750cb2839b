"""calibration.json: all pictures in one least squares."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.cameras import CameraMatrix
from calib.document.findings import GatePart
from calib.document.part import Matrix, Part, Vector


class AdjustedCamera(CameraMatrix):
    """A camera by the adjustment; without uncertainty if it was given."""

    std: Vector | None = Field(None, description="fx, fy, cx, cy, distortion")
    covariance: Matrix | None = Field(None, description="of fx, fy, cx, cy, distortion; px and 1")


class AdjustedStereo(Part):
    """Pose of C2 in C1 at a reading, by the adjustment."""

    alpha2_deg: float = Field(description="reading at which C2 stands so, deg")
    transform_12: Matrix = Field(description="4 x 4, P1 = R P2 + t: takes a point of C2 to C1, mm")
    covariance: Matrix = Field(description="of rotation vector and translation")
    baseline_mm: float = Field(description="distance of the cameras' centres")
    baseline_std_mm: float = Field(description="its standard uncertainty, mm")


class AdjustedReadings(Part):
    """Errors of the encoder's readings."""

    count: int = Field(description="of exposures with a reading")
    stated_std_rad: float = Field(description="standard uncertainty as the manifest states it, rad")
    std_rad: float = Field(description="as the pictures show it")


class AdjustmentPart(Part):
    """All pictures in one least squares: lenses, board, rig, encoder and readings."""

    model: str = Field(description="of record; `complete` has every parameter free")
    passed: bool = Field(description="whether all its gates did")
    intrinsics: dict[Literal["c1", "c2"], AdjustedCamera] = Field(description="by camera")
    stereo: AdjustedStereo = Field(description="pose of C2 in C1")
    pictures: dict[str, int] = Field(description="how many, by camera and purpose")
    left_out: tuple[str, ...] = Field(description="pictures that contradict the others")
    rejected_points: int = Field(description="corners left out as outliers")
    rms_px: float = Field(description="of the residuals, px a coordinate")
    sigma_px: dict[str, float] = Field(description="of a corner, by camera and purpose")
    readings: AdjustedReadings = Field(description="errors of the encoder's readings")
    gates: tuple[GatePart, ...] = Field(description="checks of the adjustment")
