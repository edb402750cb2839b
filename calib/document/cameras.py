"""calibration.json: intrinsics of the cameras."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.part import Matrix, Part, Vector


class Lens(Part):
    """A solve of one camera's intrinsics."""

    lens_model: str
    matrix: Matrix = Field(description="px, the centre of the top-left pixel is (0, 0)")
    distortion: Vector = Field(description="OpenCV's order")
    image_size: tuple[int, int]
    std: Vector | None = Field(None, description="of fx, fy, cx, cy, distortion")
    rms_px: float | None = Field(None, description="of the corners' residuals")
    rejected_points: int | None = Field(None, description="corners left out as outliers")
    views: int | None = Field(None, description="pictures used")
    board_warp_mm: Vector | None = None


class JointLens(Part):
    """A joint solve of lenses and pairs that refined the intrinsics."""

    images: dict[Literal["lens", "pair", "row"], int] = Field(
        description="images of the camera by what they were taken for"
    )


class Intrinsics(Lens):
    """The selected intrinsics of one camera."""

    source: Literal["mrcal", "opencv", "given"] = Field(
        description="whose solve of the camera's own pictures; a joint solve may have refined it"
    )
    joint: JointLens | None = None
    covariance: Matrix | None = Field(None, description="of fx, fy, cx, cy, distortion; px and 1")
    dispersion: float | None = Field(
        None,
        description="variance as views show it over that of corner noise alone; in covariance",
    )
    selection: str | None = Field(None, description="why this solve was selected, in words")
    rejected_views: list[str] | None = None
    alternatives: dict[str, dict[str, Lens]] | None = Field(
        None, description="all solves, by backend and lens model"
    )
