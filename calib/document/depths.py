"""calibration.json: what a depth's uncertainty is, and how rows of validation were measured."""

from __future__ import annotations

from pydantic import Field

from calib.document.part import Part


class Depth(Part):
    """Depth uncertainty at one depth, for a target on C1's optical axis."""

    z_mm: float = Field(description="true depth, mm, from the optical centre of C1")
    u_mm: float | None = Field(None, description="standard uncertainty by Monte Carlo")
    low95_mm: float | None = Field(None, description="lower end of the 95 % interval, mm")
    high95_mm: float | None = Field(None, description="upper end, mm")
    gum_u_mm: float = Field(description="by the linear law")
    gum_valid: bool = Field(description="verdict of JCGM 101, clause 8")
    extrapolated: bool = Field(description="whether it lies outside the calibrated depths")
    gum_sources_mm: dict[str, float] = Field(description="parts of gum_u_mm by source, mm")


class AverageDepth(Part):
    """The same by all models together."""

    z_mm: float = Field(description="true depth, mm")
    mean_mm: float = Field(description="as measured in the mean, mm")
    u_mm: float = Field(description="standard uncertainty, mm")
    low95_mm: float | None = Field(None, description="lower end of the 95 % interval, mm")
    high95_mm: float | None = Field(None, description="upper end, mm")


class ValidationRow(Part):
    """A validation row as measured."""

    id: str = Field(description="of the row")
    group: str = Field(description="pose or day that it shares with others")
    x_mm: float = Field(description="measured, frame C1")
    y_mm: float = Field(description="measured, frame C1")
    z_mm: float = Field(description="measured depth, frame C1")
    u_mm: float | None = Field(None, description="standard uncertainty of z_mm")
    low95_mm: float | None = Field(None, description="lower end of its 95 % interval")
    high95_mm: float | None = Field(None, description="upper end")
    reference_mm: float = Field(description="first reference depth")
    error_rel: float = Field(description="z_mm less reference_mm, over reference_mm")
    other_references_error_rel: dict[str, float] = Field(description="the same by other reference")
    own_angle_z_mm: dict[str, float] = Field(
        description="depth by the row's own angle, mm, by model"
    )
