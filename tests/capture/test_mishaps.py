"""What happens to a lab while it captures: a device lost, a clock set back, a second program.

Evidence: property.
"""

from __future__ import annotations

import json
import time
from datetime import datetime

import pytest

from calib.capture import journal
from calib.cli.main import main
from calib.core.errors import UsageError
from calib.rig.devices import alone
from calib.rig.settings import parse_settings
from tests.rig.checked_rig import CHECK, RIG


def test_a_device_that_stays_lost_ends_the_capture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG + "dropped_share = 1.0\n")
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    assert main(["capture", "gaze", "mine", "--rig", "rig.toml"]) == 3
    said = capsys.readouterr().err.splitlines()
    assert said[-1].startswith("calib: virtual camera c1, rig rig-07: no whole frame")
    events = map(json.loads, (tmp_path / "mine" / "session.jsonl").read_text().splitlines())
    assert [event["event"] for event in events] == ["start", *["refused"] * 3]


def test_times_of_rows_stay_in_order_though_the_clock_is_set_back(monkeypatch):
    before = datetime.fromisoformat(journal.now())
    set_back = time.time() - 3600
    monkeypatch.setattr(journal.time, "time", lambda: set_back)
    after = datetime.fromisoformat(journal.now())
    assert 0 <= (after - before).total_seconds() < 60


def test_rows_do_not_go_on_behind_a_clock_that_was_set_back_meanwhile(monkeypatch):
    events = [{"event": "row", "time": journal.now()}, {"event": "begun"}]
    journal.refuse_earlier(events)
    monkeypatch.setattr(journal, "_START", journal._START - 30)
    journal.refuse_earlier(events)
    monkeypatch.setattr(journal, "_START", journal._START - 3600)
    with pytest.raises(UsageError, match=r"this computer's clock says .*; set the clock, or"):
        journal.refuse_earlier(events)


def test_two_programs_do_not_turn_one_motor(tmp_path):
    text = RIG.replace('[axis]\ndriver = "virtual"', '[axis]\ndriver = "ximc"')
    (tmp_path / "rig.toml").write_text(text)
    real, virtual = parse_settings(text.encode()), parse_settings(RIG.encode())
    path = tmp_path / "rig.toml"
    with alone(path, real):
        with pytest.raises(UsageError, match="another program drives this rig"), alone(path, real):
            pass
        with alone(path, virtual):
            pass
    with alone(path, real):
        pass
