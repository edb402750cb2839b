"""The driver of GigE Vision cameras, by frames as cameras hand them out: late, torn, left over.

Against Aravis's server it is tried in `test_drivers` and `test_real_loop`.
"""

import time
from types import SimpleNamespace

import pytest
import telegenic

from calib.core.errors import InputError
from calib.rig.drivers import gige
from calib.rig.protocols import Lost


def frame(**changes):
    whole = {
        "is_complete": True,
        "status": telegenic.FrameStatus.Complete,
        "width": 4,
        "height": 2,
        "pixel_format": "Mono8",
        "timestamp_ns": 5_000_000_000,
        "timestamp_ticks": 5_000_000_000,
        "frame_id": 1,
        "data": lambda: bytes(8),
    }
    return SimpleNamespace(**(whole | changes))


class FakeGige:
    """Hands out frames one by one, each after a delay, s."""

    def __init__(self, answers):
        self.answers = list(answers)
        self.features = {"ExposureTime": 50_000.0}

    def device_info(self):
        return SimpleNamespace(manufacturer="M", model="T", serial="1")

    def has_feature(self, name):
        return name in self.features

    def get_float(self, name):
        return self.features[name]

    def snapshot_session(self, *, packet_size):
        assert packet_size == 1400
        return self

    def snap(self, timeout_s):
        if not self.answers:
            time.sleep(timeout_s)
            raise telegenic.GenicamError("timeout")
        delay, answer = self.answers.pop(0)
        time.sleep(delay)
        return answer


def gige_camera(*answers):
    return gige.GigeCamera(FakeGige(answers), gige.GigeOptions(address="127.0.0.1"), (4, 2))


@pytest.mark.parametrize(
    ("delay", "bad", "reason"),
    [
        (0.0007, {}, "sooner than its exposure"),
        (0.06, {"is_complete": False, "status": "MissingPackets"}, "incomplete"),
        (0.06, {"width": 3}, "3 x 2 Mono8"),
        (0.06, {"pixel_format": "Mono12"}, "Mono12"),
    ],
)
def test_gige_a_frame_left_over_or_not_whole_is_passed_over(delay, bad, reason):
    good = frame(frame_id=9, timestamp_ns=100_000_000_000)
    camera = gige_camera((delay, frame(**bad)), (0.06, good))
    assert camera.after(time.monotonic_ns(), timeout_s=20).serial == 9
    with pytest.raises(Lost, match=reason):
        gige_camera(*[(delay, frame(**bad))] * 1000).after(time.monotonic_ns(), timeout_s=0.1)


def test_gige_a_frame_whose_clock_did_not_go_on_is_left_over():
    first, stale = frame(), frame(frame_id=2, timestamp_ns=5_060_000_000)
    good = frame(frame_id=3, timestamp_ns=100_000_000_000)
    camera = gige_camera((0.06, first), (0.06, stale), (0.06, good))
    assert camera.after(time.monotonic_ns(), timeout_s=20).serial == 1
    time.sleep(0.3)
    assert camera.after(time.monotonic_ns(), timeout_s=20).serial == 3


class FakeTriggered(FakeGige):
    """Answers each software trigger after a delay, s; None stands for a frame that is lost."""

    def __init__(self, delays):
        super().__init__(())
        self.features |= {"TriggerMode": 0, "TriggerSoftware": 0}
        self.enums, self.delays, self.queue, self.triggers = {}, list(delays), [], 0

    def set_enum(self, name, entry):
        self.enums[name] = entry

    def get_enum(self, name):
        return self.enums[name]

    def start_acquisition(self, *, packet_size):
        assert packet_size == 1400
        return self

    def execute(self, name):
        assert name == "TriggerSoftware"
        self.triggers += 1
        delay = self.delays.pop(0)
        if delay is not None:
            stamp = time.monotonic_ns()
            answer = frame(frame_id=self.triggers, timestamp_ns=stamp)
            self.queue.append((time.monotonic() + delay, answer))

    def wait_for(self, timeout_s):
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if self.queue and self.queue[0][0] <= time.monotonic():
                return self.queue.pop(0)[1]
            time.sleep(0.002)
        return None


def triggered(monkeypatch, *delays):
    monkeypatch.setattr(gige, "ATTEMPT_S", 0.3)
    device = FakeTriggered(delays)
    options = gige.GigeOptions(address="127.0.0.1")
    return device, gige.GigeCamera(device, options, (4, 2))


def test_gige_each_trigger_is_answered_by_its_own_frame(monkeypatch):
    device, camera = triggered(monkeypatch, 0.06, 0.06, None, 0.06)
    assert device.enums["TriggerSource"] == "Software"
    for expected in (1, 2, 4):
        moment = time.monotonic_ns()
        got = camera.after(moment, timeout_s=30)
        assert got.exposed_ns > moment
        assert (got.serial, got.sure) == (expected, "trigger")


def test_gige_the_late_answer_to_a_former_trigger_is_taken_off(monkeypatch):
    # The first frame comes after its attempt was given up.
    _, camera = triggered(monkeypatch, 0.4, 0.06)
    assert camera.after(time.monotonic_ns(), timeout_s=30).serial == 2


def test_gige_a_camera_that_is_not_there_is_lost():
    with pytest.raises(Lost, match="does not answer"):
        gige.open_camera({"driver": "gige", "role": "c1", "address": "127.0.0.9"})


def test_gige_a_wrong_section_is_named():
    with pytest.raises(InputError, match=r"\[cameras.c2\] adress: is no key .*did you mean"):
        gige.open_camera({"driver": "gige", "role": "c2", "adress": "127.0.0.9"})
