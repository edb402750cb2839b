"""Runs from their folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib.core.errors import InputError
from calib.history.drift import ComparedRun
from calib.instrument.calibration_file import read_whole
from calib.rows.sketch import RowSketch
from calib.stages.manifest import refuse_broken_folder

RESULT = "calibration.json"


def read_run(path: Path, *, allow_edited: bool = False) -> ComparedRun:
    """Return the run in a folder, or of a calibration.json.

    Raises
    ------
    InputError
        If there is none, it holds no gaze calibration, or its folder is broken.
    """
    file = path
    if path.is_dir():
        file = path / RESULT
        if file.exists() and not file.is_file():
            what, remedy = "is no plain file", "give the folder of a finished run"
            raise InputError.single(where=str(file), what=what, remedy=remedy)
        if not allow_edited:
            refuse_broken_folder(path)
    # Checked as far as the instrument goes; the rest is only shown, and may be absent.
    measuring, document = read_whole(file, allow_edited=allow_edited)
    model = str(document["measurement"]["model"])
    posterior = document.get("fits", {}).get(f"{model}/posterior", {})
    decided = {
        name: str(entry.get("identified_by", ""))
        for name, entry in posterior.get("parameters", {}).items()
    }
    return ComparedRun(
        name=str(path),
        dataset=str(document.get("dataset", {}).get("name", "")),
        model=model,
        measuring=measuring,
        identified_by=decided,
        scores=_scores(document, model),
        dataset_sha256=str(document.get("dataset", {}).get("sha256", "")),
        rows=_sketch(document.get("dataset", {})),
        depth_u=_depth_u(document),
    )


def _sketch(dataset: dict[str, Any]) -> RowSketch | None:
    if "rows_sketch" not in dataset:
        return None
    return RowSketch(int(dataset["rows"]), tuple(map(str, dataset["rows_sketch"])))


def _depth_u(document: dict[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    table = [row for row in document.get("depth_uncertainty", []) if row.get("u_mm", 0) > 0]
    return tuple(float(r["z_mm"]) for r in table), tuple(float(r["u_mm"]) for r in table)


_SHOWN = ("loo", "loo_se", "weight", "cv_depth_rms_rel", "validation_depth_rms_rel")


def _scores(document: dict[str, Any], model: str) -> dict[str, float]:
    """Return the predictive scores of the selected model."""
    found: dict[str, float] = {}
    for score in document.get("comparison", []):
        if score.get("model") == model:
            found |= {name: float(score[name]) for name in _SHOWN if name in score}
    return found
