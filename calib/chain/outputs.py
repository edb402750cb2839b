"""The files of a run: written together, skipped together while nothing has changed."""

from __future__ import annotations

import gc
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import tomli_w

from calib.certificate.assemble import assemble
from calib.certificate.forms import render_forms
from calib.certificate.inputs import new_issue
from calib.dataset.contents import Dataset
from calib.dataset.corner_cache import write_cache
from calib.images.intrinsics.model_files import cameramodel_text, opencv_text
from calib.images.result import ImageResult
from calib.report.context import report_context
from calib.report.page import render_report
from calib.results.calibration import Calibration
from calib.results.contents.whole import to_json
from calib.results.hdf5_file import archive
from calib.stages.files import write_bytes
from calib.stages.manifest import begin_outputs, end_outputs
from calib.stages.provenance import Provenance, provenance
from calib.stages.run_folder import ALWAYS, SOMETIMES
from calib.stages.store import Store


def write_outputs(
    calibration: Calibration, dataset: Dataset, store: Store, *, fingerprint: str, command: str
) -> tuple[Path, ...]:
    """Write all files of a run, each under its name only when it is whole.

    Raises
    ------
    UsageError
        If the folder cannot be written.
    """
    out = store.out
    made = provenance(
        command=command, durations_s=store.durations, beside=_beside(calibration.images)
    )
    store.announce("report")
    with _settled():
        files = _results(calibration)
        digest = sha256(files["calibration.json"]).hexdigest()
        files |= _report(calibration, dataset, made)
        certificate, missing = _certificate(calibration, dataset, made, digest=digest)
    files |= certificate
    run = _run(calibration, made)
    if missing:
        run["certificate"] = missing
    files["run.toml"] = tomli_w.dumps(run).encode()
    write_set(out, files, fingerprint=fingerprint)
    return tuple(out / name for name in files)


def write_set(out: Path, files: Mapping[str, bytes], *, fingerprint: str) -> None:
    """Write the files of a run, so that at no moment those of two runs pass for one.

    Raises
    ------
    UsageError
        If the folder cannot be written.
    ValueError
        If a file is not declared: nobody would know it for the run's, nor remove it once stale.
    """
    if undeclared := set(files) - {*ALWAYS, *SOMETIMES}:
        raise ValueError(f"not declared in calib.stages.run_folder: {', '.join(undeclared)}")
    begin_outputs(out, files)
    for name, content in files.items():
        write_bytes(out / name, content)
    # What an earlier run wrote must not lie beside results that it is not of.
    for name in set(SOMETIMES) - set(files):
        (out / name).unlink(missing_ok=True)
    end_outputs(out, fingerprint, files)


def _beside(images: ImageResult) -> dict[str, str]:
    """Return the version of mrcal, which solves in an environment of its own, if it was used."""
    told = {found.mrcal_version for found in images.intrinsics.values()} - {None}
    return {"mrcal": ", ".join(sorted(map(str, told)))} if told else {}


@contextmanager
def _settled() -> Iterator[None]:
    """Keep the garbage collector to what is new.

    Figures and pages are many small objects, and each full collection on their account would
    search all results and libraries too: a fifth of the time of writing.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _results(calibration: Calibration) -> dict[str, bytes]:
    files = {
        "calibration.json": to_json(calibration).encode(),
        "results.h5": archive(calibration),
    }
    for name, found in calibration.images.intrinsics.items():
        files[f"{name}.yaml"] = opencv_text(found.camera).encode()
        if found.camera.projection != "perspective":
            continue  # mrcal has no such lens model
        # mrcal's own file holds its solve too, from which mrcal-tools tell uncertainties.
        lens = f"'{found.selected.lens_model}'"
        own = [text for text in found.model_files.values() if lens in text]
        text = own[0] if own else cameramodel_text(found.camera)
        files[f"{name}.cameramodel"] = text.encode()
    if calibration.images.corners:
        files["corners.vnl"] = write_cache(list(calibration.images.corners.values())).encode()
    return files


def _report(calibration: Calibration, dataset: Dataset, made: Provenance) -> dict[str, bytes]:
    report = render_report(calibration, report_context(dataset, made))
    return {"report.html": report.encode()}


def _certificate(
    calibration: Calibration, dataset: Dataset, made: Provenance, *, digest: str
) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return the certificate in its forms, and why which of them are missing."""
    gaze = calibration.gaze
    if gaze is None:
        return {}, {}
    if gaze.calibrated is None or gaze.evidence is None:
        return {}, {"missing": gaze.not_certified or "no model could be fitted"}
    # Equal seeds issue different certificates: the token is no result and not from the seed.
    issue = new_issue(
        now=datetime.now(UTC), dataset_sha256=calibration.sha256, token=secrets.token_hex(6)
    )
    inputs = assemble(
        calibration, dataset.manifest, gaze.evidence, issue=issue, made=made, digest=digest
    )
    forms = render_forms(inputs)
    files = {"certificate.html": forms.html.encode(), "certificate.xml": forms.xml}
    if forms.pdf is not None:
        files["certificate.pdf"] = forms.pdf
    return files, {} if forms.pdf_missing is None else {"pdf_missing": forms.pdf_missing}


def _run(calibration: Calibration, made: Provenance) -> dict[str, Any]:
    return {
        "dataset": {"name": calibration.name, "sha256": calibration.sha256},
        "run": {
            "finished": made.finished,
            "command": made.command,
            "seed": calibration.seed,
            "gates_passed": calibration.passed,
        },
        "software": {
            "calib": made.version,
            "commit": made.commit,
            "python": made.python,
            "system": made.system,
            "packages": dict(made.packages),
        },
        "durations_s": {name: round(t, 3) for name, t in made.durations_s.items()},
    }
