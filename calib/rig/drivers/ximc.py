"""Standa's 8SMC4 and 8SMC5 controllers, by libximc: the driver "ximc", extra `ximc`.

Positions are full steps and microsteps with one sign; a negative position has both negative. What
was reached is read back, never taken from the command. Limit switches and speeds are the
controller's own, set once with the maker's program and left alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any, Final

import libximc.highlevel as ximc

from calib.core.errors import InputError
from calib.dataset.fields import Line, Number, Positive
from calib.rig.clock import Clock, HostClock, wait
from calib.rig.options import Options, options
from calib.rig.protocols import Interrupted, Lost, YawAxis
from calib.rig.settings import AxisSection
from calib.rig.stepped import AxisScale, State, SteppedAxis

HOME_TIMEOUT_S: Final = 120.0
POLL_S: Final = 0.01

HOME_WORD: Final = 6
"""Word of the controller's user memory that keeps the time of the last reference run, s."""


class XimcOptions(Options):
    """Keys of the driver.

    Parameters
    ----------
    device
        As libximc names it: ``xi-com:/dev/ximc/00000123``, ``xi-net://host/serial``,
        ``xi-emu:///path`` for its virtual controller.
    zero_deg
        Reading at position 0 of the controller, degrees.
    overshoot_steps
        Steps beyond a target from which it is approached, more than the backlash.
    """

    device: Line
    zero_deg: Number = 90.0
    overshoot_steps: Positive = 8.0


