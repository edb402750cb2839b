"""`calib rig check`: what would spoil rows is found.

Evidence: simulated truth; drivers that lie and encoders that count the wrong way are the negative
controls.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import pytest
from virtual_rigs import OPEN_LOOP, virtual_rig

from calib.cli.main import main
from calib.core.errors import InputError
from calib.rig.check import check_rig
from calib.rig.check_file import read_check
from calib.rig.protocols import Frame
from calib.rig.virtual.operator import Operator
from tests.rig.checked_rig import RIG


def checked(rig, **changed):
    Operator(rig.world).show_gaze()
    return check_rig(replace(rig, **changed), rig.world.board, lens_c2=rig.world.rig.c2)


@pytest.fixture
def command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(more: str = ""):
        (tmp_path / "rig.toml").write_text(RIG + more)
        status = main(["rig", "check", "rig.toml"])
        return status, capsys.readouterr().out

    return call


def test_a_sound_rig_passes_and_its_readings_are_as_good_as_their_counts(command, tmp_path):
    status, said = command()
    assert status == 0, said
    found = json.loads((tmp_path / "rig-check.json").read_text())
    assert all(check["passed"] for check in found["checks"])
    assert found["direction"] == 1
    assert found["serial"] == "rig-07"
    assert found["u_alpha2_deg"] == pytest.approx(0.009 / math.sqrt(12), rel=0.3)
    assert found["backlash_steps"] < 0.2
    assert abs(found["step_ratio"] - 1) < 0.1
    assert read_check(tmp_path / "rig-check.json", serial="rig-07").failed == ()
    with pytest.raises(InputError, match="is of rig rig-07, not of rig-08"):
        read_check(tmp_path / "rig-check.json", serial="rig-08")


def test_a_wrong_sign_and_an_old_frame_fail(command, tmp_path):
    status, said = command("stale = true\nreversed = true\n")
    assert status == 3
    found = json.loads((tmp_path / "rig-check.json").read_text())
    failed = {check["name"] for check in found["checks"] if not check["passed"]}
    assert failed >= {"encoder direction", "frame age"}
    assert found["direction"] == -1
    assert "the encoder counts the wrong way" in said
    assert "before the moment after which it was to be exposed" in said


class Behind:
    """A driver with a queue: hands out the frame that was asked for before, under a new time."""

    def __init__(self, camera):
        self._camera = camera
        self._kept = None

    def __getattr__(self, name):
        return getattr(self._camera, name)

    def after(self, moment, *, timeout_s):
        new = self._camera.after(moment, timeout_s=timeout_s)
        old, self._kept = self._kept or new, new
        return Frame(old.pixels, new.exposed_ns, new.sure, new.serial)


def test_a_driver_that_hands_out_the_frame_before_is_caught_by_its_pictures():
    with virtual_rig() as rig:
        found = checked(rig, c2=Behind(rig.c2))
    failed = {check.name: check.detail for check in found.failed}
    assert re.search(r"shows C2 (9|10)\d % of the way back", failed["frame age"])


def test_an_open_loop_axis_is_good_at_whole_steps_alone():
    with virtual_rig(axis=OPEN_LOOP, microstep_error=0.05, backlash_steps=5.0) as rig:
        found = checked(rig)
    assert found.failed == ()
    assert found.whole_steps
    # The amplitude is 5 % of 0.9 deg.
    assert found.u_reading_deg == pytest.approx(0.045 / math.sqrt(2), rel=0.1)
    assert found.u_alpha2_deg < 0.002
    assert found.backlash_steps == pytest.approx(5.0, abs=0.1)


def test_tremor_is_timed():
    with virtual_rig(ringing_ms=60.0) as rig:
        found = checked(rig)
    # exp(-t / 60 ms) takes a step of 1 mrad to 0.05 mrad in 180 ms.
    assert 0.05 < found.settle_s < 0.4
