"""Runs from their folders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calib.history.drift import Run
from calib.instrument.calibration_file import read_calibration

RESULT = "calibration.json"


def read_run(path: Path) -> Run:
    """Return the run in a folder, or of a calibration.json.

    Raises
    ------
    InputError
        If there is none, or it holds no gaze calibration.
    """
    file = path / RESULT if path.is_dir() else path
    measuring = read_calibration(file)
    # Checked above as far as the instrument goes; the rest is only shown, and may be absent.
    document: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    model = str(document["measurement"]["model"])
    posterior = document.get("fits", {}).get(f"{model}/posterior", {})
    decided = {
        name: str(entry.get("identified_by", ""))
        for name, entry in posterior.get("parameters", {}).items()
    }
    return Run(
        name=str(path),
        dataset=str(document.get("dataset", {}).get("name", "")),
        model=model,
        measuring=measuring,
        identified_by=decided,
        scores=_scores(document, model),
    )


_SHOWN = ("loo", "loo_se", "weight", "cv_depth_rms_rel", "validation_depth_rms_rel")


def _scores(document: dict[str, Any], model: str) -> dict[str, float]:
    """Return the predictive scores of the selected model, and u(z) over the range."""
    found: dict[str, float] = {}
    for score in document.get("comparison", []):
        if score.get("model") == model:
            found |= {name: float(score[name]) for name in _SHOWN if name in score}
    depths = document.get("depth_uncertainty", [])
    for place, entry in (("near", depths[:1]), ("far", depths[-1:])):
        for row in entry:
            if "u_mm" in row:
                found[f"u(z) {place}, mm"] = float(row["u_mm"])
    return found
