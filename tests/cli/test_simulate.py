"""A simulated rig, calibrated and measured with by the commands a user has, is the rig it was.

Evidence: simulated truth. Chains are short; bounds are four standard uncertainties, each of which
must itself be small beside what was simulated.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from command import call, tree

import calib.fit.chains
import calib.stages.store
from tests.reliability.short_chain import leave_out_pages

TRUTH = {"baseline_mm": 140.0, "delta2_rad": 0.02, "axis_z_mm": -25.0, "eccentricity_mm": 2.0}


@pytest.mark.slow
def test_truth_is_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {"TAU_MULTIPLE": 5.0, "ESS_GOAL": 100.0, "R_HAT_LIMIT": 1.5, "WALKER_R_HAT_LIMIT": 9.0}
    for name, value in short.items():
        monkeypatch.setattr(calib.fit.chains, name, value)
    monkeypatch.setattr(calib.stages.store, "processors", lambda: 1)  # others would not see that
    leave_out_pages(monkeypatch.setattr)
    data, out = tmp_path / "rig", tmp_path / "out"
    asked = [f"--set={name}={value}" for name, value in TRUTH.items()]
    made = call(capsys, "simulate", data, "--seed", 3, "--rows", 20, "--outliers", 0.1, *asked)
    assert made.status == 0, made.err
    done = call(capsys, "calibrate", data, "--out", out)
    assert done.status in (0, 3), done.err
    truth = json.loads((data / "truth.json").read_text())
    assert {name: truth["parameters"][name] for name in TRUTH} == TRUTH
    result = json.loads((out / "calibration.json").read_text())
    fit = result["fits"]["axis-offset/robust"]
    for name, value in TRUTH.items():
        found = fit["parameters"][name]
        assert abs(found["value"] - value) < 4 * found["std"], name
    effective = fit["derived"]["effective_baseline_mm"]
    assert effective["std"] < 2
    assert abs(effective["value"] - 142.0) < 4 * effective["std"]
    assert fit["parameters"]["axis_z_mm"]["std"] < 2, "25 mm were simulated"
    measured = call(capsys, "measure", out / "calibration.json", data / "validation.csv")
    assert measured.status == 0, measured.err
    rows = {r["id"]: r for r in csv.DictReader(io.StringIO(measured.out))}
    with (data / "validation.csv").open() as file:
        references = list(csv.DictReader(file))
    assert len(rows) == len(references) == 10
    for reference in references:
        row = rows[reference["id"]]
        error = float(row["z_mm"]) - float(reference["z_mm"])
        u = (float(row["u_z_mm"]) ** 2 + float(reference["u_z_mm"]) ** 2) ** 0.5
        assert abs(error) < 4 * u
        assert u < 0.02 * float(row["z_mm"])


def test_same_seed_same_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        assert call(capsys, "simulate", tmp_path / name, "--seed", seed).status == 0
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert tree(tmp_path / "a")["gaze.csv"] != tree(tmp_path / "c")["gaze.csv"]


def test_a_dataset_is_not_made_where_one_lies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Property: the message is about datasets, which are made here, not about results."""
    out = tmp_path / "rig"
    assert call(capsys, "simulate", out, "--seed", 7).status == 0
    again = call(capsys, "simulate", out, "--seed", 8)
    assert again.status == 2
    assert "is a dataset already; delete it first, or name another place" in again.err
