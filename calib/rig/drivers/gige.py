"""GigE Vision cameras, by telegenicam: the driver "gige", extra `gige`.

A picture is exposed on a software trigger, sent after the moment asked for, and each trigger is
answered by one frame before the next is sent: none is left over that could be taken for the
answer. After a frame that failed to come the line is left alone until it has been quiet. Cameras
without such a trigger are armed for single frames; they send a few more than they are asked for,
so that each picture begins with a quiet line. Either way a frame is believed only if it took at
least its exposure to arrive, if the camera's clock went on since the last one as the host's did,
and, where that clock can be latched, if its stamp is later than the trigger.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Final, Protocol

import telegenic
from pydantic import Field

from calib.core.errors import InputError
from calib.dataset.fields import Line, NotNegative, Positive
from calib.rig.clock import NS_PER_S
from calib.rig.drivers.gige_features import (
    EXPOSURE_NAMES,
    TRIGGER,
    exposure_ns,
    latch_of,
    made_triggered,
    pixels_of,
)
from calib.rig.options import Options, options
from calib.rig.protocols import Camera, Frame, Lost, Nanoseconds

DRIFT_BOUND: Final = 3e-4
"""No clock of a camera is further off its rate than 300 ppm; crystals are within 100."""

AUTOMATIC: Final = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "FocusAuto")
"""What must not change between two pictures; switched off and read back where there is such a
feature."""

ATTEMPT_S: Final = 2.0

QUIET_S: Final = 0.2
"""A line on which nothing came for so long is empty: five frames at 25 a second."""

_DISPLAYED_S: Final = 0.5


class GigeOptions(Options):
    """Keys of the driver.

    Parameters
    ----------
    address
        IP address of the camera.
    local_address
        Of the host's adapter towards it; None lets the system choose.
    exposure_us
        Exposure; None keeps the camera's.
    gain
        None keeps the camera's.
    packet_size
        Of the stream, bytes; None negotiates the largest, which fails on some links.
    """

    address: Line
    local_address: Line | None = None
    exposure_us: Positive | None = None
    gain: NotNegative | None = None
    packet_size: Annotated[int, Field(strict=True, ge=200, le=16000)] | None = 1400


@dataclass(frozen=True)
class _Taken:
    """A frame with the host's times around it."""

    frame: telegenic.Frame
    armed_ns: Nanoseconds
    arrived_ns: Nanoseconds


class TriggerSource(Protocol):
    """A way to have a camera expose one frame."""

    def shoot(self, timeout_s: float) -> telegenic.Frame | None:
        """Have a frame exposed, from now on; None if it does not come in time."""

    def quiet(self) -> None:
        """Wait until nothing is under way any more."""

    def close(self) -> None:
        """Leave the camera idle."""


class TriggeredSource:
    """A camera that waits for software triggers."""

    def __init__(self, camera: telegenic.Camera, packet_size: int | None) -> None:
        self._camera = camera
        self._acquisition = camera.start_acquisition(packet_size=packet_size)

    def shoot(self, timeout_s: float) -> telegenic.Frame | None:
        """Trigger and wait for the frame."""
        self._camera.execute(TRIGGER)
        return self._acquisition.wait_for(timeout_s)

    def quiet(self) -> None:
        """Take frames off until none comes for a while."""
        while self._acquisition.wait_for(QUIET_S) is not None:
            pass

    def close(self) -> None:
        """Leave the camera idle."""
        self._acquisition.stop()


class SnapshotSource:
    """A camera that is armed for one frame at a time."""

    def __init__(self, camera: telegenic.Camera, packet_size: int | None) -> None:
        self._session = camera.snapshot_session(packet_size=packet_size)

    def shoot(self, timeout_s: float) -> telegenic.Frame | None:
        """Arm the camera, once whatever it sent too many has come."""
        return self._session.snap(timeout_s)

    def quiet(self) -> None:
        """Leave the line alone; the session takes no notice of what comes."""
        time.sleep(QUIET_S)

    def close(self) -> None:
        """Leave the camera idle."""
        self._session.close()


