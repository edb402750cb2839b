"""The devices of a rig, opened by the drivers that rig.toml names.

    with open_rig(read_settings(None)) as rig:          # None: the embedded virtual rig
        standing = rig.axis.move(math.pi / 2)
        frame = rig.c2.after(standing.since_ns, timeout_s=2.0)

Wait and ask for the time by `rig.clock` only: with ``[virtual] time = "simulated"`` time passes
when it is waited for. Where a device is virtual, `rig.world` is the world it stands in; put targets
before it through `calib.rig.virtual.operator.Operator`.
"""

from __future__ import annotations

import fcntl
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Final

from calib.core.errors import UsageError
from calib.rig import foreign
from calib.rig.clock import Clock, HostClock, SimulatedClock
from calib.rig.protocols import Camera, YawAxis
from calib.rig.registry import AXES, CAMERAS, axis_driver, camera_driver, is_foreign
from calib.rig.settings import AxisSection, CameraSection, RigSettings
from calib.rig.virtual.world import World

VIRTUAL: Final = "virtual"

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, a service that is stopped, a terminal that is closed."""


@dataclass(frozen=True)
class RigDevices:
    """The open devices.

    Parameters
    ----------
    settings
        What they were opened with.
    c1, c2, axis
        The devices.
    clock
        That all of them go by.
    world
        Of virtual devices; None where all are real.
    """

    settings: RigSettings
    c1: Camera
    c2: Camera
    axis: YawAxis
    clock: Clock
    world: World | None

    @property
    def serial(self) -> str:
        """Name of the rig."""
        return self.settings.serial


@contextmanager
def open_rig(settings: RigSettings) -> Iterator[RigDevices]:
    """Open the devices of a rig; they are closed on leaving, the axis first.

    Raises
    ------
    CalibError
        If a driver is unknown or its device does not answer.
    """
    is_virtual = any(section.driver == VIRTUAL for section in settings.devices.values())
    is_real = any(section.driver != VIRTUAL for section in settings.devices.values())
    is_fast = settings.virtual.time == "simulated" and not is_real
    clock: Clock = SimulatedClock() if is_fast else HostClock()
    world = World(settings, clock) if is_virtual else None
    with ExitStack() as opened:
        cameras: list[Camera] = []
        sections = (("c1", settings.cameras.c1), ("c2", settings.cameras.c2))
        for role, section in sections:
            driver = camera_driver(section.driver, where=f"rig.toml, [cameras.{role}] driver")
            handed = _handed(section, role, settings, clock, world)
            camera = (
                foreign.open_camera(driver, handed, f"cameras.{role}")
                if is_foreign(CAMERAS, section.driver)
                else driver(handed)
            )
            opened.callback(camera.close)
            cameras.append(camera)
        opener = axis_driver(settings.axis.driver, where="rig.toml, [axis] driver")
        handed = _handed(settings.axis, "axis", settings, clock, world)
        axis = (
            foreign.open_axis(opener, handed, "axis")
            if is_foreign(AXES, settings.axis.driver)
            else opener(handed)
        )
        opened.callback(axis.close)
        opened.enter_context(stopping(axis))
        yield RigDevices(settings, cameras[0], cameras[1], axis, clock, world)


@contextmanager
def alone(rig_file: Path | None, settings: RigSettings) -> Iterator[None]:
    """Keep other programs that go by the same rig.toml off its axis meanwhile.

    Two that turn one motor spoil each other's rows. A virtual axis is each program's own.

    Raises
    ------
    UsageError
        If another program drives the rig.
    """
    if rig_file is None or settings.axis.driver == VIRTUAL:
        yield
        return
    with rig_file.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(
                f"{rig_file}: another program drives this rig; end it, or wait for it"
            ) from None
        except OSError:
            pass  # a file system without locks: whoever shares it must take care
        yield


@contextmanager
def stopping(axis: YawAxis) -> Iterator[None]:
    """Let the signals that end a program stop the motor before anything else happens.

    What they did before they do afterwards; one that killed the program interrupts it instead, so
    that devices are closed and files whole. Outside the main thread nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = {each: signal.getsignal(each) for each in SIGNALS}

    def stop_first(number: int, at: FrameType | None) -> None:
        with suppress(Exception):  # the signal's own end comes all the same
            axis.stop()
        then = former[signal.Signals(number)]
        if callable(then):
            then(number, at)
        elif then is not signal.SIG_IGN:
            raise KeyboardInterrupt

    try:
        for each in SIGNALS:
            signal.signal(each, stop_first)
        yield
    finally:
        for each, handler in former.items():
            signal.signal(each, handler)


def _handed(
    section: CameraSection | AxisSection,
    role: str,
    settings: RigSettings,
    clock: Clock,
    world: World | None,
) -> Mapping[str, Any]:
    """Return what a driver is given: its section, its place in the rig and the rig's clock."""
    handed = {**section.model_dump(), "role": role, "serial": settings.serial, "clock": clock}
    return handed | ({"world": world} if section.driver == VIRTUAL else {})
