"""The rig itself from the command line: check, capture, calibrate, gaze, without hardware.

Evidence: simulated truth, which only this test reads.
"""

from __future__ import annotations

import csv
import io
import json
import signal
import subprocess
import time
from functools import partial

import command
import pytest

from tests.reliability import short_chain
from tests.rig.checked_rig import CHECK, RIG


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """Give a folder with a rig in simulated time that was checked."""
    monkeypatch.chdir(tmp_path)
    short_chain.shorten(monkeypatch.setattr)
    short_chain.leave_out_pages(monkeypatch.setattr)
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    return tmp_path


@pytest.fixture
def call(capsys):
    """Give a function that runs calib in this process."""
    return partial(command.call, capsys)


def rows(text):
    return list(csv.DictReader(io.StringIO(text)))


def true_targets(lab):
    events = map(json.loads, (lab / "truth.jsonl").read_text().splitlines())
    return [event["xyz_mm"] for event in events if event["event"] == "target"]


def true_parameters(lab):
    first = (lab / "truth.jsonl").read_text().splitlines()[0]
    return json.loads(first)["parameters"]


def test_from_capture_to_measured_depths(lab, call):
    (lab / "rig.toml").write_text(RIG + 'truth = "truth.jsonl"\n')
    done = call("capture", "gaze", "mine", "--rig", "rig.toml", "--count", 15)
    assert done.status == 0, done.err
    done = call("capture", "validation", "mine", "--rig", "rig.toml", "--count", 2)
    assert done.status == 0, done.err
    *warnings, last = call("check", "mine").out.splitlines()
    assert last == "mine: no problems; 15 gaze rows, 2 validation rows, 1 returns"
    assert all("u_focal" in line for line in warnings), "what rig.toml cannot say of a given lens"
    assert len(list((lab / "mine").rglob("*.png"))) == 2 * (17 + 1)
    journal = [
        json.loads(line) for line in (lab / "mine" / "session.jsonl").read_text().splitlines()
    ]
    assert [entry["event"] for entry in journal].count("row") == 17
    assert journal[0]["u_alpha2_deg"] == 0.0027

    # Draws are few here: the gate of convergence may fail, and what is measured is then named so.
    call("calibrate", "mine", "--out", "run")
    result = json.loads((lab / "run" / "calibration.json").read_text())
    true = true_parameters(lab)
    assert result["rig"]["serial"] == "rig-07"
    fit = result["fits"][f"{result['selected']}/robust"]
    for name, found in fit["parameters"].items():
        if name in true:
            assert abs(found["value"] - true[name]) < 3 * found["std"], name
    (lab / "truth.jsonl").unlink()
    calibration = "run/calibration.json"
    done = call("gaze", calibration, "--rig", "rig.toml", "--count", 5, "--accept-failed")
    assert done.status == 0, done.err
    measured = rows(done.out)
    assert [row["status"] for row in measured] == ["ok"] * 5
    for row, (x, y, z) in zip(measured, true_targets(lab), strict=True):
        assert abs(float(row["z_mm"]) - z) < 3 * float(row["u_z_mm"])
        assert float(row["z_low95_mm"]) < float(row["z_mm"]) < float(row["z_high95_mm"])
        assert float(row["cov_zz_mm2"]) == pytest.approx(float(row["u_z_mm"]) ** 2, rel=1e-3)
        assert abs(float(row["x_mm"]) - x) < 1.0
        assert abs(float(row["y_mm"]) - y) < 1.0
        assert 1 <= int(row["moves"]) <= 6

    done = call(
        "gaze", calibration, "--rig", "rig.toml", "--count", 4, "--follow", "--accept-failed"
    )
    assert done.status == 0, done.err
    assert len({row["x_mm"] for row in rows(done.out)}) == 4
    refused_rigs(call, lab, calibration)
    interrupted(lab, calibration)


