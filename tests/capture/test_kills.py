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
PATIENCE_S = 300.0


def begun(lab, kind, count):
    return subprocess.Popen(
        [CALIB, "capture", kind, "mine", "--rig", "rig.toml", "--count", str(count)],
        cwd=lab, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def captured(lab, kind, count):
    with begun(lab, kind, count) as running:
        _, said = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, said


def table(lab, kind):
    path = lab / "mine" / f"{kind}.csv"
    if not path.exists():
        return []
    with path.open() as file:
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
@pytest.mark.parametrize("kind", ["gaze", "validation"])
def test_kills_at_random_moments_cost_one_row_at_most(tmp_path, kind):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    captured(tmp_path, "gaze", ROWS_FIRST)
    rng = np.random.default_rng(1)
    for _ in range(KILLS):
        before = len(table(tmp_path, kind))
        with begun(tmp_path, kind, 1000) as running:
            deadline = time.monotonic() + PATIENCE_S
            while len(table(tmp_path, kind)) == before and time.monotonic() < deadline:
                time.sleep(0.002)
            time.sleep(rng.uniform(0, 0.4))
            running.send_signal(signal.SIGKILL)
            _, said = running.communicate()
        dataset = load_dataset(tmp_path / "mine")
        rows = table(tmp_path, kind)
        # rig.toml cannot say how uncertain a lens is that it gives.
        assert all("u_focal" in warning for warning in dataset.warnings)
        assert len(rows) > before
        announced = [line.split(":")[0] for line in said.splitlines() if " moves, " in line]
        assert {row["id"] for row in rows} >= set(announced), "what was announced is there"
        assert len(rows) - before - len(announced) <= 1
        assert [row["id"] for row in rows] == [f"{kind[0]}{i + 1:02d}" for i in range(len(rows))]
        returns = table(tmp_path, "returns")
        for row in returns:
            for camera in ("c1", "c2"):
                name = f"returns/{camera}/{row['id']}.png"
                read_grey(tmp_path / "mine" / name, name=name)
        for row in rows[before:]:
            for column in ("image_c1", "image_c2"):
                read_grey(tmp_path / "mine" / row[column], name=row[column])
        assert len({row["id"] for row in rows} - set(noted(tmp_path))) <= KILLS
    captured(tmp_path, kind, len(table(tmp_path, kind)) + 1)
    assert len(table(tmp_path, "returns")) >= (len(table(tmp_path, kind)) - 1) // 10
    load_dataset(tmp_path / "mine")
    assert not list((tmp_path / "mine").rglob(".*.part"))
