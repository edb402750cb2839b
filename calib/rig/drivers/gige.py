"""GigE Vision cameras, by telegenicam: the driver "gige", extra `gige`.

The camera stands idle until a picture is asked for and is then armed for one frame, so that its
exposure begins after the moment asked for. Lines and drivers keep buffers, though, and one left
over from before arrives as if it were the answer. A frame is therefore believed only if it could
have been exposed since: it took at least its exposure to arrive, the camera's clock went on since
the last frame for at least as long as the host's did, and, where the clock can be latched, its
stamp is later than the moment at which the camera was armed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

import numpy as np
import telegenic
from pydantic import Field

from calib.core.errors import InputError
from calib.dataset.fields import Line, NotNegative, Positive
from calib.rig.clock import NS_PER_S
from calib.rig.options import Options, options
from calib.rig.protocols import Camera, Frame, Lost, Nanoseconds

DRIFT_BOUND: Final = 3e-4
"""No clock of a camera is further off its rate than 300 ppm; crystals are within 100."""

AUTOMATIC: Final = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "FocusAuto")
"""What must not change between two pictures; switched off and read back where there is such a
feature."""

EXPOSURE_NAMES: Final = ("ExposureTime", "ExposureTimeAbs")
LATCHES: Final = (
    ("TimestampLatch", "TimestampLatchValue"),
    ("GevTimestampControlLatch", "GevTimestampValue"),
)
ATTEMPT_S: Final = 2.0
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


class GigeCamera:
    """A camera that takes a picture when asked for one."""

    def __init__(self, camera: telegenic.Camera, own: GigeOptions, size: tuple[int, int]) -> None:
        self._camera = camera
        self._lock = threading.Lock()
        info = camera.device_info()
        self._identity = f"{info.manufacturer} {info.model} {info.serial}"
        self._size = size
        self._exposure_ns = _exposure_ns(camera)
        self._latch = _latch_of(camera)
        self._session = camera.snapshot_session(packet_size=own.packet_size)
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
                    time.sleep(min(moment - now, deadline - now) / NS_PER_S)
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
            self._session.close()
            self._camera.disconnect()

    def _attempt(self, timeout_s: float) -> Frame | str:
        """Arm the camera once; return the frame, or why it is none."""
        to_host = self._clock()
        armed = time.monotonic_ns()
        try:
            frame = self._session.snap(timeout_s)
        except (telegenic.GenicamError, telegenic.CameraError) as error:
            return str(error)
        taken = _Taken(frame, armed, time.monotonic_ns())
        if fault := self._fault(taken, to_host):
            return fault
        self._last = taken
        begin = armed if to_host is None else max(armed, to_host(frame.timestamp_ticks))
        return Frame(_pixels(frame), begin, "trigger", frame.frame_id)

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


def _pixels(frame: telegenic.Frame) -> np.ndarray[Any, np.dtype[np.uint8]]:
    flat = np.frombuffer(frame.data(), np.uint8)
    return flat[: frame.width * frame.height].reshape(frame.height, frame.width)


def _exposure_ns(camera: telegenic.Camera) -> Nanoseconds:
    for name in EXPOSURE_NAMES:
        if camera.has_feature(name):
            return round(camera.get_float(name) * 1000)
    return 0


def _latch_of(camera: telegenic.Camera) -> tuple[str, str, float] | None:
    """Return the command that latches the camera's clock, where it stands then, ns a tick."""
    for command, value in LATCHES:
        if camera.has_feature(command) and camera.has_feature(value):
            ticks_per_s = NS_PER_S
            if camera.has_feature("GevTimestampTickFrequency"):
                ticks_per_s = camera.get_integer("GevTimestampTickFrequency")
            return command, value, NS_PER_S / ticks_per_s
    return None


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
    if camera.has_feature("TriggerMode"):
        _set(camera.set_enum, camera.get_enum, "TriggerMode", "Off", where)
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
