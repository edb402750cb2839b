"""A run says what was done wrong: console, calibration.json, gate, exit status.

Evidence: simulated truth; the same rig in a mirror.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_rigs import fitted_folder

from calib.cli.main import main
from calib.dataset.load import load_dataset
from calib.diagnosis.correction import correct_rows
from calib.diagnosis.session import row_history
from calib.document.calibration import Document
from calib.fit.noise import row_noise
from calib.fit.priors import prior_of
from calib.fit.robust import fit_model
from calib.geometry.misclosure import misclosure
from calib.geometry.plane import OBSERVABLE
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset
from tests.chain.left_rigs import mirror_dataset
from tests.reliability.short_chain import leave_out_pages, shorten


def calibrated(
    folder: Path, out: Path, capsys: pytest.CaptureFixture[str], *, pages: bool = False
) -> tuple[int, str, dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        if not pages:
            leave_out_pages(patch.setattr)
        status = main(["calibrate", str(folder), "--out", str(out)])
    document: dict[str, Any] = json.loads((out / "calibration.json").read_text())
    Document.model_validate_json(json.dumps(document))
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
    (residuals,) = (g for g in document["gates"] if g["name"] == "residuals")
    assert cause["noise_scale"][0] > 2
    assert not residuals["passed"]
    assert min(t["probability"] for t in document["residual_structure"]) < 1e-4
    assert "CAUSE  reading-step: from row g13 on" in said
    assert "GATE FAILED  diagnosis: reading-step" in said


@pytest.mark.slow
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


def accepting(folder: Path, to: Path, cause: str) -> Path:
    shutil.copytree(folder, to)
    with (to / "dataset.toml").open("a") as file:
        file.write(f'\n[corrections]\naccept = "{cause}"\n')
    return to


def test_an_accepted_slip_is_corrected_stated_and_certified(
    slipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = accepting(slipped, tmp_path / "data", "reading-step")
    out = tmp_path / "out"
    _, said, document = calibrated(folder, out, capsys, pages=True)
    (correction,) = document["corrections"]
    assert (correction["cause"], correction["at"]) == ("reading-step", "g13")
    assert abs(correction["estimate"] - 0.25) < 4 * correction["std"] < 0.1
    assert document["diagnosis"] == []
    assert gate(document)["passed"]
    assert "the rows are corrected ([corrections]): from row g13 on" in said
    assert "The calibration rows were corrected" in (out / "certificate.html").read_text()
    truth = json.loads((folder / "truth.json").read_text())["parameters"]["delta2_rad"]
    # The rig as it was at the end reads higher by the slip: its zero is lower.
    zero = document["fits"][f"{document['selected']}/robust"]["parameters"]["delta2_rad"]
    assert abs(zero["value"] - (truth - np.deg2rad(0.25))) < 4 * zero["std"]
    assert zero["std"] < np.deg2rad(0.1)


def test_a_correction_is_as_uncertain_as_in_a_joint_fit(slipped: Path, tmp_path: Path) -> None:
    """Evidence: the covariance of a fit of parameters and correction at once."""
    folder = accepting(slipped, tmp_path / "data", "reading-step")
    rows, priors, _, _ = fitted_folder(folder, "axis-offset")
    history = row_history(load_dataset(folder))
    corrected = correct_rows(rows, priors, history, accepted="reading-step", is_left=False)
    with_it = fit_model(corrected.rows, priors, model="axis-offset")
    known = replace(corrected.rows, alone=np.zeros((0, 0, 0)), alone_names=())
    without = fit_model(known, priors, model="axis-offset")
    np.testing.assert_allclose(with_it.values, without.values, rtol=1e-9)
    c = misclosure(without.theta, known.gaze, known.z_mm, parameters=without.structure.indices)
    sigma = without.noise_scale * row_noise(without.theta, known).sigma
    before = np.arange(len(rows)) < 12
    slope = np.column_stack([c.by_theta, c.by_observable[:, OBSERVABLE.alpha2] * before])
    slope = slope / sigma[:, None]
    precision = slope.T @ slope
    precision[:-1, :-1] += prior_of(without.structure, priors).precision
    joint = np.linalg.inv(precision)[:-1, :-1]
    alone = np.linalg.inv(precision[:-1, :-1])
    widened = np.diag(with_it.covariance) / np.diag(without.covariance)
    wanted = np.diag(joint) / np.diag(alone)
    assert wanted.max() > 1.02
    # The correction is estimated with robust tails, a tenth less efficient than the fit's.
    np.testing.assert_allclose(widened - 1, wanted - 1, rtol=0.35, atol=0.005)


def test_a_correction_that_rows_cannot_tell_is_refused(
    slipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = accepting(slipped, tmp_path / "data", "group-reference")
    status = main(["calibrate", str(folder), "--out", str(tmp_path / "out")])
    assert status == 2
    assert "the rows cannot tell it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        ("reading-stop", "did you mean 'reading-step'"),
        ("c1-focal-length", "[cameras.c1]"),
        ("reference-offset", "z_from"),
    ],
)
def test_what_cannot_be_accepted_is_refused(
    cause: str, said: str, slipped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = accepting(slipped, tmp_path / "data", cause)
    assert main(["check", str(folder)]) == 2
    assert said in capsys.readouterr().err
