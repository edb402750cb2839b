"""The driver of libximc against the vendor's virtual controller.

Evidence: an independent tool; a stand-in for what it lacks, an encoder and alarms.
"""

import math
import threading
import time
from types import SimpleNamespace

import libximc.highlevel as ximc
import pytest

from calib.core.errors import InputError
from calib.rig.clock import HostClock
from calib.rig.drivers import ximc as ximc_driver
from calib.rig.protocols import Interrupted, Lost, Refused, Stalled

STEP = math.radians(0.05625)


AXIS = {
    "driver": "ximc",
    "role": "axis",
    "reads": "counts",
    "resolution_deg": 0.05625,
    "full_step_deg": 0.9,
    "range_deg": (40.0, 140.0),
}


@pytest.fixture
def axis(tmp_path):
    opened = ximc_driver.open_axis(AXIS | {"device": f"xi-emu://{tmp_path}/yaw.bin"})
    yield opened
    opened.close()


def slow(axis, speed):
    """Let the virtual motor turn at so many full steps a second."""
    device = axis._controller._axis
    settings = device.get_move_settings()
    settings.Speed = speed
    device.set_move_settings(settings)


def test_ximc_goes_to_whole_steps_and_reads_them_back(axis):
    for steps in (1, -1, 17, -17, -201, 800, 0):
        standing = axis.move(math.pi / 2 + steps * STEP)
        assert standing.counts == 16 * steps
        assert standing.reading_rad == pytest.approx(math.pi / 2 + steps * STEP, abs=1e-12)
        assert standing.source == "counts"
        position = axis._controller._axis.get_position()
        assert position.Position * position.uPosition >= 0
    assert standing.since_ns <= time.monotonic_ns()


def test_ximc_approaches_from_the_asked_side(axis):
    axis.move(math.radians(95))
    commanded = []
    real = axis._controller.start
    axis._controller.start = lambda steps: (commanded.append(steps), real(steps))
    below = axis.move(math.radians(94), approach=1)
    above = axis.move(math.radians(94), approach=-1)
    assert (below.approached, above.approached) == (1, -1)
    goal = round(math.radians(4) / STEP)
    assert commanded == [goal - 8, goal, goal + 8, goal]


def test_ximc_stops_from_another_thread_and_stands_where_it_says(axis):
    slow(axis, 50)
    threading.Timer(0.2, axis.stop).start()
    with pytest.raises(Interrupted, match="stopped"):
        axis.move(math.radians(135))
    standing = axis.standstill()
    assert math.radians(90) < standing.reading_rad < math.radians(134)
    # And goes on from there.
    slow(axis, 1000)
    assert axis.move(math.radians(100)).reading_rad == pytest.approx(math.radians(100), abs=STEP)


def test_ximc_a_move_stopped_by_another_program_is_no_success(axis):
    slow(axis, 50)
    threading.Timer(0.2, axis._controller._axis.command_sstp).start()
    with pytest.raises(Interrupted, match="another hand"):
        axis.move(math.radians(135))


def test_ximc_stops_the_motor_before_any_error_leaves(axis):
    slow(axis, 50)

    class Broken(HostClock):
        def wait_until(self, _):
            raise KeyboardInterrupt

    axis._clock = Broken()
    axis._settled = lambda: ximc_rest(axis)
    with pytest.raises(KeyboardInterrupt):
        axis.move(math.radians(135))
    time.sleep(0.2)
    assert not axis._controller.state().moving
    assert axis._controller.state().steps < 40


def ximc_rest(axis):
    """Return the axis at rest without waiting."""
    state = axis._controller.state()
    return SimpleNamespace(
        state=state, counts=round(16 * state.steps), reading_rad=math.pi / 2, since_ns=0
    )


def test_ximc_says_that_it_moves(axis):
    slow(axis, 50)
    axis._controller.start(500)
    with pytest.raises(Interrupted, match="moves"):
        axis.standstill()


