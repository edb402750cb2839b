"""The virtual camera: frames as they would arrive from a device, and the driver that judges them.

A frame crosses over as pixels, the number of its first and last line's frame, a stamp of the
camera's own clock and the moment at which it arrived. When it was truly exposed stays behind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np

from calib.rig.clock import NS_PER_S, wait
from calib.rig.options import Options, options
from calib.rig.protocols import Camera, Frame, Lost, Nanoseconds
from calib.rig.virtual.world import CameraName, World
from calib.simulate.render import Image

READOUT_NS: Final = 5_000_000
"""From the end of the exposure to the arrival, at the least."""

ANSWER_S: Final = 0.0002
"""Time that a question to the camera takes, each way."""

DRIFT_BOUND: Final = 3e-4
"""No clock of a camera is further off its rate than 300 ppm; crystals are within 100."""


@dataclass(frozen=True)
class Packet:
    """A frame as it arrives.

    Parameters
    ----------
    first, last
        Numbers of the frames that the first and the last line belong to.
    stamp_ns
        Begin of the exposure by the camera's clock.
    arrival_ns
        Of its last line, by the host's clock.
    pixels
        The picture.
    """

    first: int
    last: int
    stamp_ns: int
    arrival_ns: Nanoseconds
    pixels: Callable[[], Image]


class VirtualSensor:
    """A free-running camera in the world: it exposes a frame every period, whoever looks."""

    def __init__(self, world: World, name: CameraName) -> None:
        virtual = world.settings.virtual
        self._world = world
        self._name = name
        self._faults = virtual
        self._period = round(virtual.frame_ms * 1e6)
        self._exposure = round(min(virtual.exposure_ms, virtual.frame_ms) * 1e6)
        self._key = [virtual.seed, 1 if name == "c1" else 2]
        phase = np.random.default_rng([*self._key, 0]).uniform()
        self._first = round(phase * self._period)

    def clock_ns(self) -> int:
        """Read the camera's clock; takes its time."""
        wait(self._world.clock, ANSWER_S)
        stamp = self._stamp(self._world.clock.now_ns())
        wait(self._world.clock, ANSWER_S)
        return stamp

    def arrived(self, by: Nanoseconds) -> list[Packet]:
        """Return the frames that arrived last before a moment, in the order of their arrival."""
        newest = self._number(by)
        span = range(max(0, newest - self._faults.latency_frames - 4), newest + 1)
        packets = [p for k in span if (p := self._packet(k)) is not None and p.arrival_ns <= by]
        return sorted(packets, key=lambda p: p.arrival_ns)

    def next(self, after: Nanoseconds, until: Nanoseconds) -> Packet | None:
        """Return the frame that arrives first after a moment and by another; None if none does."""
        number = max(0, self._number(after) - self._faults.latency_frames - 2)
        best: Packet | None = None
        while self._begin(number) < (until if best is None else best.arrival_ns):
            packet = self._packet(number)
            if packet is not None and packet.arrival_ns > after:
                best = packet if best is None else min(best, packet, key=lambda p: p.arrival_ns)
            number += 1
        return best if best is not None and best.arrival_ns <= until else None

    def _number(self, moment: Nanoseconds) -> int:
        return (moment - self._first) // self._period

    def _begin(self, number: int) -> Nanoseconds:
        return self._first + number * self._period

    def _stamp(self, moment: Nanoseconds) -> int:
        drift = round(moment * self._faults.clock_drift_ppm * 1e-6)
        return moment + drift + round(self._faults.clock_offset_s * NS_PER_S)

    def _draws(self, number: int) -> tuple[float, float, int]:
        """Return what chance does to a frame, the same whoever asks, and when."""
        rng = np.random.default_rng([*self._key, 1, number])
        dropped, torn = rng.random(2)
        return dropped, torn, int(rng.integers(0, self._faults.latency_frames, endpoint=True))

    def _packet(self, number: int) -> Packet | None:
        dropped, torn, late = self._draws(number)
        if dropped < self._faults.dropped_share or number < 1:
            return None
        is_torn = torn < self._faults.torn_share
        begin = self._begin(number)
        return Packet(
            first=number,
            last=number - 1 if is_torn else number,
            stamp_ns=self._stamp(begin),
            arrival_ns=begin + self._exposure + READOUT_NS + late * self._period,
            pixels=lambda: self._pixels(number, is_torn=is_torn),
        )

    def _pixels(self, number: int, *, is_torn: bool) -> Image:
        rng = np.random.default_rng([*self._key, 2, number])
        picture = self._world.picture(self._name, self._begin(number), self._exposure, rng)
        if is_torn:
            before = self._world.picture(self._name, self._begin(number - 1), self._exposure, rng)
            cut = int(rng.integers(1, len(picture)))
            picture[cut:] = before[cut:]
        return picture


