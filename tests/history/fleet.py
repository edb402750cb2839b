"""Folders with what a history reads of runs, drawn about one rig's values."""

from __future__ import annotations

import json
from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path

import numpy as np

NAMES = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"]
TRUTH = np.array([120.0, 0.01, -20.0, 3.0])
STD = np.array([6.0, 5e-4, 1.0, 6.0])
CORRELATION = np.eye(4)
CORRELATION[0, 3] = CORRELATION[3, 0] = -0.998
COVARIANCE = CORRELATION * np.outer(STD, STD)


def written(
    folder: Path,
    values: np.ndarray,
    *,
    rig: str | None,
    day: date,
    dataset: str | None = None,
    hour: str = "08:00:00+00:00",
    measurement: dict[str, object] | None = None,
) -> Path:
    """Write what history reads of a run; `dataset` is the digest, by default of a new one."""
    folder.mkdir(parents=True)
    document = {
        "format": 1,
        "dataset": {
            "name": "my-rig",
            "sha256": dataset or sha256(str(folder).encode()).hexdigest(),
        },
        "measurement": {
            "model": "axis-offset",
            "names": NAMES,
            "values": values.tolist(),
            "covariance": COVARIANCE.tolist(),
            "calibrated_depth_mm": [600, 1400],
            **(measurement or {}),
        },
    }
    if rig is not None:
        document["rig"] = {"serial": rig}
    (folder / "calibration.json").write_text(json.dumps(document))
    (folder / "run.toml").write_text(f'[run]\nfinished = "{day}T{hour}"\n')
    return folder


def fleet(top: Path, *, of: int, each: int, step: float = 0.0) -> Path:
    """Write sound rigs; `step` is added to delta2 from the seventh calibration on."""
    rng = np.random.default_rng(0)
    for i in range(of):
        for k in range(each):
            values = rng.multivariate_normal(TRUTH, COVARIANCE)
            values[1] += step * (k >= 6)
            day = date(2020, 1, 1) + timedelta(days=90 * k)
            written(top / f"{i:03d}-{k:02d}", values, rig=f"R{i:03d}", day=day)
    return top
