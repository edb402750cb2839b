"""The result of a calibration, and its form for programs: calibration.json."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.core.seal import with_digest
from calib.core.version import __version__
from calib.dataset.manifest import Rig
from calib.diagnosis.engine import Attempt, Diagnosis
from calib.fit.compare import Comparison, ModelScore
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
from calib.instrument.calibrated import CalibratedInstrument, DepthTable, ValidationResult
from calib.instrument.calibration_file import FORMAT
from calib.results.adjustment_document import adjustment_fits, adjustment_section
from calib.results.average_document import average_depths, average_document
from calib.results.diagnosis_document import correction_document, diagnosis_document
from calib.results.fits_document import (
    convex_document,
    linear_document,
    posterior_document,
    robust_document,
)
from calib.results.identifiability_document import identifiability_document
from calib.results.images_document import camera_document, images_document
from calib.rows.from_table import CameraSet
from calib.rows.observations import Observations
from calib.rows.sketch import RowSketch
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.measurement import Instrument, SharedErrors, Spread

DIGITS = 12
"""Significant digits of the numbers in calibration.json: beyond them lies only rounding."""


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
        Accuracy at the certified depths; None if no model could be fitted.
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
    rig: Rig = field(default_factory=Rig)
    disagreements: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all gates passed."""
        return all(gate.passed for gate in self.gates)


def to_json(calibration: Calibration) -> str:
    """Return calibration.json: the same text for the same result."""
    encoder = json.JSONEncoder(indent=1, ensure_ascii=False, allow_nan=False)
    # One piece a number: in a list, as `json.dumps` has it, they take ten times the text itself.
    text = io.StringIO()
    for piece in encoder.iterencode(_document(calibration)):
        text.write(piece)
    text.write("\n")
    return text.getvalue()


def _document(c: Calibration) -> dict[str, Any]:
    document: dict[str, Any] = {
        "format": FORMAT,
        "generator": f"calib {__version__}",
        "dataset": {"name": c.name, "sha256": c.sha256} | _rows(c.rows),
        "rig": c.rig.model_dump(exclude_none=True),
        "seed": c.seed,
    }
    document |= images_document(c.cameras, c.camera_covariances, c.images)
    if c.gaze is not None:
        document |= _gaze(c.gaze)
    if c.adjustment is not None:
        rows = None if c.gaze is None else c.gaze.rows
        document["fits"] = document.get("fits", {}) | adjustment_fits(c.adjustment, rows)
        document["adjustment"] = adjustment_section(c.adjustment)
        refused = {f"{name}/adjustment": why for name, why in c.adjustment.contradicted.items()}
        document["not_fitted"] = document.get("not_fitted", {}) | refused
    if c.not_adjusted is not None:
        refused = {"adjustment": c.not_adjusted}
        document["not_fitted"] = document.get("not_fitted", {}) | refused
    document["gates"] = [vars(gate) for gate in c.gates]
    document["warnings"] = [*c.disagreements, *c.warnings]
    if c.disagreements:
        document["contradictions"] = list(c.disagreements)
    return with_digest(_clean(document))


def _rows(rows: RowSketch | None) -> dict[str, Any]:
    return {} if rows is None else {"rows": rows.count, "rows_sketch": rows.smallest}


def _clean(value: Any) -> Any:
    """Return a JSON value: arrays as lists, floats to `DIGITS`; entries without a number left out.

    A number that does not exist (infinite, not a number) is absent from a mapping and null in a
    list, where leaving it out would move the others.
    """
    if isinstance(value, Mapping):
        items = ((str(key), _clean(item)) for key, item in value.items())
        return {key: item for key, item in items if item is not None}
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, tuple | list):
        return [_clean(item) for item in value]
    if isinstance(value, np.generic):
        return _clean(value.item())
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def _gaze(g: GazeResult) -> dict[str, Any]:
    document: dict[str, Any] = {"fits": _fits(g)}
    if g.identifiability:
        document["identifiability"] = identifiability_document(g.identifiability)
    if g.comparison is not None:
        document["comparison"] = [_score(score) for score in g.comparison.scores]
        document["selected"] = g.comparison.selected
        document["selection_rule"] = g.comparison.reason
    document |= _measured_by(g)
    if g.depths is not None:
        document["depth_uncertainty"] = _depths(g.depths)
    if g.average is not None:
        document["depth_uncertainty_average"] = average_depths(g.average)
    if g.validation is not None:
        document["validation"] = _validation(g.validation)
        document["validation_summary"] = {
            e.name: {"rms_rel": e.rms_rel, "mean_rel": e.mean_rel} for e in g.validation.errors
        }
    if g.diagnosis is not None:
        document["diagnosis"] = diagnosis_document(g.diagnosis)
        document["residual_structure"] = [vars(test) for test in g.diagnosis.structure]
    if g.correction is not None:
        document["corrections"] = [correction_document(g.correction)]
    document["not_fitted"] = dict(g.refused)
    return document


