"""Runs that must not be used, from the falsified table to all that would use them.

Evidence: simulated truth, falsified on purpose. The chains are short, see short_chain.py.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from short_chain import shorten

import calib
from calib.cli.main import main

Row = dict[str, str]


def too_long(rows: list[Row]) -> None:
    """Make 3 of 12 reference depths 6 % too long."""
    for row in (rows[1], rows[4], rows[9]):
        row["z_mm"] = str(1.06 * float(row["z_mm"]))


def in_reverse(rows: list[Row]) -> None:
    """Give each row the depth of another, as where two lists were merged the wrong way round."""
    depths = [row["z_mm"] for row in reversed(rows)]
    for row, z in zip(rows, depths, strict=True):
        row["z_mm"] = z


@dataclass(frozen=True)
class Runs:
    data: Path
    good: Path
    failed: Path


def run(data: Path, out: Path) -> int:
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        return main(["calibrate", str(data), "--out", str(out), "--quiet"])


@pytest.fixture(scope="module", params=[too_long, in_reverse], ids=lambda f: f.__name__)
def runs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Runs:
    top = tmp_path_factory.mktemp("failed")
    data = top / "rig"
    assert main(["simulate", str(data), "--seed", "3", "--rows", "12", "--quiet"]) == 0
    assert run(data, top / "good") == 0
    spoil: Callable[[list[Row]], None] = request.param
    table = data / "gaze.csv"
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    spoil(rows)
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert run(data, top / "failed") == 3
    return Runs(data, top / "good", top / "failed")


@pytest.mark.slow
def test_whoever_uses_a_failed_run_is_told(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gates = json.loads((runs.failed / "calibration.json").read_text())["gates"]
    failed = [gate["name"] for gate in gates if not gate["passed"]]
    assert "residuals" in failed
    causes = json.loads((runs.failed / "calibration.json").read_text())["diagnosis"]
    assert not causes, "neither is a mistake that it has a name for"
    readings = tmp_path / "readings.csv"
    readings.write_text("id,x1c,y1c,alpha2_deg\na,0.10,0.05,86.4\n")
    calibration = str(runs.failed / "calibration.json")
    commands = (
        ("measure", calibration, str(readings)),
        ("compare", str(runs.good), str(runs.failed)),
        ("plan", str(runs.data), "--depth", "1500", "--rows", "2"),
    )
    for command in commands:
        capsys.readouterr()
        assert main(list(command)) == 3, command
        told = capsys.readouterr()
        assert "gate residuals FAILED" in told.err
        assert "--accept-failed" in told.err
        assert main([*command, "--accept-failed"]) == 0
        assert capsys.readouterr().err.count("FAILED") == 0
    assert main(["verify", str(runs.failed)]) == 0
    assert f"gates failed ({', '.join(failed)})" in capsys.readouterr().out
    with pytest.warns(calib.FailedGates, match="residuals"):
        assert calib.load(calibration).failed_gates == tuple(failed)
    report = (runs.failed / "report.html").read_text()
    assert "Do not use this calibration" in report
    assert "What to do with it" not in report
    certificate = runs.failed / "certificate.html"
    if certificate.exists():
        assert "Not to be used" in certificate.read_text()
    else:
        _, warnings_told = (main(["calibrate", str(runs.data), "--out", str(runs.failed), "-q"]),
                            capsys.readouterr().out)  # fmt: skip
        assert "warning: no certificate: " in warnings_told
