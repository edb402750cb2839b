"""calibration.json: what was found wrong, or accepted."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.part import Part


class CausePart(Part):
    """A mistake that calibration rows or independent references show."""

    cause: str = Field(description="name of a hypothesis")
    at: str | None = Field(None, description="row, rows or group where it struck")
    seen_in: Literal["rows", "references"] = Field(
        "rows", description="whether calibration rows or independent references show it"
    )
    estimate: float | None = None
    std: float | None = None
    unit: str
    gain: float = Field(
        description="evidence, nats: gain in log marginal likelihood less penalties"
    )
    noise_scale: tuple[float, float] = Field(description="without and with it")
    depth_change_over_u: float = Field(description="largest, if it is left out")
    in_model: bool = Field(description="whether the model allows for it already")
    text: str
    remedy: str
    fits_as_well: tuple[str, ...] = Field(description="causes that explain the rows about as well")
    told_apart_by: str


class CorrectionPart(Part):
    """A cause that the manifest accepts: the rows are corrected by its estimate."""

    cause: str
    at: str | None = None
    estimate: float | None = None
    std: float | None = None
    unit: str
    text: str


class StructurePart(Part):
    """A test of the selected model's residuals by an added regressor."""

    against: str
    at: str | None = None
    probability: float = Field(description="of so much by chance")


class GatePart(Part):
    """A check of the result."""

    name: str
    passed: bool
    detail: str = ""
