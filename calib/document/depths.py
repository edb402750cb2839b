"""calibration.json: what a depth's uncertainty is, and how rows of validation were measured."""

from __future__ import annotations

from pydantic import Field

from calib.document.part import Part


class Depth(Part):
    """Depth uncertainty at one depth, for a target on C1's optical axis."""

    z_mm: float
    u_mm: float | None = Field(None, description="standard uncertainty by Monte Carlo")
    low95_mm: float | None = None
    high95_mm: float | None = None
    gum_u_mm: float = Field(description="by the linear law")
    gum_valid: bool = Field(description="verdict of JCGM 101, clause 8")
    extrapolated: bool
    gum_sources_mm: dict[str, float]


class AverageDepth(Part):
    """The same by all models together."""

    z_mm: float
    mean_mm: float
    u_mm: float
    low95_mm: float | None = None
    high95_mm: float | None = None


class ValidationRow(Part):
    """A validation row as measured."""

    id: str
    group: str
    x_mm: float
    y_mm: float
    z_mm: float
    u_mm: float | None = None
    low95_mm: float | None = None
    high95_mm: float | None = None
    reference_mm: float
    error_rel: float
    other_references_error_rel: dict[str, float]
    own_angle_z_mm: dict[str, float]