class GigeCamera:
    """A camera that takes a picture when asked for one."""

    def __init__(self, camera: telegenic.Camera, own: GigeOptions, size: tuple[int, int]) -> None:
        self._camera = camera
        self._own = own
        self._lock = threading.Lock()
        info = camera.device_info()
        self._identity = f"{info.manufacturer} {info.model} {info.serial}"
        self._size = size
        self._exposure_ns = exposure_ns(camera)
        self._latch = latch_of(camera)
        self._is_triggered = made_triggered(camera)
        self._source = self._open_source()
        self._last: _Taken | None = None
        self._shown: Frame | None = None

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
        deadline = time.monotonic_ns() + round(timeout_s * NS_PER_S)
        reason = "none came"
        with self._lock:
            while (now := time.monotonic_ns()) < deadline:
                if now <= moment:
                    time.sleep(min(moment - now + 1, deadline - now) / NS_PER_S)
                    continue
                outcome = self._attempt(min(ATTEMPT_S, (deadline - now) / NS_PER_S))
                if isinstance(outcome, Frame):
                    self._shown = outcome
                    return outcome
                reason = outcome
        raise Lost(
            f"{self.identity}: no whole frame exposed after the asked moment came within "
            f"{timeout_s:g} s ({reason}); look at cable, trigger mode, packet_size and firewall"
        )

    def latest(self) -> Frame | None:
        """Return the newest frame, for display only; takes one if none is under way."""
        if self._lock.acquire(blocking=False):
            try:
                outcome = self._attempt(_DISPLAYED_S + self._exposure_ns / NS_PER_S)
                if isinstance(outcome, Frame):
                    self._shown = outcome
            finally:
                self._lock.release()
        return self._shown

    def close(self) -> None:
        """Let go of the device."""
        with self._lock:
            self._source.close()
            self._camera.disconnect()

    def _open_source(self) -> TriggerSource:
        kind = TriggeredSource if self._is_triggered else SnapshotSource
        source: TriggerSource = kind(self._camera, self._own.packet_size)
        source.quiet()
        return source

    def _attempt(self, timeout_s: float) -> Frame | str:
        """Have one frame exposed; return it, or why it is none."""
        try:
            taken, to_host = self._take(timeout_s)
        except telegenic.CameraError as error:
            self._reconnect()
            return str(error)
        except telegenic.GenicamError as error:
            self._source.quiet()
            return str(error)
        if taken is None:
            self._source.quiet()
            return "none came"
        if fault := self._fault(taken, to_host):
            self._source.quiet()
            return fault
        self._last = taken
        frame, begin = taken.frame, taken.armed_ns
        if to_host is not None:
            begin = max(begin, to_host(frame.timestamp_ticks))
        return Frame(pixels_of(frame), begin, "trigger", frame.frame_id)

    def _take(self, timeout_s: float) -> tuple[_Taken | None, Callable[[int], Nanoseconds] | None]:
        if not self._is_triggered:
            self._source.quiet()
        to_host = self._clock()
        armed = time.monotonic_ns()
        frame = self._source.shoot(timeout_s)
        return (frame and _Taken(frame, armed, time.monotonic_ns())), to_host

    def _reconnect(self) -> None:
        """Take hold of the camera again after the line failed; the next attempt tells if it did."""
        with suppress(telegenic.CameraError, telegenic.GenicamError):
            self._source.close()
        try:
            self._camera.connect()
            self._source = self._open_source()
        except (telegenic.CameraError, telegenic.GenicamError):
            time.sleep(QUIET_S)

    def _fault(self, taken: _Taken, to_host: Callable[[int], Nanoseconds] | None) -> str | None:
        """Return why a frame cannot be believed; None if it can."""
        frame = taken.frame
        if not frame.is_complete:
            return f"a frame came incomplete: {frame.status}"
        if (frame.width, frame.height) != self._size or frame.pixel_format != "Mono8":
            return f"a frame of {frame.width} x {frame.height} {frame.pixel_format} came"
        if taken.arrived_ns - taken.armed_ns < self._exposure_ns:
            return "a frame came sooner than its exposure takes"
        if to_host is not None and to_host(frame.timestamp_ticks) < taken.armed_ns - _margin(taken):
            return "a frame came whose stamp is earlier than the trigger"
        last = self._last
        if last is not None and frame.timestamp_ns and last.frame.timestamp_ns:
            passed = frame.timestamp_ns - last.frame.timestamp_ns
            least = taken.armed_ns - last.arrived_ns
            if passed < least * (1 - DRIFT_BOUND):
                return "a frame came whose stamp is too near the last one's"
        return None

    def _clock(self) -> Callable[[int], Nanoseconds] | None:
        """Return the host's time of a stamp, at the earliest possible; None without a latch."""
        if self._latch is None:
            return None
        command, value, per_tick = self._latch
        before = time.monotonic_ns()
        self._camera.execute(command)
        ticks = self._camera.get_integer(value)

        def to_host(stamp: int) -> Nanoseconds:
            away = round((stamp - ticks) * per_tick)
            return before + away - round(abs(away) * DRIFT_BOUND)

        return to_host


