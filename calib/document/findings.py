"""calibration.json: what was found wrong, or accepted."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.part import Part


class CausePart(Part):
    """A mistake that calibration rows or independent references show."""

    cause: str = Field(description="name of a hypothesis")
    at: str | None = Field(None, description="row, rows or group where it struck")
    seen_in: Literal["rows", "references", "both"] = Field(
        "rows",
        description="whether calibration rows, independent references or both together show it",
    )
    estimate: float | None = Field(None, description="of its size, in unit")
    std: float | None = Field(None, description="standard uncertainty of the estimate")
    unit: str = Field(description="of estimate and std")
    gain: float = Field(
        description="evidence, nats: gain in log marginal likelihood less penalties"
    )
    noise_scale: tuple[float, float] = Field(
        description="without and with it: residuals over what is stated; where references took "
        "part, their errors over what the calibration leads to expect"
    )
    depth_change_over_u: float = Field(description="largest, if it is left out")
    in_model: bool = Field(description="whether the model allows for it already")
    text: str = Field(description="what it is, in words")
    remedy: str = Field(description="what to do")
    fits_as_well: tuple[str, ...] = Field(description="causes that explain the rows about as well")
    told_apart_by: str = Field(description="what would tell it from the causes that fit as well")
    beside: str | None = Field(
        None, description="first cause, where this one shows once the first is allowed for"
    )


class CorrectionPart(Part):
    """A cause that the manifest accepts: the rows are corrected by its estimate."""

    cause: str = Field(description="name of a hypothesis")
    at: str | None = Field(None, description="row, rows or group where it struck")
    estimate: float | None = Field(None, description="of its size, in unit")
    std: float | None = Field(None, description="standard uncertainty of the estimate")
    unit: str = Field(description="of estimate and std")
    text: str = Field(description="what it is, in words")


class StructurePart(Part):
    """A test of the selected model's residuals by an added regressor."""

    against: str = Field(description="what the residuals are tested against")
    at: str | None = Field(None, description="row from which a step sets in")
    probability: float = Field(description="of so much by chance")


class GatePart(Part):
    """A check of the result."""

    name: str = Field(description="short and stable")
    passed: bool = Field(description="whether the result may be used as far as this check goes")
    detail: str = Field(
        "", description="figures that decided it and, where it failed, the next step"
    )
