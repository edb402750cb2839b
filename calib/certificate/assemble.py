"""From a calibration and its manifest to the certificate's inputs."""

from __future__ import annotations

from calib.certificate.inputs import (
    Administration,
    CalibrationSummary,
    CertificateInputs,
    CertificateProvenance,
    DerivedQuantity,
    Issue,
)
from calib.dataset.manifest import CameraSection as Stated
from calib.dataset.manifest import CertificateSection, Manifest, RigSection
from calib.geometry.camera import Camera
from calib.geometry.lens import PROJECTIONS
from calib.instrument.calibrated import EVALUATION, CalibratedInstrument
from calib.results.calibration import Calibration, GazeResult
from calib.results.effective_baseline import effective_baseline, effective_interval
from calib.stages.provenance import Provenance as RunProvenance
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.montecarlo import Interval

NOT_GIVEN = "not stated"
"""The manifest's own word where no reference is named."""


def assemble(
    calibration: Calibration,
    manifest: Manifest,
    evidence: Evidence,
    *,
    issue: Issue,
    made: RunProvenance,
    digest: str,
) -> CertificateInputs:
    """Return the inputs of the certificate.

    Parameters
    ----------
    digest
        SHA-256, hex, of the calibration.json that is certified.

    Raises
    ------
    ValueError
        If the calibration has no calibrated instrument: there is nothing to certify.
    """
    gaze = calibration.gaze
    if gaze is None or gaze.calibrated is None:
        raise ValueError("without a calibrated instrument there is nothing to certify")
    return CertificateInputs(
        administration=_administration(manifest.certificate, manifest.rig, gaze),
        issue=issue,
        provenance=CertificateProvenance(
            dataset_name=calibration.name,
            dataset_title=manifest.heading,
            dataset_sha256=calibration.sha256,
            calibration_sha256=digest,
            citation=manifest.source.citation,
            seed=calibration.seed,
            software=(("calib", made.version), ("Python", made.python), *made.packages.items()),
            commit=made.commit,
        ),
        calibration=_summary(gaze, gaze.calibrated, manifest),
        evidence=evidence,
        gates=calibration.gates,
        warnings=calibration.warnings,
    )


def _administration(
    stated: CertificateSection, rig: RigSection, gaze: GazeResult
) -> Administration:
    values = stated.model_dump(exclude={"tolerance", "decision_rule"})
    values["serial"] = stated.serial or rig.serial
    if gaze.correction is not None:
        text = gaze.correction.text.replace("+-", "±")
        corrected = f"The calibration rows were corrected: {text}."
        values["deviations"] = " ".join(filter(None, (stated.deviations, corrected)))
    return Administration(**values)


POSTERIOR = "posterior sampled by emcee"
ADJUSTMENT = "least-squares adjustment of all pictures of the board"

_IDENTIFIED = {kind: name for name, kind in EVALUATION.items()}


def _summary(
    gaze: GazeResult, calibrated: CalibratedInstrument, manifest: Manifest
) -> CalibrationSummary:
    by_rows = gaze.robust.get(calibrated.model)
    p = calibrated.instrument.parameters
    derived = effective_baseline(p.names, p.values, p.covariance)
    interval = None
    if p.draws is not None and (ends := effective_interval(p.names, p.draws)) is not None:
        interval = Interval(*ends)
    low, high = calibrated.calibrated_mm
    return CalibrationSummary(
        model=calibrated.model,
        instrument=calibrated.instrument,
        identified_by=tuple(_IDENTIFIED[kind] for kind in p.evaluation),
        estimator=POSTERIOR if by_rows is not None else ADJUSTMENT,
        rows=len(gaze.rows),
        outliers=() if by_rows is None else by_rows.outliers,
        reference=_reference(manifest),
        calibrated_mm=(float(low), float(high)),
        noise_factor=calibrated.noise_factor,
        derived=()
        if derived is None
        else (DerivedQuantity("L_b + e", "baseline seen at 90°", "mm", *derived, interval),),
        intrinsics=lens_words(manifest.cameras.c1, calibrated.setup.cameras.c1),
    )


def _reference(manifest: Manifest) -> str | None:
    """Return what the reference depths are; None where the manifest does not say."""
    if manifest.gaze is None or manifest.gaze.reference == NOT_GIVEN:
        return None
    return manifest.gaze.reference


def lens_words(c1: Stated | None, camera: Camera | None) -> str | None:
    """Return where the intrinsics of C1 come from, in words, as the manifest and the lens say."""
    if c1 is None:
        return None
    said = "taken from a finished model" if c1.model is not None else "given in the dataset"
    if c1.images is not None:
        said = "calibrated from images of the board in the dataset"
    if camera is None or camera.projection == "perspective":
        return said
    return f"{said}, lens model {PROJECTIONS[camera.projection].words}"
