"""Pictures to look at: made only while somebody asks, one for each time.

Evidence: property.
"""

from __future__ import annotations

import threading
from contextlib import contextmanager

import numpy as np

from calib.live import streams
from calib.live.streams import Stream
from calib.rig.clock import HostClock
from calib.rig.protocols import Frame, Lost


class Camera:
    """A camera that hands out a new frame each time, or the same one, or none."""

    def __init__(self, *, is_frozen=False):
        self.is_frozen = is_frozen
        self.is_lost = False
        self.taken = 0
        self.may_answer = threading.Event()
        self.may_answer.set()

    def latest(self):
        assert self.may_answer.wait(10)
        if self.is_lost:
            raise Lost("the cable is off")
        self.taken += 1
        serial = 1 if self.is_frozen else self.taken
        return Frame(np.zeros((48, 64), np.uint8), self.taken, "arrival", serial)


@contextmanager
def stream_of(camera, told=lambda _: None):
    stream = Stream(camera, HostClock(), lambda: (), lambda: 31.5, told)
    came = threading.Semaphore(0)
    stream.listen(came.release)
    stream.start()
    try:
        yield stream, came
    finally:
        camera.may_answer.set()
        stream.close()
        assert not stream._thread.is_alive()


def test_a_picture_is_made_for_each_time_that_is_asked_and_no_other():
    camera = Camera()
    with stream_of(camera) as (stream, came):
        for number in range(1, 4):
            stream.ask()
            assert came.acquire(timeout=10)
            assert stream.shown.number == number
        threading.Event().wait(3 * streams.INTERVAL_S)
        assert camera.taken == 3
        assert (stream.shown.size, stream.shown.centre_px) == ((64, 48), 31.5)


def test_a_slow_picture_does_not_lose_what_is_asked_meanwhile(monkeypatch):
    monkeypatch.setattr(streams, "IDLE_S", 0.05)
    camera = Camera()
    with stream_of(camera) as (stream, came):
        camera.may_answer.clear()
        stream.ask()
        threading.Event().wait(0.2)
        stream.ask()
        camera.may_answer.set()
        assert came.acquire(timeout=10)
        assert came.acquire(timeout=10)


def test_a_camera_that_has_nothing_new_is_left_alone_when_nobody_asks(monkeypatch):
    monkeypatch.setattr(streams, "IDLE_S", 0.3)
    monkeypatch.setattr(streams, "SAME_S", 0.02)
    camera = Camera(is_frozen=True)
    with stream_of(camera) as (stream, came):
        stream.ask()
        assert came.acquire(timeout=10)
        stream.ask()
        threading.Event().wait(1.0)
        taken = camera.taken
        threading.Event().wait(0.3)
        assert camera.taken == taken > 2
        camera.is_frozen = False
        stream.ask()
        assert came.acquire(timeout=10)


def test_a_camera_that_is_lost_is_told_and_so_is_its_return(monkeypatch):
    monkeypatch.setattr(streams, "SAME_S", 0.02)
    camera, heard = Camera(), []
    camera.is_lost = True
    with stream_of(camera, heard.append) as (stream, came):
        stream.ask()
        threading.Event().wait(0.2)
        assert set(heard) == {"the cable is off"}
        camera.is_lost = False
        assert came.acquire(timeout=10)
        assert heard[-1] == ""
