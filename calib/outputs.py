"""The files of a run: written together, skipped together while nothing has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tomli_w

from calib.archive import archive
from calib.dataset.contents import Dataset
from calib.images.model_files import cameramodel_text, opencv_text
from calib.ledger import LEDGER, ledger_text
from calib.provenance import Provenance, provenance
from calib.report.context import report_context
from calib.report.page import render_report
from calib.results import Calibration, to_json
from calib.store import Store, write_bytes


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
    (out / LEDGER).unlink(missing_ok=True)
    made = provenance(command=command, durations_s=store.durations)
    store.announce("report")
    write_bytes(out / "calibration.json", to_json(calibration).encode())
    write_bytes(out / "results.h5", archive(calibration))
    report = render_report(calibration, report_context(dataset, made))
    write_bytes(out / "report.html", report.encode())
    cameras = _camera_files(calibration)
    for name, text in cameras.items():
        write_bytes(out / name, text.encode())
    run = tomli_w.dumps(_run(calibration, made))
    write_bytes(out / "run.toml", run.encode())
    names = ("calibration.json", "results.h5", "report.html", *cameras, "run.toml")
    write_bytes(out / LEDGER, ledger_text(out, fingerprint, names).encode())
    return tuple(out / name for name in names)


def _camera_files(calibration: Calibration) -> dict[str, str]:
    """Return the calibrated cameras as files for mrcal and OpenCV, by file name."""
    files = {}
    for name, found in calibration.images.intrinsics.items():
        files[f"{name}.yaml"] = opencv_text(found.camera)
        files[f"{name}.cameramodel"] = cameramodel_text(found.camera)
    return files


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
