"""A guided capture killed at any moment leaves a dataset that passes the check, and goes on.

Evidence: property, by SIGKILL at random moments.
"""

from __future__ import annotations

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
KILLS = 8
PATIENCE_S = 240.0


def begun(lab, *arguments):
    return subprocess.Popen(
        [CALIB, "capture", *arguments, "mine", "--rig", "rig.toml"],
        cwd=lab, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def written(lab):
    return sorted((lab / "mine").rglob("[!.]*.png")) if (lab / "mine").exists() else []


@pytest.mark.slow
def test_kills_at_random_moments_leave_a_whole_dataset(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    rng = np.random.default_rng(1)
    for command in (("intrinsics", "--tolerance", "0.002"), ("sweep", "--tolerance", "0.002")):
        if command[0] == "sweep":
            with begun(tmp_path, "intrinsics") as running:
                _, said = running.communicate(timeout=PATIENCE_S)
            assert running.returncode == 0, said
        for _ in range(KILLS):
            before = len(written(tmp_path))
            with begun(tmp_path, *command, "--count", "1000") as running:
                deadline = time.monotonic() + PATIENCE_S
                while len(written(tmp_path)) == before and running.poll() is None:
                    assert time.monotonic() < deadline
                    time.sleep(0.002)
                time.sleep(rng.uniform(0, 0.4))
                running.send_signal(signal.SIGKILL)
                running.communicate()
            for picture in written(tmp_path):
                if picture.name != "guide.png":
                    read_grey(picture, name=picture.name)
            if (tmp_path / "mine" / "dataset.toml").exists():
                assert load_dataset(tmp_path / "mine").warnings == ()
    with begun(tmp_path, "sweep") as running:
        _, said = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, said
    assert not list((tmp_path / "mine").rglob(".*.part"))
    load_dataset(tmp_path / "mine")
