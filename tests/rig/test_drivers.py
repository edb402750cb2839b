"""What drivers have in common, and two of them together in a network namespace.

Evidence: independent tools, Aravis's camera server and libximc's virtual controller. Pixels come
from the virtual world; nothing but frames and step counts crosses to the drivers. The loop over
both is in `test_real_loop`.
"""

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from aravis import namespace

from calib.rig.drivers import gige
from calib.rig.drivers import video as video_driver
from calib.rig.drivers import ximc as ximc_driver
from calib.rig.registry import axis_driver, camera_driver


def test_gige_and_ximc_give_frames_of_after_the_standstill(record_property):
    output = namespace(record_property, Path(__file__).parent / "real_drivers.py", "3")
    if output is None:
        return  # the summary says so; an error where CI=true
    seen = json.loads(output)
    assert seen["identities"][0] == "Aravis Fake CALIB-c1"
    assert seen["identities"][2].startswith("ximc")
    assert seen["sizes"] == [[640, 480], [640, 480]]
    for frame in seen["frames"]:
        assert frame["late_ms"] > 0
        assert frame["sure"] == "trigger"
        # Two pictures of one scene differ by their noise, sqrt(2) 1.5 sqrt(2 / pi).
        assert frame["off"] < 1.9
        assert abs(frame["reading_off"]) < 1e-12
    assert seen["negative"] == [-16, -17 * 16, -801 * 16]
    assert seen["back"] == -801 * 16
    assert seen["stopped"]["error"] == "Interrupted"
    assert math.radians(60) < seen["stopped"]["reading"] < math.radians(120)
    assert seen["shown"]


def test_drivers_are_found_by_name():
    assert camera_driver("gige", where="w") is gige.open_camera
    assert camera_driver("video", where="w") is video_driver.open_camera
    assert axis_driver("ximc", where="w") is ximc_driver.open_axis


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_motor_before_anything_else(number, tmp_path):
    script = Path(__file__).parent / "signalled.py"
    with subprocess.Popen(
        [sys.executable, str(script), f"xi-emu://{tmp_path}/yaw.bin"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as program:
        assert program.stdout.readline() == "moving\n"
        program.send_signal(number)
        said = program.stdout.read().split("\n")
    assert program.returncode != 0
    assert said[0] == "stop"
    assert "KeyboardInterrupt" in said
    rests = next(float(line.split()[1]) for line in said if line.startswith("rests"))
    assert 90 < rests < 134
    assert said.index("stop") < said.index("files")