class VirtualCamera:
    """The driver: believes the camera's clock, held against the host's, and whole frames only.

    Parameters
    ----------
    sensor
        The device.
    world
        For its clock and the name of the rig.
    name
        "c1" or "c2".
    """

    def __init__(self, sensor: VirtualSensor, world: World, name: CameraName) -> None:
        self._sensor = sensor
        self._clock = world.clock
        self._identity = f"virtual camera {name}, rig {world.settings.serial}"
        lens = world.rig.c1 if name == "c1" else world.rig.c2
        self._size = lens.image_size
        self._is_stale = world.settings.virtual.stale

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""
        return self._identity

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self._size

    def after(self, moment: Nanoseconds, *, timeout_s: float) -> Frame:
        """Return a whole frame whose exposure began after `moment`; see `Camera.after`."""
        deadline = self._clock.now_ns() + round(timeout_s * NS_PER_S)
        if self._is_stale:
            return self._lie(moment)
        to_host = self._latch()
        now = self._clock.now_ns()
        for packet in self._sensor.arrived(now):
            if _is_whole(packet) and to_host(packet.stamp_ns) > moment:
                return _frame(packet, to_host(packet.stamp_ns))
        while (next_one := self._sensor.next(now, deadline)) is not None:
            now = next_one.arrival_ns
            self._clock.wait_until(now)
            if _is_whole(next_one) and (exposed := to_host(next_one.stamp_ns)) > moment:
                return _frame(next_one, exposed)
        self._clock.wait_until(deadline)
        raise Lost(
            f"{self.identity}: no whole frame exposed after the asked moment came within "
            f"{timeout_s:g} s; look at cable, trigger and bandwidth"
        )

    def latest(self) -> Frame | None:
        """Return the newest whole frame, for display only."""
        whole = [p for p in self._sensor.arrived(self._clock.now_ns()) if _is_whole(p)]
        return _frame(whole[-1], whole[-1].arrival_ns) if whole else None

    def close(self) -> None:
        """Nothing to let go of."""

    def _latch(self) -> Callable[[int], Nanoseconds]:
        """Return the host's time of a stamp, at the earliest that the camera's clock allows."""
        before = self._clock.now_ns()
        stamp = self._sensor.clock_ns()

        def to_host(other: int) -> Nanoseconds:
            away = other - stamp
            return before + away - round(abs(away) * DRIFT_BOUND)

        return to_host

    def _lie(self, moment: Nanoseconds) -> Frame:
        """Return whatever came last as if it were what is asked for: the fault `stale`."""
        now = self._clock.now_ns()
        if not (arrived := self._sensor.arrived(now)):
            raise Lost(f"{self.identity}: no frame yet")
        return _frame(arrived[-1], max(now, moment + 1))


def _is_whole(packet: Packet) -> bool:
    return packet.first == packet.last


def _frame(packet: Packet, exposed_ns: Nanoseconds) -> Frame:
    return Frame(packet.pixels(), exposed_ns, "camera clock", packet.first)


def open_camera(settings: Mapping[str, Any]) -> Camera:
    """Open a camera of a virtual rig; the driver "virtual"."""
    options(Options, settings)
    world: World = settings["world"]
    name = cast(CameraName, settings["role"])
    return VirtualCamera(VirtualSensor(world, name), world, name)
