"""calibration.json: all that measuring needs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.adjustment import AdjustedCamera
from calib.document.part import Matrix, Part, Vector


class Spread(Part):
    """Standard deviation of a normal part and full width of a rectangular one."""

    normal: float
    width: float


class Stated(Part):
    """What the manifest states of readings."""

    u_x1c: float
    encoder_step_rad: float
    u_alpha2_rad: float


class Reading(Part):
    """Errors of a reading."""

    x1c: Spread
    y1c: Spread
    alpha2_rad: Spread
    gaze_residual_rad: Spread


class Shared(Part):
    """Errors that readings have in common with the rows."""

    names: list[str]
    factor: Matrix
    with_parameters: Matrix
    sources: list[str]


class SharedByRows(Part):
    """Errors that the rows alone have in common."""

    with_parameters: Matrix
    sources: list[str]


class ModelPart(Part):
    """One model as it measures."""

    model: str
    names: list[str] = Field(description="order of values and covariance")
    values: Vector = Field(description="of the parameters")
    covariance: Matrix
    noise_factor: float = Field(
        description="by how much the rows proved the stated uncertainties of a reading too small"
    )
    factor95: float = Field(description="coverage factor of inverse depth")


class AveragePart(ModelPart):
    """One model in the average."""

    weight: float
    with_parameters: Matrix | None = None


class ByOneModel(ModelPart):
    """All that measuring by one model needs."""

    stated: Stated
    reading: Reading
    calibrated_depth_mm: tuple[float, float] = Field(
        description="ends of the depths that the calibration covers"
    )
    shared: Shared | None = None
    shared_by_rows: SharedByRows | None = None


class AdjustedMeasurement(ByOneModel):
    """All that measuring by the adjustment needs."""

    cameras: dict[Literal["c1", "c2"], AdjustedCamera]


class Measurement(ByOneModel):
    """All that measuring needs: by the rows, of the selected model; by the adjustment."""

    average: list[AveragePart] | None = None
    adjustment: AdjustedMeasurement | None = None
