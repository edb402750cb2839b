"""A run says what was done wrong: console, calibration.json, gate, exit status.

Evidence: simulated truth; the same rig in a mirror.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import pytest

from calib.cli.main import main
from calib.results.schema import Document
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset
from tests.chain.left_rigs import mirror_dataset
from tests.reliability.short_chain import shorten


def calibrated(
    folder: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str, dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shorten(patch.setattr)
        status = main(["calibrate", str(folder), "--out", str(out)])
    document: dict[str, Any] = json.loads((out / "calibration.json").read_text())
    Document.model_validate(document)
    return status, capsys.readouterr().out, document


def gate(document: dict[str, Any]) -> dict[str, Any]:
    (found,) = (g for g in document["gates"] if g["name"] == "diagnosis")
    return dict(found)


@pytest.fixture(scope="module")
def slipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("slip") / "data"
    options = SimulationOptions(seed=2, rows=24, faults={"reading-step": 0.25})
    simulate_dataset(folder, options)
    return folder


def test_a_slip_fails_its_gate_and_is_named(
    slipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said, document = calibrated(slipped, tmp_path / "out", capsys)
    assert status == 3
    cause = document["diagnosis"][0]
    assert (cause["cause"], cause["at"], cause["unit"]) == ("reading-step", "g13", "deg")
    assert abs(cause["estimate"] - 0.25) < 4 * cause["std"] < 0.1
    assert cause["noise_scale"][1] < 1.5 < cause["noise_scale"][0]
    assert cause["depth_change_over_u"] > 1
    assert not gate(document)["passed"]
    assert "CAUSE  reading-step: from row g13 on" in said
    assert "GATE FAILED  diagnosis: reading-step" in said


def test_its_mirror_image_has_the_opposite_slip(
    slipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left = mirror_dataset(slipped, tmp_path / "left")
    _, _, document = calibrated(left, tmp_path / "out", capsys)
    cause = document["diagnosis"][0]
    assert (cause["cause"], cause["at"]) == ("reading-step", "g13")
    assert abs(cause["estimate"] + 0.25) < 4 * cause["std"] < 0.1


def test_a_clean_rig_has_no_cause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate_dataset(tmp_path / "data", SimulationOptions(seed=2, rows=24))
    _, said, document = calibrated(tmp_path / "data", tmp_path / "out", capsys)
    assert document["diagnosis"] == []
    assert gate(document)["passed"]
    assert "CAUSE" not in said
