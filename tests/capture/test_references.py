"""Depths of captured rows by the board's squares and by pairs. Evidence: simulated truth."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from calib.cli.main import main
from calib.dataset.load import load_dataset
from tests.rig.checked_rig import CHECK, RIG


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    (tmp_path / "rig.toml").write_text(RIG + 'truth = "truth.jsonl"\n')
    return tmp_path


def captured(kind, count, *more):
    return main(["capture", kind, "mine", "--rig", "rig.toml", "--count", str(count), *more])


def said_depths(text):
    return [
        float(line.split(" z ")[1].split(" mm")[0]) for line in text.splitlines() if " z " in line
    ]


def true_depths(lab):
    events = map(json.loads, (lab / "truth.jsonl").read_text().splitlines())
    return [event["xyz_mm"][2] for event in events if event["event"] == "target"]


def table(lab, kind):
    with (lab / "mine" / f"{kind}.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_pair_with_c2_held_is_taken_of_each_target_and_named_by_its_row(lab, capsys):
    assert captured("gaze", 2, "--reference", "pairs") == 0
    depths = said_depths(capsys.readouterr().err)
    # Squares of some 20 px seen to 0.02 px give a depth to 0.1 %.
    assert np.abs(np.array(depths) / true_depths(lab) - 1).max() < 2e-3
    rows = table(lab, "gaze")
    assert [row["stereo"] for row in rows] == ["01", "02"]
    assert "z_mm" not in rows[0]
    dataset = load_dataset(lab / "mine", rows_to_come=True)
    assert set(dataset.stereo_pairs) == {"01", "02"}
    assert dataset.manifest.gaze.reference == "stereo pairs, C2 held"
    assert dataset.manifest.gaze.origin == "c1"
    held = dataset.manifest.stereo.alpha2_deg
    assert 60 < held < 90
    # A capture goes on as it was begun, at the same reading, and nothing else is mixed in.
    assert captured("gaze", 3) == 0
    assert load_dataset(lab / "mine", rows_to_come=True).manifest.stereo.alpha2_deg == held
    assert [row["stereo"] for row in table(lab, "gaze")] == ["01", "02", "03"]
    capsys.readouterr()
    assert captured("gaze", 4, "--reference", "hand") == 2
    assert "the rows of [gaze] have their depths by pairs" in capsys.readouterr().err


def test_squares_give_the_scale_of_calibration_rows_alone(lab, capsys):
    assert captured("gaze", 1, "--reference", "squares") == 0
    assert set(table(lab, "gaze")[0]) & {"z_mm", "u_z_mm", "stereo"} == set()
    capsys.readouterr()
    assert captured("validation", 1, "--reference", "squares") == 2
    assert "need a depth that calibration rows have not" in capsys.readouterr().err
    assert captured("gaze", 1, "--reference", "squares", "--target", "cross") == 2
    assert "needs the board as the target" in capsys.readouterr().err


def test_what_pairs_need_is_asked_for(lab, capsys):
    text = RIG.replace("baseline_mm = 200\n", "")
    (lab / "rig.toml").write_text(text)
    assert captured("gaze", 1, "--reference", "pairs") == 2
    assert "states no baseline_mm" in capsys.readouterr().err
