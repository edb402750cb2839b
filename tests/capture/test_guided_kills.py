"""Guided captures killed at any moment lose one view at most, and never what they announced.

Evidence: property, by SIGKILL: every other time within milliseconds of a new file, where a picture
may lack its table or its manifest, else at any moment of a view.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

from calib.dataset.load import load_dataset
from calib.images.detection.picture import read_grey
from tests.rig.checked_rig import CHECK, RIG

CALIB = Path(sys.executable).with_name("calib")
KILLS = 10
PATIENCE_S = 240.0
NEAR_A_FILE_S, A_VIEW_S = 0.02, 3.0
ANNOUNCED = {
    "intrinsics": re.compile(r"^(intrinsics/c1/\d+\.png): u ", re.MULTILINE),
    "stereo": re.compile(r"^pair (\d+\.png): u ", re.MULTILINE),
    "sweep": re.compile(r"^placement (\d+): \d+ pictures", re.MULTILINE),
}
NO_PARTNER = "[stereo]: 1 image(s) without a partner are not used"


def begun(lab, kind, *more):
    return subprocess.Popen(
        [CALIB, "capture", kind, "mine", "--rig", "rig.toml", *more],
        cwd=lab, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip


def captured(lab, kind, *more):
    with begun(lab, kind, *more) as running:
        _, said = running.communicate(timeout=PATIENCE_S)
    assert running.returncode == 0, said


@pytest.fixture(scope="module")
def labs(tmp_path_factory):
    """Return the folder that each capture goes on with; it passes the check."""
    lab, found = tmp_path_factory.mktemp("lab"), {}
    (lab / "rig.toml").write_text(RIG)
    (lab / "rig-check.json").write_text(json.dumps(CHECK))
    for kind in ANNOUNCED:
        captured(lab, kind)
        found[kind] = lab.with_name(f"{lab.name}-{kind}")
        shutil.copytree(lab, found[kind])
    return found


def names(lab):
    """Return the names of the pictures taken; the outline, `guide.png`, is none."""
    root = lab / "mine"
    return {str(path.relative_to(root)) for path in root.glob("*/*/[!.]*.png")}


def files(lab):
    """Return the bytes of all pictures, by name."""
    return {name: (lab / "mine" / name).read_bytes() for name in names(lab)}


def table(lab):
    path = lab / "mine" / "sweep.csv"
    return list(csv.DictReader(path.read_text().splitlines())) if path.exists() else []


def views(lab, kind):
    """Return what is there by the names under which views are announced."""
    if kind == "sweep":
        return {row["placement"] for row in table(lab)}
    if kind == "stereo":
        pairs = [
            {p.name for p in (lab / "mine/stereo" / c).glob("[!.]*.png")} for c in ("c1", "c2")
        ]
        return pairs[0] & pairs[1]
    return {name for name in files(lab) if name.startswith("intrinsics/c1/")}


def kill(lab, kind, rng, *, near_a_file):
    """Begin a capture that wants more than there is, kill it in its first view or soon after."""
    before = names(lab)
    camera = ["--camera", "c1"] if kind == "intrinsics" else []
    with begun(lab, kind, "--tolerance", "1e-6", "--count", "400", *camera) as running:
        deadline = time.monotonic() + PATIENCE_S
        while names(lab) == before:
            assert running.poll() is None, running.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.0005)
        time.sleep(rng.uniform(0, NEAR_A_FILE_S if near_a_file else A_VIEW_S))
        running.send_signal(signal.SIGKILL)
        _, said = running.communicate()
    return ANNOUNCED[kind].findall(said)


def names_only_what_is_there(root):
    """Assert that whatever manifest and table name is there."""
    manifest = tomllib.loads((root / "dataset.toml").read_text())
    patterns = [c["images"] for c in manifest["cameras"].values() if "images" in c]
    patterns += [manifest["stereo"][c] for c in ("c1", "c2") if "stereo" in manifest]
    for pattern in patterns:
        assert list(root.glob(pattern)), pattern
    if "sweep" in manifest:
        assert (root / manifest["sweep"]["table"]).exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ANNOUNCED)
def test_kills_cost_a_view_at_most(labs, kind):
    lab, rng = labs[kind], np.random.default_rng(1)
    root = lab / "mine"
    for number in range(KILLS):
        before, seen_before = files(lab), views(lab, kind)
        announced = kill(lab, kind, rng, near_a_file=number % 2 == 0)
        after = files(lab)
        orphan = {n for n in before if kind == "stereo" and Path(n).name not in seen_before}
        lost = {name for name in before if after.get(name) != before[name]}
        assert lost <= orphan, "a picture that was whole is there as it was"
        assert views(lab, kind) >= seen_before | set(announced), "what was announced is there"
        assert len(views(lab, kind) - seen_before) - len(announced) <= 1
        assert set(load_dataset(root).warnings) <= {NO_PARTNER}
        names_only_what_is_there(root)
        for name in after:
            read_grey(root / name, name=name)
        assert all(row["image_c2"] in after for row in table(lab))
    captured(lab, kind, "--tolerance", "0.5")
    assert not list(root.rglob(".*.part"))
    assert len(files(lab)) >= len(after)
