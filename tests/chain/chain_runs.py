"""Runs of the whole chain for the tests of this folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.chain.calibrate import Options, calibrate
from calib.dataset.load import load_dataset
from calib.results.calibration import Calibration


@dataclass(frozen=True)
class Chain:
    """A finished run: its result, folder, calibration.json and the truth behind it."""

    calibration: Calibration
    document: dict[str, Any]
    truth: dict[str, Any]
    out: Path

    def pulls(self, fit: str) -> dict[str, float]:
        """Return (estimate - truth) / std of the parameters of a fit."""
        truth = self.truth["parameters"]
        parameters = self.document["fits"][fit]["parameters"]
        return {
            name: (p["value"] - truth[name]) / p["std"]
            for name, p in parameters.items()
            if name in truth
        }


def run_chain(folder: Path, out: Path) -> Chain:
    """Calibrate the dataset in `folder`."""
    run = calibrate(
        load_dataset(folder),
        out,
        Options(seed=0),
        announce=lambda _: None,
        progress=lambda *_: None,
        command="test",
    )
    truth = folder / "truth.json"
    return Chain(
        run.calibration,
        json.loads((out / "calibration.json").read_text()),
        json.loads(truth.read_text()) if truth.exists() else {},
        out,
    )
