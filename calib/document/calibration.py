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

    name: str = Field(description="as the manifest states it")
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

    format: Literal[1] = Field(
        description="of this document; it changes only if old files can no longer be read"
    )
    generator: str = Field(description="program and version that wrote it")
    dataset: DatasetPart = Field(description="what was calibrated from")
    rig: RigPart = Field(description="which rig")
    seed: int = Field(description="of all random numbers")
    intrinsics: dict[Literal["c1", "c2"], Intrinsics] | None = Field(
        None, description="selected intrinsics by camera"
    )
    stereo: StereoPart | None = Field(None, description="pose of C2 by the stereo pairs")
    sweep: SweepPart | None = Field(None, description="yaw axis by the sweep")
    fits: dict[str, Fit] | None = Field(None, description="estimates by MODEL/METHOD")
    adjustment: AdjustmentPart | None = Field(None, description="of all pictures")
    identifiability: dict[str, Identifiability] | None = Field(
        None, description="what the rows tell, by model"
    )
    comparison: tuple[Score, ...] | None = Field(None, description="scores of the models")
    selected: str | None = Field(None, description="model of the rows that was selected")
    selection_rule: str | None = Field(None, description="why, in words")
    method: Literal["rows", "adjustment"] | None = Field(
        None, description="by which the instrument of record is; absent: by the rows"
    )
    method_rule: str | None = Field(None, description="why")
    measurement: Measurement | None = Field(None, description="all that measuring needs")
    depth_uncertainty: tuple[Depth, ...] | None = Field(
        None, description="by the instrument of record"
    )
    depth_uncertainty_average: tuple[AverageDepth, ...] | None = Field(
        None, description="by all models together"
    )
    validation: tuple[ValidationRow, ...] | None = Field(
        None, description="rows that took no part in the fits, as measured"
    )
    validation_summary: dict[str, ErrorSummary] | None = Field(
        None, description="errors by reference"
    )
    diagnosis: tuple[CausePart, ...] | None = Field(
        None, description="best first, then those that show beside the first"
    )
    residual_structure: tuple[StructurePart, ...] | None = Field(
        None, description="tests of the residuals"
    )
    corrections: tuple[CorrectionPart, ...] | None = Field(
        None, description="causes that the manifest accepts"
    )
    not_fitted: dict[str, str] | None = Field(
        None, description="reason, by name of what could not be made"
    )
    gates: tuple[GatePart, ...] = Field(
        description="checks; if one failed, the result must not be used"
    )
    warnings: tuple[str, ...] = Field(description="what a reader should know and no gate covers")
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

    integrity: Integrity = Field(description="by which an edit is noticed")