def _measured_by(g: GazeResult) -> dict[str, Any]:
    """Return the instruments, and which is that of record."""
    document: dict[str, Any] = {}
    if g.choice is not None:
        document["method"] = g.choice.method
        document["method_rule"] = g.choice.reason
    if g.by_rows is not None:
        document["measurement"] = _described(g.by_rows)
        if g.by_adjustment is not None:
            document["measurement"]["adjustment"] = _described(g.by_adjustment) | {
                "cameras": _cameras(g.by_adjustment.calibrated.setup.cameras)
            }
        if g.average is not None:
            document["measurement"] |= average_document(g.average)
    return document


def _described(found: Described) -> dict[str, Any]:
    return _measurement(found.calibrated) | {"factor95": found.depths.factor95}


def _cameras(cameras: CameraSet) -> dict[str, Any]:
    return {
        name: camera_document(camera)
        for name, camera in (("c1", cameras.c1), ("c2", cameras.c2))
        if camera is not None
    }


def _fits(g: GazeResult) -> dict[str, Any]:
    fits: dict[str, Any] = {}
    if g.linear is not None:
        fits["base/linear"] = linear_document(g.linear)
    if g.convex is not None:
        fits["base/convex"] = convex_document(g.convex)
    fits |= {f"{name}/robust": robust_document(fit) for name, fit in g.robust.items()}
    fits |= {f"{name}/posterior": posterior_document(p) for name, p in g.posterior.items()}
    return fits


def _score(s: ModelScore) -> dict[str, Any]:
    return {
        "model": s.model,
        "loo": s.loo,
        "loo_se": s.loo_se,
        "aicc": s.aicc,
        "bic": s.bic,
        "cv_depth_rms_rel": s.cv_depth_rms_rel,
        "validation_depth_rms_rel": s.validation_depth_rms_rel,
        "weight": s.weight,
        "averaging_weight": s.averaging_weight,
        "pareto_k_max": s.pareto_k.max(),
        "refitted": list(s.refitted),
        "unreliable": list(s.unreliable),
    }


def _spread(spread: Spread) -> dict[str, float]:
    return {"normal": spread.normal, "width": spread.width}


def _measurement(c: CalibratedInstrument) -> dict[str, Any]:
    """Return all that `calib measure` needs."""
    instrument: Instrument = c.instrument
    reading = instrument.reading
    return {
        "model": c.model,
        "names": list(instrument.parameters.names),
        "values": instrument.parameters.values,
        "covariance": instrument.parameters.covariance,
        "noise_factor": c.noise_factor,
        "stated": {
            "u_x1c": reading.x1c.normal / c.noise_factor,
            "encoder_step_rad": c.setup.settings.encoder_step_rad,
            "u_alpha2_rad": c.setup.settings.u_alpha2_rad,
        },
        "reading": {
            "x1c": _spread(reading.x1c),
            "y1c": _spread(reading.y1c),
            "alpha2_rad": _spread(reading.alpha2_rad),
            "gaze_residual_rad": _spread(reading.gaze_residual_rad),
        },
        "calibrated_depth_mm": c.calibrated_mm,
        "shared": _shared(c),
        "shared_by_rows": _shared_by_rows(instrument.shared),
    }


def _shared(c: CalibratedInstrument) -> dict[str, Any] | None:
    """Return the errors that readings share with the calibration, None without any."""
    shared, errors = c.setup.shared, c.instrument.shared
    if errors is None or not shared.names:
        return None
    return {
        "names": list(shared.names),
        "factor": shared.factor,
        "with_parameters": errors.with_parameters[:, : errors.of_readings],
        "sources": list(shared.error_names),
    }


def _shared_by_rows(errors: SharedErrors | None) -> dict[str, Any] | None:
    """Return the errors that calibration rows share and readings do not have, None without any."""
    if errors is None or not errors.of_rows_alone:
        return None
    return {
        "with_parameters": errors.with_parameters[:, errors.of_readings :],
        "sources": list(errors.names[errors.of_readings :]),
    }


def _depths(table: DepthTable) -> list[dict[str, Any]]:
    p = table.prediction
    return [
        {
            "z_mm": table.depth_mm[i],
            "u_mm": p.u_mm[i],
            "low95_mm": p.low95_mm[i],
            "high95_mm": p.high95_mm[i],
            "gum_u_mm": p.gum_u_mm[i],
            "gum_valid": bool(p.gum_valid[i]),
            "extrapolated": bool(table.extrapolated[i]),
            "gum_sources_mm": {name: u[i] for name, u in table.sources_mm.items()},
        }
        for i in range(len(table.depth_mm))
    ]


def _validation(v: ValidationResult) -> list[dict[str, Any]]:
    p = v.prediction
    rows = []
    for i, name in enumerate(v.ids):
        x, y, _ = v.position_mm[i]
        rows.append(
            {
                "id": name,
                "group": v.groups[i],
                "x_mm": x,
                "y_mm": y,
                "z_mm": p.z_mm[i],
                "u_mm": p.u_mm[i],
                "low95_mm": p.low95_mm[i],
                "high95_mm": p.high95_mm[i],
                "reference_mm": v.reference_mm[i],
                "error_rel": v.errors[0].error_rel[i],
                "other_references_error_rel": {e.name: e.error_rel[i] for e in v.errors[1:]},
                "own_angle_z_mm": {model: z[i] for model, z in v.own_depth_mm.items()},
            }
        )
    return rows
