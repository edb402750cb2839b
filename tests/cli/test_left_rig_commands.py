"""A rig with C2 on the left, by the commands a user has: simulated, calibrated, measured, planned.

Evidence: simulated truth; negative controls.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from command import call

import calib.fit.chains
import calib.stages.store
from calib.geometry.parameters import vector
from calib.geometry.plane import gaze_at

SHORT = {"TAU_MULTIPLE": 5.0, "ESS_GOAL": 100.0, "R_HAT_LIMIT": 1.5, "WALKER_R_HAT_LIMIT": 9.0}
SERIAL = "AG-0042"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated left rig with a serial number, and its run in `out`."""
    folder = tmp_path_factory.mktemp("left")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in SHORT.items():
            patch.setattr(calib.fit.chains, name, value)
        patch.setattr(calib.stages.store, "processors", lambda: 1)
        from calib.cli.main import main

        made = ["simulate", folder / "rig", "--seed", 3, "--rows", 20, "--c2", "left"]
        assert main([*map(str, made), "--set=baseline_mm=-140", "--set=eccentricity_mm=2"]) == 0
        manifest = folder / "rig" / "dataset.toml"
        text = manifest.read_text().replace('c2 = "left"', f'c2 = "left"\nserial = "{SERIAL}"')
        manifest.write_text(text)
        assert main(["calibrate", str(folder / "rig"), "--out", str(folder / "out")]) in (0, 3)
    return folder


def test_truth_is_recovered_on_the_left(rig: Path) -> None:
    truth = json.loads((rig / "rig" / "truth.json").read_text())["parameters"]
    assert (truth["baseline_mm"], truth["eccentricity_mm"]) == (-140.0, 2.0)
    result = json.loads((rig / "out" / "calibration.json").read_text())
    fit = result["fits"]["axis-offset/robust"]["parameters"]
    for name in ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"):
        assert abs(fit[name]["value"] - truth[name]) < 4 * fit[name]["std"], name
    assert fit["axis_z_mm"]["std"] < 3
    assert not [gate for gate in result["gates"] if not gate["passed"]]


def test_side_and_serial_are_in_every_output(rig: Path) -> None:
    result = json.loads((rig / "out" / "calibration.json").read_text())
    assert result["rig"] == {"c2": "left", "serial": SERIAL}
    for name in ("certificate.html", "certificate.xml"):
        assert SERIAL in (rig / "out" / name).read_text()
    report = (rig / "out" / "report.html").read_text()
    assert "the yaw axis of C2 to the left of it" in report


def test_measured_depths_hold_the_truth(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = rig / "rig" / "validation.csv"
    measured = call(capsys, "measure", rig / "out" / "calibration.json", table)
    assert measured.status == 0, measured.err
    rows = list(csv.DictReader(io.StringIO(measured.out)))
    truth = json.loads((rig / "rig" / "truth.json").read_text())["rows"]["validation"]
    for row in rows:
        for axis, true in zip("xyz", truth[row["id"]]["point_mm"], strict=True):
            assert abs(float(row[f"{axis}_mm"]) - true) < 4 * float(row[f"u_{axis}_mm"])
    assert len(rows) == 10


def test_planned_targets_are_gazed_at_from_the_left(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planned = call(capsys, "plan", rig / "rig", "--depth", 900, "--rows", 3)
    assert planned.status == 0, planned.err
    lines = planned.out.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("G-optimal"))
    result = json.loads((rig / "out" / "calibration.json").read_text())["fits"]
    fit = result["axis-offset/robust"]
    names = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")
    theta = vector({name: fit["parameters"][name]["value"] for name in names})
    for line in lines[start + 2 : start + 5]:
        _, x, y, z, _, alpha2, _ = map(float, line.split())
        expected = np.degrees(gaze_at(theta, np.array([[x, y, z]])).alpha2[0])
        assert alpha2 == pytest.approx(expected, abs=0.1)


def test_a_baseline_on_the_other_side_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for side, value, other in (("left", 140, "right"), ("right", -140, "left")):
        done = call(capsys, "simulate", tmp_path / side, "--seed", 1, "--c2", side,
                    f"--set=baseline_mm={value}")  # fmt: skip
        assert done.status == 2
        assert f"--c2 {other}" in done.err
        assert not (tmp_path / side).exists()
