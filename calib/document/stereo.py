"""calibration.json: how the cameras stand, and the axis about which C2 turns."""

from __future__ import annotations

from typing import Self

from pydantic import ConfigDict, Field, model_validator

from calib.document.fits import Estimate
from calib.document.part import Matrix, Part, Vector


class StereoSolve(Part):
    """One solve of the pose."""

    backend: str
    intrinsics: str
    pose_12: Vector = Field(description="Rodrigues vector and translation")
    std: Vector
    rms_px: float


class PairTarget(Part):
    """The target of one pair."""

    pair: str
    position_mm: Vector
    u_z_mm: float


class Pose(Part):
    """How the cameras stand."""

    transform_12: Matrix = Field(description="4 x 4, P1 = R P2 + t: takes a point of C2 to C1, mm")


class MeasuringPose(Pose):
    """How cameras stand that measure."""

    model_config = ConfigDict(allow_inf_nan=False)

    @model_validator(mode="after")
    def _is_a_transform(self) -> Self:
        if tuple(map(len, self.transform_12)) != (4, 4, 4, 4):
            raise ValueError("the transform is not of shape (4, 4)")
        return self


class StereoPart(Pose):
    """The pose of C2 in C1's frame, C2 held at one yaw."""

    source: str = Field(description="how the pose was found")
    covariance: Matrix | None = Field(
        description="of rotation vector, rad, and translation, mm, of transform_12"
    )
    baseline_mm: float = Field(description="distance of the cameras' centres")
    baseline_std_mm: float | None = Field(description="its standard uncertainty")
    rms_px: float | None = Field(description="of the pairs' residuals")
    pairs: int = Field(description="how many were used")
    alternatives: tuple[StereoSolve, ...]
    targets: tuple[PairTarget, ...]


class Measured(Part):
    """Jointly measured parameters."""

    names: tuple[str, ...]
    mean: Vector
    covariance: Matrix


class SweepPart(Part):
    """The yaw axis by a sweep of C2 before boards at rest."""

    axis_direction_c2: Vector
    axis_foot_c2_mm: Vector
    eccentricity_mm: Estimate
    gaze_roll_rad: Estimate
    encoder_scale: Estimate
    measured: Measured
    rms_px: float
    images: int
