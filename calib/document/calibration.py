"""calibration.json as programs may rely on it.

Parts that a dataset has no data for are absent. Lengths are mm, angles rad; covariances are in the
units of what they are of.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from calib.document.adjustment import AdjustmentPart
from calib.document.cameras import Intrinsics
from calib.document.depths import AverageDepth, Depth, ValidationRow
from calib.document.findings import CausePart, CorrectionPart, GatePart, StructurePart
from calib.document.fits import Fit, Score
from calib.document.identifiability import Identifiability
from calib.document.measurement import Measurement
from calib.document.part import Part
from calib.document.stereo import StereoPart, SweepPart


class DatasetPart(Part):
    """What was calibrated from."""

    name: str
    sha256: str = Field(description="of manifest, tables and images, names and bytes")
    rows: int | None = Field(None, description="number of gaze rows")
    rows_sketch: tuple[str, ...] | None = Field(
        None, description="smallest digests of the rows: by them runs see whether they share some"
    )


class RigPart(Part):
    """The rig."""

    c2: Literal["right", "left"] = Field(description="side of C1 on which C2 stands")
    serial: str | None = Field(None, description="of the rig, as the manifest states it")


class ErrorSummary(Part):
    """Errors of the measured depths against one reference."""

    rms_rel: float = Field(description="root of the mean square, over the reference depth")
    mean_rel: float = Field(description="mean, over the reference depth")


class Content(Part):
    """The result of a calibration."""

    format: Literal[1]
    generator: str
    dataset: DatasetPart
    rig: RigPart
    seed: int
    intrinsics: dict[Literal["c1", "c2"], Intrinsics] | None = None
    stereo: StereoPart | None = None
    sweep: SweepPart | None = None
    fits: dict[str, Fit] | None = None
    adjustment: AdjustmentPart | None = None
    identifiability: dict[str, Identifiability] | None = None
    comparison: tuple[Score, ...] | None = None
    selected: str | None = None
    selection_rule: str | None = None
    method: Literal["rows", "adjustment"] | None = Field(
        None, description="by which the instrument of record is; absent: by the rows"
    )
    method_rule: str | None = Field(None, description="why")
    measurement: Measurement | None = None
    depth_uncertainty: tuple[Depth, ...] | None = None
    depth_uncertainty_average: tuple[AverageDepth, ...] | None = None
    validation: tuple[ValidationRow, ...] | None = None
    validation_summary: dict[str, ErrorSummary] | None = None
    diagnosis: tuple[CausePart, ...] | None = Field(None, description="best first")
    residual_structure: tuple[StructurePart, ...] | None = None
    corrections: tuple[CorrectionPart, ...] | None = None
    not_fitted: dict[str, str] | None = None
    gates: tuple[GatePart, ...]
    warnings: tuple[str, ...]
    contradictions: tuple[str, ...] | None = Field(
        default=None,
        description="of the warnings, those of a validation reference that contradicts the depths",
    )


class Integrity(Part):
    """By which an edit is noticed."""

    sha256: str = Field(
        description="of the document without this section, as compact JSON with sorted keys"
    )


class Document(Content):
    """The result of a calibration, for programs."""

    integrity: Integrity
