"""calibration.json of a calibration."""

from __future__ import annotations

import io
import json
from typing import Any

from calib.core.seal import with_digest
from calib.core.version import __version__
from calib.document.calibration import Content, DatasetPart, ErrorSummary, RigPart
from calib.document.findings import StructurePart
from calib.document.fits import Fit, Score
from calib.document.part import written
from calib.fit.compare import ModelScore
from calib.results.calibration import Calibration, GazeResult
from calib.results.contents import adjustment, diagnosis, fits, images, measurement
from calib.results.contents.identifiability import identifiability


def to_json(calibration: Calibration) -> str:
    """Return calibration.json: the same text for the same result."""
    encoder = json.JSONEncoder(indent=1, ensure_ascii=False, allow_nan=False)
    # One piece a number: in a list, as `json.dumps` has it, they take ten times the text itself.
    text = io.StringIO()
    for piece in encoder.iterencode(with_digest(written(content(calibration)))):
        text.write(piece)
    text.write("\n")
    return text.getvalue()


def content(c: Calibration) -> Content:
    """Return a calibration as its document has it."""
    return Content(
        format=1,
        generator=f"calib {__version__}",
        dataset=DatasetPart(
            name=c.name,
            sha256=c.sha256,
            rows=None if c.rows is None else c.rows.count,
            rows_sketch=None if c.rows is None else tuple(c.rows.smallest),
        ),
        rig=RigPart(c2=c.rig.c2, serial=c.rig.serial),
        seed=c.seed,
        intrinsics=images.intrinsics(c.cameras, c.camera_covariances, c.images.intrinsics),
        stereo=None if c.images.stereo is None else images.stereo(c.images.stereo),
        sweep=None if c.images.sweep is None else images.sweep(c.images.sweep),
        adjustment=None if c.adjustment is None else adjustment.adjustment(c.adjustment),
        gates=diagnosis.gates(c.gates),
        warnings=(*c.disagreements, *c.warnings),
        contradictions=tuple(c.disagreements) or None,
        **_of_rows(c),
    )


def _of_rows(c: Calibration) -> dict[str, Any]:
    """Return the keys of `Content` that gaze rows give, and the fits of the adjustment."""
    found: dict[str, Any] = {}
    by_fit: dict[str, Fit] = {}
    refused: dict[str, str] = {}
    if c.gaze is not None:
        found, by_fit, refused = _gaze(c.gaze), _fits(c.gaze), dict(c.gaze.refused)
        found["measurement"], why = measurement.measurement(c.gaze)
        if why:
            refused["measurement"] = why
    if c.adjustment is not None:
        by_fit |= adjustment.fits(c.adjustment, None if c.gaze is None else c.gaze.rows)
        refused |= {f"{name}/adjustment": why for name, why in c.adjustment.contradicted.items()}
    if c.not_adjusted is not None:
        refused["adjustment"] = c.not_adjusted
    nothing = c.gaze is None and c.adjustment is None
    return found | {
        "fits": None if nothing else by_fit,
        "not_fitted": None if nothing and c.not_adjusted is None else refused,
    }


def _gaze(g: GazeResult) -> dict[str, Any]:
    """Return the keys of `Content` that gaze rows give, but for fits and measurement."""
    found: dict[str, Any] = {}
    if g.identifiability:
        found["identifiability"] = {
            name: identifiability(told) for name, told in g.identifiability.items()
        }
    if g.comparison is not None:
        found["comparison"] = tuple(map(_score, g.comparison.scores))
        found["selected"] = g.comparison.selected
        found["selection_rule"] = g.comparison.reason
    if g.choice is not None:
        found["method"] = g.choice.method
        found["method_rule"] = g.choice.reason
    if g.depths is not None:
        found["depth_uncertainty"] = measurement.depths(g.depths)
    if g.average is not None:
        found["depth_uncertainty_average"] = measurement.average_depths(g.average)
    if g.validation is not None:
        found["validation"] = measurement.validation(g.validation)
        found["validation_summary"] = {
            e.name: ErrorSummary(rms_rel=e.rms_rel, mean_rel=e.mean_rel)
            for e in g.validation.errors
        }
    if g.diagnosis is not None:
        found["diagnosis"] = diagnosis.causes(g.diagnosis)
        found["residual_structure"] = tuple(
            StructurePart(**vars(test)) for test in g.diagnosis.structure
        )
    if g.correction is not None:
        found["corrections"] = (diagnosis.correction(g.correction),)
    return found


def _fits(g: GazeResult) -> dict[str, Fit]:
    found: dict[str, Fit] = {}
    if g.linear is not None:
        found["base/linear"] = fits.linear(g.linear)
    if g.convex is not None:
        found["base/convex"] = fits.convex(g.convex)
    found |= {f"{name}/robust": fits.robust(fit) for name, fit in g.robust.items()}
    return found | {f"{name}/posterior": fits.posterior(p) for name, p in g.posterior.items()}


def _score(s: ModelScore) -> Score:
    return Score(
        model=s.model,
        loo=s.loo,
        loo_se=s.loo_se,
        aicc=s.aicc,
        bic=s.bic,
        cv_depth_rms_rel=s.cv_depth_rms_rel,
        validation_depth_rms_rel=s.validation_depth_rms_rel,
        weight=s.weight,
        averaging_weight=s.averaging_weight,
        pareto_k_max=float(s.pareto_k.max()),
        refitted=tuple(s.refitted),
        unreliable=tuple(s.unreliable),
    )
