"""The driver of video streams against a server of moving JPEG pictures."""

import time

import numpy as np
import pytest
from streams import MjpegServer

from calib.core.errors import InputError
from calib.rig.drivers import video as video_driver
from calib.rig.protocols import Lost, Refused


def stream(server, **keys):
    return video_driver.open_camera(
        {"driver": "video", "role": "c1", "address": server.address, **keys}
    )


def number(frame):
    """Return which frame of `MjpegServer` this is."""
    return round(float(np.median(frame.pixels)) / 4)


def test_video_a_stream_is_marked_and_measured_in_only_if_accepted():
    with MjpegServer() as server:
        camera = stream(server)
        assert "not for metrology: lossy" in camera.identity
        with pytest.raises(Refused, match='lossy = "accepted"'):
            camera.after(time.monotonic_ns(), timeout_s=1)
        camera.close()


def test_video_frames_after_a_pause_are_not_old():
    with MjpegServer() as server:
        camera = stream(server, lossy="accepted", latency_ms=500.0)
        for _ in range(2):
            time.sleep(1.0)
            moment = time.monotonic_ns()
            got = camera.after(moment, timeout_s=3)
            assert got.sure == "arrival"
            assert server.sent_ns[number(got)] > moment
            assert moment < got.exposed_ns <= server.sent_ns[number(got)]
        assert camera.latest() is not None
        camera.close()


def test_video_a_stream_that_ends_is_lost():
    with MjpegServer(frames=5) as server:
        camera = stream(server, lossy="accepted")
        with pytest.raises(Lost, match="has ended"):
            camera.after(time.monotonic_ns(), timeout_s=10)
        camera.close()


def test_video_a_wrong_section_is_named():
    with pytest.raises(InputError, match="needs device or address"):
        video_driver.open_camera({"driver": "video", "role": "c1"})
    with pytest.raises(Lost, match="does not open"):
        video_driver.open_camera({"driver": "video", "role": "c1", "device": 99})
    with MjpegServer() as server, pytest.raises(InputError, match="64 x 48, not 640 x 480"):
        stream(server, image_size=(640, 480))
