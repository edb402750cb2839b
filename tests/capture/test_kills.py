"""A capture killed at any moment leaves a dataset that passes the check and lacks one row at most.

Evidence: property, by SIGKILL at random moments.
"""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from calib.dataset.load import load_dataset
from calib.images.detection.picture import read_grey
from tests.rig.checked_rig import CHECK, RIG

CALIB = Path(sys.executable).with_name("calib")
KILLS = 30
ROWS_FIRST = 8
PATIENCE_S = 120.0


def begun(lab, count):
    return subprocess.Popen(
        [CALIB, "capture", "gaze", "mine", "--rig", "rig.toml", "--count", str(count)],
        cwd=lab, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def captured(lab, count):
    with begun(lab, count) as running:
        _, said = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, said


def table(lab):
    with (lab / "mine" / "gaze.csv").open() as file:
        return list(csv.DictReader(file))


def noted(lab):
    lines = (lab / "mine" / "session.jsonl").read_text().splitlines()
    events = []
    for i, line in enumerate(lines):
        try:
            events.append(json.loads(line))
        except ValueError:
            assert i == len(lines) - 1, "only the last line may be torn"
    return [event["id"] for event in events if event["event"] == "row"]


@pytest.mark.slow
def test_kills_at_random_moments_cost_one_row_at_most(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    captured(tmp_path, ROWS_FIRST)
    rng = np.random.default_rng(1)
    for _ in range(KILLS):
        before = len(table(tmp_path))
        with begun(tmp_path, 1000) as running:
            deadline = time.monotonic() + PATIENCE_S
            while len(table(tmp_path)) == before and time.monotonic() < deadline:
                time.sleep(0.002)
            time.sleep(rng.uniform(0, 0.4))
            running.send_signal(signal.SIGKILL)
            _, said = running.communicate()
        dataset = load_dataset(tmp_path / "mine")
        rows = table(tmp_path)
        assert dataset.warnings == ()
        assert len(rows) > before
        announced = [line.split(":")[0] for line in said.splitlines() if " moves, " in line]
        assert {row["id"] for row in rows} >= set(announced), "what was announced is there"
        assert len(rows) - before - len(announced) <= 1
        assert [row["id"] for row in rows] == [f"g{i + 1:02d}" for i in range(len(rows))]
        for row in rows[before:]:
            for column in ("image_c1", "image_c2"):
                read_grey(tmp_path / "mine" / row[column], name=row[column])
        assert len({row["id"] for row in rows} - set(noted(tmp_path))) <= KILLS
    captured(tmp_path, len(table(tmp_path)) + 1)
    load_dataset(tmp_path / "mine")
    assert not list((tmp_path / "mine").rglob(".*.part"))