class XimcController:
    """The controller of one axis.

    Parameters
    ----------
    axis
        Open device.
    steps_per_full
        Steps of `AxisScale.step_rad` in a full step of the motor.
    clock
        Waits go by it.
    has_encoder
        Whether the encoder is read.
    """

    def __init__(
        self, axis: ximc.Axis, *, steps_per_full: float, clock: Clock, has_encoder: bool
    ) -> None:
        self._axis = axis
        self._steps_per_full = steps_per_full
        self._clock = clock
        self._has_encoder = has_encoder
        self.divisions = 2 ** (int(self._ask("get_engine_settings").MicrostepMode) - 1)

    def start(self, steps: float) -> None:
        """Begin to move to a position."""
        micro = round(steps / self._steps_per_full * self.divisions)
        whole = int(math.copysign(abs(micro) // self.divisions, micro))
        self._ask("command_move", whole, micro - whole * self.divisions)

    def state(self) -> State:
        """Ask for the position."""
        status = self._ask("get_status")
        if status.Flags & ximc.StateFlags.STATE_ALARM:
            raise Lost(f"the controller is in alarm ({_names(status.Flags)}); see its own program")
        running = bool(status.MvCmdSts & ximc.MvcmdStatus.MVCMD_RUNNING)
        full = status.CurPosition + status.uCurPosition / self.divisions
        return State(
            steps=full * self._steps_per_full,
            counts=status.EncPosition if self._has_encoder else None,
            moving=running or bool(status.MoveSts & ximc.MoveState.MOVE_STATE_MOVING),
        )

    def stop(self) -> None:
        """Stop by the shortest ramp at which no step is lost."""
        self._ask("command_sstp")

    def home(self) -> str:
        """Find the reference mark as the controller is set up to, and call it 0."""
        self._ask("command_home")
        deadline = time.monotonic() + HOME_TIMEOUT_S
        while self.state().moving:
            if time.monotonic() > deadline:
                raise Lost(f"no reference mark was found within {HOME_TIMEOUT_S:g} s")
            wait(self._clock, POLL_S)
        if int(self._ask("get_status").MvCmdSts) & int(ximc.MvcmdStatus.MVCMD_ERROR):
            raise Interrupted("the reference run failed; look at limit switches and home settings")
        self._ask("command_zero")
        memory = self._ask("get_nonvolatile_memory")
        words = list(memory.UserData)
        words[HOME_WORD] = int(time.time()) & 0xFFFFFFFF
        memory.UserData = words
        self._ask("set_nonvolatile_memory", memory)
        return self.home_name()

    def home_name(self) -> str:
        """Return what identifies the reference run in force."""
        serial = self._ask("get_serial_number")
        when = self._ask("get_nonvolatile_memory").UserData[HOME_WORD]
        return f"ximc {serial:08X}, homed {when}" if when else f"ximc {serial:08X}, never homed"

    def close(self) -> None:
        """Let go of the device."""
        self._axis.close_device()

    def _ask(self, name: str, *arguments: Any) -> Any:
        """Call the library; whatever it raises, the device is lost."""
        try:
            return getattr(self._axis, name)(*arguments)
        except (RuntimeError, ConnectionError, ValueError, NotImplementedError) as error:
            first = str(error).strip().splitlines()[0]
            raise Lost(f"the controller at {self._axis.uri} does not answer: {first}") from error


def _names(flags: Any) -> str:
    bits = int(flags)
    single = (f for f in ximc.StateFlags if int(f).bit_count() == 1)
    return ", ".join(str(f.name) for f in single if int(f) & bits)


def open_axis(settings: Mapping[str, Any]) -> YawAxis:
    """Open the axis; the driver "ximc".

    Raises
    ------
    InputError
        If its section has a wrong key or does not fit the controller.
    Lost
        If it does not answer.
    """
    own = options(XimcOptions, settings)
    section = AxisSection.model_validate(
        {key: value for key, value in settings.items() if key in AxisSection.model_fields}
    )
    if section.full_step_deg is None:
        raise InputError.single(
            where="rig.toml, [axis] full_step_deg",
            what="is missing; the driver 'ximc' needs it",
            remedy="give C2's turn for one full step of the motor, gears included, in degrees",
        )
    axis = ximc.Axis(own.device)
    try:
        axis.open_device()
    except (ConnectionError, RuntimeError, TypeError) as error:
        raise Lost(
            f"rig.toml, [axis] device: {own.device} does not open; look at power, cable, rights on "
            "the device file, and whether another program holds it"
        ) from error
    try:
        return _stepped(axis, own, section, settings)
    except BaseException:
        axis.close_device()
        raise


def _stepped(
    axis: ximc.Axis, own: XimcOptions, section: AxisSection, settings: Mapping[str, Any]
) -> SteppedAxis:
    step = section.step_deg or section.resolution_deg
    per_full = float(section.full_step_deg or step) / step
    clock = settings.get("clock") or HostClock()
    controller = XimcController(
        axis,
        steps_per_full=per_full,
        clock=clock,
        has_encoder=section.reads != "counts",
    )
    _check(axis, controller, section, per_full)
    low, high = section.range_deg
    scale = AxisScale(
        identity=f"ximc {axis.get_serial_number():08X}",
        source=section.reads,
        step_rad=math.radians(step),
        count_rad=math.radians(section.resolution_deg),
        counts_per_step=round(controller.divisions / per_full),
        zero_rad=math.radians(own.zero_deg),
        range_rad=(math.radians(low), math.radians(high)),
        overshoot_steps=own.overshoot_steps,
    )
    return SteppedAxis(controller, scale, clock, controller.home_name())


def _check(
    axis: ximc.Axis, controller: XimcController, section: AxisSection, per_full: float
) -> None:
    """Hold what rig.toml says against how the controller is set up."""
    if abs(controller.divisions / per_full - round(controller.divisions / per_full)) > 1e-6:
        raise InputError.single(
            where="rig.toml, [axis] step_deg",
            what=f"the controller divides a full step into {controller.divisions}, of which "
            f"{per_full:g} steps are no whole parts",
            remedy="give full_step_deg divided by a power of two, or set another microstep mode",
        )
    engine = axis.get_engine_settings()
    if engine.EngineFlags & ximc.EngineFlags.ENGINE_ANTIPLAY:
        raise InputError.single(
            where="rig.toml, [axis]",
            what="the controller takes up backlash by itself (ENGINE_ANTIPLAY), from one side only",
            remedy="switch it off in the maker's program; overshoot_steps does it here",
        )
    feedback = axis.get_feedback_settings().FeedbackType
    if section.reads != "counts" and feedback == ximc.FeedbackType.FEEDBACK_NONE:
        raise InputError.single(
            where="rig.toml, [axis] reads",
            what=f"says {section.reads!r}, but the controller is set up without an encoder",
            remedy='write reads = "counts", or set the feedback in the maker\'s program',
        )
