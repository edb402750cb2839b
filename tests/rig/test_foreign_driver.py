"""A lab's own drivers that break their promises: no row comes of it, and the motor is stopped.

Evidence: negative control.
"""

from __future__ import annotations

import math
import signal
import time
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest

from calib.cli.main import main
from calib.core.errors import InputError, UsageError
from calib.rig import registry
from calib.rig.clock import HostClock
from calib.rig.devices import open_rig, stopping
from calib.rig.protocols import Frame, Lost, Stalled, Standstill
from calib.rig.settings import parse_settings
from tests.rig.checked_rig import RIG

OWN = RIG.replace('driver = "virtual"', 'driver = "ours"').replace('time = "simulated"\n', "")


class Camera:
    identity, image_size = "ours", (8, 4)

    def __init__(self, late_ns=0, pixels=None):
        self.late_ns = late_ns
        self.pixels = np.zeros((4, 8), np.uint8) if pixels is None else pixels

    def after(self, moment, *, timeout_s):
        if timeout_s < 0:
            raise RuntimeError("USB\nbroke")
        time.sleep(max(0, moment - time.monotonic_ns()) / 1e9)
        return Frame(self.pixels, moment + self.late_ns, "trigger", 1)

    def latest(self):
        return None

    def close(self):
        pass


class Axis:
    identity, resolution_rad, step_rad, range_rad = "ours", 1e-3, 1e-3, (0.5, 2.5)

    def __init__(self, error=None, stop_error=None):
        self.error, self.stop_error, self.turns = error, stop_error, False

    def move(self, reading_rad, *, approach=1):
        self.turns = True
        if self.error:
            raise self.error
        self.turns = False
        return Standstill(reading_rad, 0, "load encoder", 0, approach or 1, "h")

    def standstill(self):
        return Standstill(math.pi / 2, 0, "load encoder", 0, 1, "h")

    def home(self):
        return self.move(0.0)

    def stop(self):
        self.turns = False
        if self.stop_error:
            raise self.stop_error

    def close(self):
        self.turns = False


@pytest.fixture
def ours(monkeypatch):
    """Return a function that takes what the two drivers open and returns an open rig."""

    def opened(camera=lambda _: Camera(), axis=lambda _: Axis()):
        monkeypatch.setattr(
            EntryPoint, "load", lambda point: camera if point.group == registry.CAMERAS else axis
        )
        monkeypatch.setattr(
            registry, "entry_points", lambda group: (EntryPoint("ours", "our:opener", group),)
        )
        return open_rig(parse_settings(OWN.encode()))

    return opened


@pytest.mark.parametrize(
    ("camera", "why"),
    [
        (Camera(late_ns=-40_000_000), "40 ms before the moment asked for"),
        (Camera(late_ns=10**15), "in the future; exposed_ns has to be of this computer's"),
        (Camera(pixels=np.zeros((2, 4), np.uint8)), "a picture of 4 x 2, not 8 x 4 px"),
        (Camera(pixels=np.zeros((4, 8, 3), np.uint8)), "a picture of 8 x 4 x 3, not 8 x 4 px"),
        (Camera(pixels=np.zeros((4, 8), np.uint16)), "a picture of uint16, not"),
    ],
)
def test_a_frame_that_cannot_be_right_is_none(ours, camera, why):
    with ours(lambda _: camera) as rig, pytest.raises(Lost, match=why):
        rig.c1.after(rig.clock.now_ns(), timeout_s=1)


def test_a_size_that_changes_later_is_noticed(ours):
    camera = Camera()
    with ours(lambda _: camera) as rig:
        assert rig.c1.after(HostClock().now_ns(), timeout_s=1).pixels.shape == (4, 8)
        camera.image_size, camera.pixels = (4, 2), np.zeros((2, 4), np.uint8)
        with pytest.raises(Lost, match=r"\[cameras.c1\] driver 'ours': handed out a picture"):
            rig.c1.after(HostClock().now_ns(), timeout_s=1)


@pytest.mark.parametrize("error", [Stalled("stuck"), RuntimeError("stuck"), KeyboardInterrupt()])
@pytest.mark.parametrize("stop_error", [None, RuntimeError("cannot")])
def test_a_move_that_ends_by_an_error_stops_the_motor(ours, error, stop_error):
    axis = Axis(error, stop_error)
    told = Lost if isinstance(error, RuntimeError) else type(error)
    with ours(axis=lambda _: axis) as rig:
        with pytest.raises(told, match="stuck" if str(error) else None):
            rig.axis.move(1.0)
        assert not axis.turns


def test_what_a_library_raises_is_a_device_that_is_lost(ours):
    with ours() as rig, pytest.raises(Lost, match=r"\[cameras.c1\] driver 'ours': Runtime.* USB b"):
        rig.c1.after(0, timeout_s=-1)


def test_a_signal_is_not_lost_though_the_motor_does_not_answer():
    axis = Axis(stop_error=RuntimeError("cannot"))
    with pytest.raises(KeyboardInterrupt), stopping(axis):
        signal.raise_signal(signal.SIGINT)


def test_an_opener_that_misses_a_key_says_which(ours):
    with pytest.raises(InputError, match=r"\[cameras.c1\] driver 'ours': address is missing"):
        ours(lambda handed: handed["address"]).__enter__()
    with pytest.raises(UsageError, match="opens a dict, which is no YawAxis"):
        ours(axis=lambda _: {}).__enter__()


def test_what_is_opened_and_refused_is_stopped_and_closed(ours):
    ended = []
    half = SimpleNamespace(stop=lambda: ended.append("stop"), close=lambda: ended.append("close"))
    with pytest.raises(UsageError, match="which is no YawAxis"):
        ours(axis=lambda _: half).__enter__()
    assert ended == ["stop", "close"]


def test_a_command_tells_what_ended_it_not_that_the_motor_cannot_stop(ours, tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(OWN + "[board]\n" + BOARD)
    ours(axis=lambda _: Axis(Stalled("blocked at the door"), Lost("cannot stop")))
    assert main(["rig", "check", str(tmp_path / "rig.toml")]) == 3
    assert "blocked at the door" in capsys.readouterr().err


BOARD = 'type = "chessboard"\ncolumns = 9\nrows = 7\nsquare_mm = 40.0\n'
