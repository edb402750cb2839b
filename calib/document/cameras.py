"""calibration.json: intrinsics of the cameras."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from calib.document.part import Matrix, Part, Vector
from calib.geometry.lens import ProjectionName, coefficients_fault


class CameraMatrix(Part):
    """A camera with its lens."""

    matrix: Matrix = Field(description="px, the centre of the top-left pixel is (0, 0)")
    distortion: Vector = Field(description="OpenCV's order")
    image_size: tuple[int, int] = Field(description="width and height, px")
    projection: ProjectionName | None = Field(
        None,
        description='lens model of distortion: "equidistant" (cv2.fisheye, k1 to k4); absent, it '
        "is perspective",
    )


class MeasuringCamera(CameraMatrix):
    """Intrinsics of a camera that measures: those that a camera can have."""

    model_config = ConfigDict(allow_inf_nan=False)

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        if coefficients_fault(self.projection or "perspective", len(self.distortion)):
            raise ValueError(f"{len(self.distortion)} lens coefficients fit no model")
        if tuple(map(len, self.matrix)) != (3, 3, 3):
            raise ValueError("the matrix is not of shape (3, 3)")
        (fx, skew, _), (zero, fy, _), last = self.matrix
        if min(fx, fy) <= 0 or (skew, zero, *last) != (0, 0, 0, 0, 1):
            raise ValueError("the matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        if min(self.image_size) <= 0:
            raise ValueError("the picture has no pixels")
        return self


class Lens(CameraMatrix):
    """A solve of one camera's intrinsics."""

    lens_model: str = Field(description="in the words of the solver; OPENCVn has n coefficients")
    std: Vector | None = Field(None, description="of fx, fy, cx, cy, distortion")
    rms_px: float | None = Field(None, description="of the corners' residuals")
    rejected_points: int | None = Field(None, description="corners left out as outliers")
    views: int | None = Field(None, description="pictures used")
    board_warp_mm: Vector | None = Field(
        None, description="board deformation along its x and y, mm, where the solve has it"
    )


class JointLens(Part):
    """A joint solve of lenses and pairs that refined the intrinsics."""

    images: dict[Literal["lens", "pair", "row"], int] = Field(
        description="images of the camera by what they were taken for"
    )


class Intrinsics(Lens):
    """The selected intrinsics of one camera."""

    source: Literal["mrcal", "opencv", "joint", "given"] = Field(
        description="whose solve of the camera's own pictures (joint: this program's own); a joint "
        "solve may have refined it"
    )
    joint: JointLens | None = Field(None, description="where a joint solve refined them")
    covariance: Matrix | None = Field(None, description="of fx, fy, cx, cy, distortion; px and 1")
    dispersion: float | None = Field(
        None,
        description="variance as views show it over that of corner noise alone; in covariance",
    )
    selection: str | None = Field(None, description="why this solve was selected, in words")
    rejected_views: tuple[str, ...] | None = Field(
        None, description="pictures left out: their corners contradict the others"
    )
    alternatives: dict[str, dict[str, Lens]] | None = Field(
        None, description="all solves, by backend and lens model"
    )