def _margin(taken: _Taken) -> Nanoseconds:
    """Return how far the earliest host's time of a stamp may fall before the trigger."""
    return round((taken.arrived_ns - taken.armed_ns) * DRIFT_BOUND) + 1


def open_camera(settings: Mapping[str, Any]) -> Camera:
    """Open a GigE Vision camera; the driver "gige".

    Raises
    ------
    InputError
        If its section has a wrong key, or the camera does not take a setting.
    Lost
        If it does not answer.
    """
    own = options(GigeOptions, settings)
    where = f"rig.toml, [cameras.{settings.get('role', 'c1')}]"
    camera = telegenic.Camera(own.address, local_ip=own.local_address)
    try:
        camera.connect()
        size = _set_up(camera, own, settings.get("image_size"), where)
        return GigeCamera(camera, own, size)
    except telegenic.CameraError as error:
        raise Lost(
            f"{where}: the camera at {own.address} does not answer: {error}; look at power, cable "
            "and whether another program holds it"
        ) from error
    except telegenic.GenicamError as error:
        raise Lost(f"{where}: the camera at {own.address} cannot be used: {error}") from error


def _set_up(
    camera: telegenic.Camera, own: GigeOptions, size: tuple[int, int] | None, where: str
) -> tuple[int, int]:
    """Fix all settings, read them back and return the image size."""
    for name in AUTOMATIC:
        if camera.has_feature(name):
            _set(camera.set_enum, camera.get_enum, name, "Off", where)
    _set(camera.set_enum, camera.get_enum, "PixelFormat", "Mono8", where)
    for name, pixels in zip(("Width", "Height"), size or (), strict=False):
        _set(camera.set_integer, camera.get_integer, name, pixels, where)
    if own.exposure_us is not None:
        _set_float(camera, EXPOSURE_NAMES, own.exposure_us, f"{where} exposure_us")
    if own.gain is not None:
        _set_float(camera, ("Gain",), own.gain, f"{where} gain")
    return camera.get_integer("Width"), camera.get_integer("Height")


def _set(
    put: Callable[[str, Any], None], get: Callable[[str], Any], name: str, value: Any, where: str
) -> None:
    try:
        put(name, value)
        stands = get(name)
    except telegenic.GenicamError as error:
        stands = error
    if stands != value:
        raise InputError.single(
            where=where,
            what=f"the camera does not take {name} = {value}; it answers {stands}",
            remedy="set it with the maker's own program, or change rig.toml",
        )


def _set_float(camera: telegenic.Camera, names: tuple[str, ...], value: float, where: str) -> None:
    name = next((n for n in names if camera.has_feature(n)), None)
    if name is None:
        raise InputError.single(
            where=where, what="the camera has no such setting", remedy="leave it out of rig.toml"
        )
    try:
        camera.set_float(name, value)
        stands = camera.get_float(name)
    except telegenic.GenicamError as error:
        raise InputError.single(
            where=where,
            what=f"the camera does not take {name} = {value:g}: {error}",
            remedy="give a value within its bounds",
        ) from error
    if abs(stands - value) > 0.05 * value:
        raise InputError.single(
            where=where,
            what=f"the camera takes {stands:g} for {name} = {value:g}",
            remedy=f"write {stands:g}",
        )
