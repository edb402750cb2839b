"""Guided captures from the command line, without hardware. Evidence: property."""

from __future__ import annotations

import json
import tomllib
from functools import partial

import command
import pytest

from tests.rig.checked_rig import CHECK, RIG

SMALL = RIG.replace("[cameras.c2]", "image_size = [480, 360]\n[cameras.c2]").replace(
    '[axis]', 'image_size = [480, 360]\n[axis]'
)  # fmt: skip


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """Give a folder with a small rig in simulated time that was checked."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(SMALL)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    return tmp_path


@pytest.fixture
def call(capsys):
    """Give a function that runs calib in this process."""
    return partial(command.call, capsys)


def events(lab):
    lines = (lab / "mine" / "session.jsonl").read_text().splitlines()
    return [json.loads(line)["event"] for line in lines]


def test_a_lens_is_captured_resumed_and_enough_when_its_u_is(lab, call):
    intrinsics = ("capture", "intrinsics", "mine", "--rig", "rig.toml", "--camera", "c1")
    done = call(*intrinsics, "--count", 2)
    assert done.status == 3
    assert "mine: c1: 2 pictures, u" in done.out
    assert "needed" in done.out
    done = call(*intrinsics)
    assert done.status == 0, done.err
    assert done.err.splitlines()[0].startswith("3: ")
    pictures = sorted((lab / "mine" / "intrinsics" / "c1").glob("*.png"))
    assert [path.stem for path in pictures[:3]] == ["01", "02", "03"]
    assert len(pictures) >= 6
    assert not (lab / "mine" / "guide.png").exists()
    assert call("check", "mine").out.strip() == f"mine: no problems; {len(pictures)} images of C1"
    manifest = tomllib.loads((lab / "mine" / "dataset.toml").read_text())
    assert manifest["cameras"] == {
        "c1": {"image_size": [480, 360], "images": "intrinsics/c1/*.png"}
    }
    assert events(lab).count("view") == len(pictures)
    # Nothing is left to do.
    before = len(events(lab))
    assert call(*intrinsics).status == 0
    assert events(lab)[before:] == ["start"]


def test_a_lens_from_elsewhere_is_not_captured_over(lab, call):
    (lab / "mine").mkdir()
    (lab / "mine" / "dataset.toml").write_text(
        'format = 1\nname = "x"\n[cameras.c1]\nimage_size = [480, 360]\n'
        "matrix = [[500, 0, 240], [0, 500, 180], [0, 0, 1]]\n"
    )
    done = call("capture", "intrinsics", "mine", "--rig", "rig.toml")
    assert done.status == 2
    assert "[cameras.c1] has the lens of c1 already" in done.err


def test_pairs_and_sweep_follow_the_lenses_and_move_the_axis(lab, call):
    done = call("capture", "stereo", "mine", "--rig", "rig.toml", "--count", 1)
    assert done.status == 3, done.err
    done = call("capture", "sweep", "mine", "--rig", "rig.toml", "--count", 1)
    assert done.status == 3, done.err
    assert "mine: sweep: 1 placement, u" in done.out
    said = call("check", "mine").out
    assert "1 stereo pairs" in said
    table = (lab / "mine" / "sweep.csv").read_text().splitlines()
    assert table[0] == "id,placement,image_c2,alpha2_deg"
    turns = [float(line.split(",")[-1]) for line in table[1:]]
    assert len(turns) >= 8
    assert turns == sorted(turns)
    assert turns[-1] - turns[0] > 12
    (lab / "rig-check.json").unlink()
    done = call("capture", "sweep", "mine", "--rig", "rig.toml")
    assert done.status == 2
    assert "run `calib rig check rig.toml` first" in done.err