def test_ximc_reference_runs_have_names_that_last(tmp_path):
    device = AXIS | {"device": f"xi-emu://{tmp_path}/yaw.bin"}
    first = ximc_driver.open_axis(device)
    before = first.standstill().home
    after = first.home()
    assert after.home != before
    assert after.counts == 0
    first.close()
    again = ximc_driver.open_axis(device)
    assert again.standstill().home == after.home
    again.close()


def test_ximc_out_of_range_is_refused(axis):
    with pytest.raises(Refused, match="outside its range"):
        axis.move(math.radians(20))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"devise": "x"}, "did you mean 'device'?"),
        ({"full_step_deg": None}, "needs it"),
        ({"step_deg": 0.07}, "no whole parts"),
        ({"reads": "load encoder"}, "without an encoder"),
        ({"zero_deg": "ninety"}, "is a text, not a number"),
    ],
)
def test_ximc_a_wrong_section_is_named(tmp_path, change, expected):
    section = AXIS | {"device": f"xi-emu://{tmp_path}/yaw.bin"} | change
    with pytest.raises(InputError, match=expected.replace("?", r"\?")):
        ximc_driver.open_axis(section)


def test_ximc_a_missing_device_is_lost():
    with pytest.raises(Lost, match="does not open"):
        ximc_driver.open_axis(AXIS | {"device": "xi-com:///dev/there-is-none"})


def test_ximc_a_controller_that_went_away_is_lost(tmp_path):
    axis = ximc_driver.open_axis(AXIS | {"device": f"xi-emu://{tmp_path}/yaw.bin"})
    axis._controller._axis.close_device()
    with pytest.raises(Lost, match="does not answer"):
        axis.standstill()


class FakeAxis:
    """Stands in for what the virtual controller lacks: an encoder, alarms."""

    uri = "fake"

    def __init__(self):
        self.steps, self.slip, self.flags = 0, 0, 0

    def get_engine_settings(self):
        return SimpleNamespace(MicrostepMode=9)

    def command_move(self, whole, micro):
        self.steps = 256 * whole + micro

    def get_status(self):
        whole = int(math.copysign(abs(self.steps) // 256, self.steps))
        return SimpleNamespace(
            CurPosition=whole,
            uCurPosition=self.steps - 256 * whole,
            EncPosition=round((self.steps - self.slip) * 0.9 / 256 / 0.009),
            MvCmdSts=ximc.MvcmdStatus.MVCMD_MOVE,
            MoveSts=ximc.MoveState(0),
            Flags=ximc.StateFlags(self.flags),
        )

    def command_sstp(self):
        pass


def fake_axis():
    device = FakeAxis()
    controller = ximc_driver.XimcController(
        device, steps_per_full=16, clock=HostClock(), has_encoder=True
    )
    scale = ximc_driver.AxisScale(
        identity="fake",
        source="load encoder",
        step_rad=STEP,
        count_rad=math.radians(0.009),
        zero_rad=math.pi / 2,
        range_rad=(0.7, 2.4),
    )
    return device, ximc_driver.SteppedAxis(controller, scale, HostClock(), "h")


def test_ximc_with_an_encoder_makes_up_for_slip():
    device, axis = fake_axis()
    device.slip = 64 * 16
    standing = axis.move(math.radians(100))
    assert standing.reading_rad == pytest.approx(math.radians(100), abs=1.5 * STEP)


def test_ximc_with_an_encoder_a_blocked_axis_has_stalled():
    device, axis = fake_axis()
    real = device.command_move

    def blocked(whole, micro):
        real(whole, micro)
        device.slip = device.steps

    device.command_move = blocked
    with pytest.raises(Stalled, match="steps from its command"):
        axis.move(math.radians(100))


def test_ximc_an_alarm_is_told_by_name():
    device, axis = fake_axis()
    device.flags = int(ximc.StateFlags.STATE_ALARM | ximc.StateFlags.STATE_OVERLOAD_POWER_CURRENT)
    with pytest.raises(Lost, match="STATE_OVERLOAD_POWER_CURRENT"):
        axis.standstill()