def interrupted(lab, calibration):
    """End a gaze by Ctrl-C: rows so far are kept, whole."""
    (lab / "truth.jsonl").unlink()
    arguments = ("gaze", calibration, "--rig", "rig.toml", "--count", "100000", "--accept-failed")
    with subprocess.Popen(
        [command.CALIB, *arguments, "--out", "live.csv"], stderr=subprocess.PIPE, text=True
    ) as running:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            if (lab / "truth.jsonl").exists() and len(true_targets(lab)) > 3:
                break
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    assert running.returncode == 128 + signal.SIGINT, said
    assert "Traceback" not in said
    kept = rows((lab / "live.csv").read_text())
    assert len(kept) >= 3
    assert all(row["status"] == "ok" for row in kept)


def refused_rigs(call, lab, calibration):
    """Another rig, another size of pictures and another target are refused by name."""
    other = RIG.replace("rig-07", "rig-08")
    (lab / "other.toml").write_text(other)
    done = call("gaze", calibration, "--rig", "other.toml")
    assert done.status == 2
    assert "is the calibration of rig rig-07; the rig that is open is rig-08" in done.err
    larger = RIG.replace("[cameras.c2]\n", "image_size = [800, 600]\n[cameras.c2]\n")
    (lab / "larger.toml").write_text(larger)
    done = call("gaze", calibration, "--rig", "larger.toml")
    assert done.status == 2
    assert "is for pictures of c1 of 640 x 480 px; the camera gives 800 x 600" in done.err
    done = call("gaze", calibration, "--rig", "rig.toml", "--target", "cross", "--accept-failed")
    assert "[virtual] target" in done.err
    assert done.status == 3
    assert "C1 does not see the target cross" in rows(done.out)[0]["status"]
    unfit = CHECK | {"checks": [{"name": "frame age", "passed": False, "detail": "old"}]}
    (lab / "rig-check.json").write_text(json.dumps(unfit))
    done = call("gaze", calibration, "--rig", "rig.toml", "--accept-failed")
    assert done.status == 3
    assert "rig-check.json: the rig is not fit: frame age: old; then run" in done.err
    (lab / "rig-check.json").write_text(json.dumps(CHECK))


def test_a_capture_goes_on_where_it_ended_and_counts_what_is_there(lab, call):
    for count in (1, 2):
        done = call("capture", "gaze", "mine", "--rig", "rig.toml", "--count", count)
        assert done.status == 0, done.err
        assert f"mine: {count} row" in done.out
    table = rows((lab / "mine" / "gaze.csv").read_text())
    assert [row["id"] for row in table] == ["g01", "g02"]
    assert table[0]["z_mm"] != table[1]["z_mm"]
    manifest = (lab / "mine" / "dataset.toml").read_text()
    assert "u_alpha2_deg = 0.0027" in manifest


def test_a_capture_refuses_what_would_spoil_the_dataset(lab, call):
    (lab / "rig-check.json").unlink()
    done = call("capture", "gaze", "mine", "--rig", "rig.toml")
    assert done.status == 2
    assert "run `calib rig check rig.toml` first" in done.err
    failed = CHECK | {"checks": [{"name": "frame age", "passed": False, "detail": "old"}]}
    (lab / "rig-check.json").write_text(json.dumps(failed))
    done = call("capture", "gaze", "mine", "--rig", "rig.toml")
    assert done.status == 3
    assert "the rig is not fit: frame age: old" in done.err
    (lab / "rig-check.json").write_text(json.dumps(CHECK))
    (lab / "mine").mkdir()
    (lab / "mine" / "dataset.toml").write_text('format = 1\nname = "x"\n[rig]\nserial = "rig-01"\n')
    done = call("capture", "gaze", "mine", "--rig", "rig.toml")
    assert done.status == 2
    assert "is of rig rig-01, the open one is rig-07" in done.err
    assert not (lab / "mine" / "gaze.csv").exists()


def test_targets_that_cannot_be_gazed_at_are_noted_and_end_the_capture(lab, call):
    done = call("capture", "gaze", "mine", "--rig", "rig.toml", "--target", "tag:DICT_4X4_50:3")
    assert done.status == 3
    assert "g01: C1 does not see the target tag:DICT_4X4_50:3" in done.err
    journal = (lab / "mine" / "session.jsonl").read_text().splitlines()
    assert [json.loads(line)["event"] for line in journal] == ["start"] + ["refused"] * 10
    assert not (lab / "mine" / "dataset.toml").exists()
