"""calibration.json: how the cameras stand, and the axis about which C2 turns."""

from __future__ import annotations

from typing import Self

from pydantic import ConfigDict, Field, model_validator

from calib.document.fits import Estimate
from calib.document.part import Matrix, Part, Vector


class StereoSolve(Part):
    """One solve of the pose."""

    backend: str = Field(description="who solved it")
    intrinsics: str = Field(description="whose lenses it holds, or joint")
    pose_12: Vector = Field(description="Rodrigues vector and translation")
    std: Vector = Field(description="standard uncertainties of pose_12, rad and mm")
    rms_px: float = Field(description="of the residuals")


class PairTarget(Part):
    """The target of one pair."""

    pair: str = Field(description="what the names of its pictures have in common")
    position_mm: Vector = Field(description="x, y, z in frame C1")
    u_z_mm: float = Field(description="standard uncertainty of z, mm")


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
    alternatives: tuple[StereoSolve, ...] = Field(description="other solves")
    targets: tuple[PairTarget, ...] = Field(
        description="what the pairs say of targets on their boards"
    )


class MeasuredParameters(Part):
    """Jointly measured parameters."""

    names: tuple[str, ...] = Field(description="of the parameters")
    mean: Vector = Field(description="estimates, in the order of names")
    covariance: Matrix = Field(description="in the order of names")


class SweepPart(Part):
    """The yaw axis by a sweep of C2 before boards at rest."""

    axis_direction_c2: Vector = Field(description="unit vector along the yaw axis, frame of C2")
    axis_foot_c2_mm: Vector = Field(
        description="point of the axis nearest to C2's centre, frame of C2, mm"
    )
    eccentricity_mm: Estimate = Field(description="e, mm")
    gaze_roll_rad: Estimate = Field(description="roll of C2 about its optical axis, rad")
    encoder_scale: Estimate = Field(description="scale error of the encoder about 90 deg, 1")
    measured: MeasuredParameters = Field(description="what the rows' fits take from it, jointly")
    rms_px: float = Field(description="of the residuals")
    images: int = Field(description="pictures used")
