"""Errors that readings share with the calibration, and `calib measure --sources`.

Evidence: independent computation, from the law and central differences in `test_measure`.
"""

from __future__ import annotations

import csv
import io
import json
from math import hypot, radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import call
from given_calibration import COVARIANCE, FX, ROUNDING, U_X, calibration, gradient, reading_std

X, DEG = 0.12, 88.0

# c1.fx and c1.cx by two errors of C1, the pose of C2 by a third, which no reading has of its own.
FACTOR = np.array([[0.8, 0.0, 0.0], [0.3, 0.4, 0.0], [0.02, 0.01, 0.05]])
BY_SHARED = np.array([[0.3, -0.1, 0.4], [6e-5, 8e-5, 3e-5], [0.1, 0.0, 0.2], [-0.3, 0.1, -0.4]])
SOURCES = ["intrinsics of C1", "intrinsics of C1", "pose of C2 (stereo reference)"]


def with_shared(**changes: Any) -> dict[str, Any]:
    document = calibration()
    for camera in document["intrinsics"].values():
        camera["distortion"] = []
    document["measurement"]["shared"] = {
        "names": ["c1.fx", "c1.cx", "t12.x"],
        "factor": FACTOR.tolist(),
        "with_parameters": BY_SHARED.tolist(),
        "sources": SOURCES,
    } | changes
    return document


def measured(
    document: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], *options: str
) -> list[dict[str, str]]:
    path, table = tmp_path / "calibration.json", tmp_path / "t.csv"
    path.write_text(json.dumps(document))
    table.write_text(f"id,x1c,y1c,alpha2_deg\na,{X},0.05,{DEG}\n")
    ended = call(capsys, "measure", path, table, *options)
    assert ended.status == 0, ended.err
    return list(csv.DictReader(io.StringIO(ended.out)))


def effects() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], float, float]:
    """Return dz by parameters; by each shared error through the reading; by x1c, by angle."""
    by, by_x, by_reading = gradient(X, radians(DEG))
    # x1c = (u - cx) / fx: what the errors of fx and cx do to it.
    by_intrinsics = np.array([-X / FX, -1 / FX, 0.0])
    return by, by_x * (by_intrinsics @ FACTOR), by_x * U_X, by_reading * reading_std()


def test_shared_errors_enter_by_parameters_and_reading(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (row,) = measured(with_shared(), tmp_path, capsys)
    by, direct, *own = effects()
    c = np.array(COVARIANCE)
    variance = by @ c @ by + 2 * by @ BY_SHARED @ direct + direct @ direct + hypot(*own) ** 2
    assert float(row["u_z_mm"]) == pytest.approx(sqrt(variance), rel=1e-6, abs=ROUNDING)
    # A control: taken as independent of the parameters they would give another figure.
    apart = sqrt(variance - 2 * by @ BY_SHARED @ direct)
    assert abs(apart / sqrt(variance) - 1) > 0.01


def test_sources_of_a_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = measured(with_shared(), tmp_path, capsys, "--sources")
    by, direct, by_x, by_angle = effects()
    both = by @ BY_SHARED + direct
    own = np.array(COVARIANCE) - BY_SHARED @ BY_SHARED.T
    expected = {
        "parameters": sqrt(by @ own @ by),
        "intrinsics of C1": hypot(both[0], both[1]),
        "pose of C2 (stereo reference)": abs(both[2]),
        "x1c": abs(by_x),
        "alpha2": abs(by_angle),
    }
    assert [row["source"] for row in rows] == list(expected)
    found = {row["source"]: float(row["u_z_mm"]) for row in rows}
    for source, u in expected.items():
        assert found[source] == pytest.approx(u, rel=1e-6, abs=ROUNDING)
    assert sum(float(row["share_percent"]) for row in rows) == pytest.approx(100, abs=0.03)
    (whole,) = measured(with_shared(), tmp_path, capsys)
    assert hypot(*found.values()) == pytest.approx(float(whole["u_z_mm"]), abs=3 * ROUNDING)


def test_a_file_without_sources_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = with_shared()
    del document["measurement"]["shared"]["sources"]
    old = measured(document, tmp_path, capsys)
    assert old == measured(with_shared(), tmp_path, capsys)
    names = [row["source"] for row in measured(document, tmp_path, capsys, "--sources")]
    assert names == ["parameters", "intrinsics and pose of the cameras", "x1c", "alpha2"]


def test_a_contradiction_widens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Shared errors that explain more than is uncertain must not make the rest negative."""
    too_much = (10 * BY_SHARED).tolist()
    (row,) = measured(with_shared(with_parameters=too_much), tmp_path, capsys)
    by, direct, *_ = effects()
    assert float(row["u_z_mm"]) >= float(np.linalg.norm(by @ (10 * BY_SHARED) + direct))


def test_sources_that_do_not_belong_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table = tmp_path / "calibration.json", tmp_path / "t.csv"
    path.write_text(json.dumps(with_shared(sources=["C1"])))
    table.write_text(f"id,x1c,y1c,alpha2_deg\na,{X},0.05,{DEG}\n")
    ended = call(capsys, "measure", path, table, "--sources")
    assert ended.status == 2
    assert "sources of the shared errors" in ended.err


def test_borrowed_depths_have_the_sources_of_the_row_they_come_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table = tmp_path / "calibration.json", tmp_path / "t.csv"
    path.write_text(json.dumps(with_shared()))
    table.write_text(
        f"id,x1c,y1c,alpha2_deg,depth_row\ncentre,{X},0.05,{DEG},centre\ncorner,0.2,0,89,centre\n"
    )
    ended = call(capsys, "measure", path, table, "--sources")
    rows = [list(row.values())[1:] for row in csv.DictReader(io.StringIO(ended.out))]
    assert rows[:5] == rows[5:]
