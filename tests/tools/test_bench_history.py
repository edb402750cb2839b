"""The fleet that timings are taken of. Evidence: property."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest

from calib.history.index import history, rigs, update
from tests.history.fleet import TRUTH, written
from tools import bench_history


def test_a_fleet_is_one_of_sound_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = written(tmp_path / "run", TRUTH, rig=None, day=date(2021, 1, 1))
    (run / "certificate.xml").write_text("<c/>")
    monkeypatch.setattr(bench_history, "RIGS", 2)
    monkeypatch.setattr(bench_history, "EACH", 3)
    bench_history.fleet(run, tmp_path / "runs")
    found = update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    assert (found.calibrations, found.unreadable) == (6, ())
    assert [(rig, number) for rig, number, _ in rigs(tmp_path / "i.sqlite")] == [
        ("R000", 3), ("R001", 3),
    ]  # fmt: skip
    assert len({e.values.tobytes() for e in history(tmp_path / "i.sqlite", "R000")}) == 3
