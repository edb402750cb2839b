"""The drivers that docs/drivers.md shows, run as a lab's own package would.

Evidence: property.
"""

import re
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from calib.rig import registry
from calib.rig.devices import open_rig
from calib.rig.options import Options, options
from calib.rig.protocols import Camera, Lost, YawAxis
from calib.rig.settings import parse_settings

PAGE = (Path(__file__).parents[2] / "docs" / "drivers.md").read_text()
PYTHON = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
TOML = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)

RIG = """
format = 1
serial = "lab-1"
[cameras.c1]
driver = "ourcam"
image_size = [8, 4]
address = "a"
exposure_us = 2000
[cameras.c2]
driver = "ourcam"
image_size = [8, 4]
address = "b"
exposure_us = 2000
[axis]
driver = "ourmotor"
port = "/dev/x"
reads = "load encoder"
resolution_deg = 0.01
step_deg = 0.05
"""


PROMISED = (
    "identity", "image_size", "after", "latest", "resolution_rad", "step_rad", "range_rad",
    "move", "standstill", "home",
)  # fmt: skip
"""What cameras and axes have beside `close` and `stop`."""


class Device:
    """A camera of the maker's library; its first answer was left over in a queue."""

    model, serial, number = "X", "7", 0

    def __init__(self, address, exposure_us):
        self.address, self.exposure_ns = address, round(1000 * exposure_us)
        self.open = True

    def drain(self):
        pass

    def trigger(self, _):
        if self.number:
            time.sleep(self.exposure_ns / 1e9)
        self.number += 1
        return np.full((4, 8), self.number)

    def close(self):
        self.open = False


class Motor:
    """A motor that is where it is sent at once."""

    serial, busy, position = "9", False, 0

    def __init__(self, port):
        self.port = port

    @property
    def encoder(self):
        return 5 * self.position

    def go(self, steps):
        self.position = steps

    def find_mark(self):
        self.position = 0
        return 1

    def halt(self):
        pass

    def close(self):
        pass


@pytest.fixture
def lab(monkeypatch):
    sdk = ModuleType("labsdk")
    sdk.Camera, sdk.Motor = Device, Motor
    monkeypatch.setitem(sys.modules, "labsdk", sdk)
    points = []
    for group, name, code, opener in (
        (registry.CAMERAS, "ourcam", PYTHON[0], "open_camera"),
        (registry.AXES, "ourmotor", PYTHON[1], "open_axis"),
    ):
        module = ModuleType(f"our_lab_{name}")
        exec(code, module.__dict__)  # noqa: S102 - the page's own code
        monkeypatch.setitem(sys.modules, module.__name__, module)
        points.append(EntryPoint(name, f"{module.__name__}:{opener}", group))
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [p for p in points if p.group == group]
    )


@pytest.mark.usefixtures("lab")
def test_a_labs_own_drivers_make_up_a_rig():
    with open_rig(parse_settings(RIG.encode())) as rig:
        assert isinstance(rig.c1, Camera)
        assert isinstance(rig.axis, YawAxis)
        assert rig.world is None
        standing = rig.axis.move(1.6)
        assert abs(standing.reading_rad - 1.6) < np.deg2rad(0.05)
        frame = rig.c2.after(standing.since_ns, timeout_s=2)
        assert frame.exposed_ns > standing.since_ns
        assert frame.serial == 2, "the picture left over is passed over"
        assert rig.axis.home().home == "9, 1"
        device = rig.c2.camera.device
    assert not device.open


@pytest.mark.usefixtures("lab")
def test_a_camera_that_sends_nothing_is_lost(monkeypatch):
    monkeypatch.setattr(Device, "trigger", lambda *_: None)
    with open_rig(parse_settings(RIG.encode())) as rig, pytest.raises(Lost):
        rig.c1.after(0, timeout_s=0.05)


def test_the_page_s_rig_toml_is_one_that_the_drivers_take():
    from calib.rig.drivers.gige import GigeOptions
    from calib.rig.drivers.video import VideoOptions
    from calib.rig.drivers.ximc import XimcOptions

    parsed = parse_settings(TOML[0].encode())
    for role, section, model in (
        ("c1", parsed.cameras.c1, GigeOptions),
        ("c2", parsed.cameras.c2, VideoOptions),
        ("axis", parsed.axis, XimcOptions),
    ):
        assert options(model, section.model_dump() | {"role": role})


def test_the_page_names_every_fault():
    from calib.rig.virtual.settings import Faults

    for name in Faults.model_fields:
        assert f"`{name}`" in PAGE


def test_devices_are_closed_and_the_motor_stopped_whatever_fails(monkeypatch):
    closed = []

    def opener(name, *, fails=False):
        def open_it(_settings):
            if fails:
                raise Lost("no answer")
            return SimpleNamespace(
                **dict.fromkeys(PROMISED, print),
                close=lambda: closed.append(name),
                stop=lambda: closed.append("stop"),
            )

        return open_it

    monkeypatch.setattr("calib.rig.devices.camera_driver", lambda *_, **__: opener("camera"))
    monkeypatch.setattr("calib.rig.devices.axis_driver", lambda *_, **__: opener("axis"))
    settings = parse_settings(RIG.encode())
    with pytest.raises(ZeroDivisionError), open_rig(settings):
        raise ZeroDivisionError
    assert closed == ["axis", "camera", "camera"]
    closed.clear()
    monkeypatch.setattr("calib.rig.devices.axis_driver", lambda *_, **__: opener("a", fails=True))
    with pytest.raises(Lost), open_rig(settings):
        pass
    assert closed == ["camera", "camera"]


def test_options_are_checked_key_by_key():
    class Own(Options):
        address: str

    from calib.core.errors import InputError

    with pytest.raises(InputError, match=r"\[cameras.c1\] address: is missing"):
        options(Own, {"role": "c1", "driver": "own"})
