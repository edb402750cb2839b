"""The result of a calibration, and its form for programs: calibration.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.dataset.manifest import RigSection
from calib.diagnosis.findings import Attempt, Diagnosis
from calib.fit.compare import Comparison
from calib.fit.convex import ConvexFit
from calib.fit.group_check import GroupCheck
from calib.fit.identifiability import Identifiability
from calib.fit.linear import LinearFit
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.camera import Camera
from calib.images.adjustment.result import Adjustment
from calib.images.result import ImageResult
from calib.instrument.adjusted import ADJUSTMENT, Choice, Described
from calib.instrument.averaging import ModelAverage
from calib.instrument.calibrated import CalibratedInstrument, DepthTable
from calib.instrument.validation import ValidationResult
from calib.rows.observations import Observations
from calib.rows.sketch import RowSketch
from calib.uncertainty.evidence import Evidence


@dataclass(frozen=True)
class GazeResult:
    """What came of the gaze rows.

    Parameters
    ----------
    rows
        As the fits saw them.
    sense
        Whether encoder and baseline have the signs of the frame.
    linear, convex
        None where the rows do not allow them; `refused` says why.
    robust, posterior
        By model.
    refused
        Reason by fit, for those that could not be made.
    identifiability
        What the rows can tell, by model.
    comparison, calibrated, depths, average
        None if no model could be fitted.
    validation
        None without validation rows.
    groups
        Whether rows of a group err together; None if no model could be fitted.
    correction
        What was corrected in the rows, as the manifest accepts; None where nothing was.
    diagnosis
        Mistakes that the rows show; None if no model could be fitted.
    evidence
        Accuracy at the certified depths; None if no model could be fitted, or none can be stated.
    not_certified
        Why none can be stated.
    default_priors
        Default priors that were scaled to a rig of another size: mean and standard deviation.
    choice
        Whether the instrument of record, `calibrated`, with what it measures, is that by the rows
        or by the adjustment; None where there is none of these.
    beside
        The other one.
    """

    rows: Observations
    encoder_direction: Gate
    linear: LinearFit | None
    convex: ConvexFit | None
    robust: Mapping[str, RobustFit]
    posterior: Mapping[str, Posterior]
    refused: Mapping[str, str]
    identifiability: Mapping[str, Identifiability] = field(default_factory=dict)
    comparison: Comparison | None = None
    calibrated: CalibratedInstrument | None = None
    depths: DepthTable | None = None
    average: ModelAverage | None = None
    validation: ValidationResult | None = None
    groups: GroupCheck | None = None
    diagnosis: Diagnosis | None = None
    correction: Attempt | None = None
    evidence: Evidence | None = None
    not_certified: str | None = None
    default_priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    choice: Choice | None = None
    beside: Described | None = None

    @property
    def by_rows(self) -> Described | None:
        """The instrument by the rows."""
        if self.choice is not None and self.choice.method == ADJUSTMENT:
            return self.beside
        if self.calibrated is None or self.depths is None:
            return None
        return Described(self.calibrated, self.depths, self.validation)

    @property
    def by_adjustment(self) -> Described | None:
        """The instrument by the adjustment; None where there is none."""
        if self.choice is None or self.calibrated is None or self.depths is None:
            return None
        if self.choice.method == ADJUSTMENT:
            return Described(self.calibrated, self.depths, self.validation)
        return self.beside


@dataclass(frozen=True)
class Calibration:
    """Everything that one run found out.

    Parameters
    ----------
    name, title, sha256
        Of the dataset.
    rig
        On which side C2 stands, and the rig's serial number.
    seed
        Of all random numbers.
    cameras
        Given ones, by "c1" and "c2".
    camera_covariances
        What is uncertain of their intrinsics, px and 1, shape (4 + k, 4 + k) each.
    images
        What the images gave.
    gaze
        None without gaze rows.
    gates
        What must hold before the result may be used.
    warnings
        What the reader should know and no gate covers.
    adjustment
        All pictures in one least squares; None where there are none that tell the rig.
    not_adjusted
        Why there are pictures and yet no adjustment.
    rows
        Of the gaze rows, by which runs see whether they share some.
    disagreements
        References that contradict the measured depths: no fault of the calibration alone, and
        more than its reader may overlook.
    """

    name: str
    title: str
    sha256: str
    seed: int
    cameras: Mapping[str, Camera]
    camera_covariances: Mapping[str, FloatArray]
    images: ImageResult
    gaze: GazeResult | None
    gates: tuple[Gate, ...]
    warnings: tuple[str, ...]
    adjustment: Adjustment | None = None
    not_adjusted: str | None = None
    rows: RowSketch | None = None
    rig: RigSection = field(default_factory=RigSection)
    disagreements: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all gates passed."""
        return all(gate.passed for gate in self.gates)
