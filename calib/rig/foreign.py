"""Devices of a lab's own drivers, held to what the protocols promise.

A driver from elsewhere raises what its library raises, and may hand out anything. Whatever it does,
the motor is stopped before the error goes on, and a frame that cannot be right is none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, Literal

import numpy as np

from calib.core.errors import CalibError, InputError, UsageError
from calib.rig.clock import Clock
from calib.rig.protocols import (
    AxisDriver,
    Camera,
    CameraDriver,
    Frame,
    Lost,
    Nanoseconds,
    Standstill,
    YawAxis,
)

LINE_MAX: Final = 200
"""Characters of a foreign error that are told."""


class ForeignCamera:
    """A `Camera` whose frames are new, of one size, and 8-bit grey, or `Lost`.

    Parameters
    ----------
    camera
        Of the driver.
    where
        Names it in messages.
    clock
        Of the rig.
    """

    def __init__(self, camera: Camera, where: str, clock: Clock) -> None:
        self.camera = camera
        self._where = where
        self._clock = clock
        self._size = camera.image_size

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""
        return self.camera.identity

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height, px, as the camera was opened."""
        return self._size

    def after(self, moment: Nanoseconds, *, timeout_s: float) -> Frame:
        """Return a whole frame whose exposure began after `moment`, or raise `Lost`."""
        with _named(self._where):
            frame = self.camera.after(moment, timeout_s=timeout_s)
        self._refuse_other(frame.pixels)
        if frame.exposed_ns < moment:
            raise Lost(
                f"{self._where}: handed out a frame exposed "
                f"{(moment - frame.exposed_ns) / 1e6:.0f} ms before the moment asked for; drain "
                "the driver's queue, or trigger the camera"
            )
        if frame.exposed_ns > self._clock.now_ns():
            raise Lost(
                f"{self._where}: handed out a frame exposed in the future; exposed_ns has to be of "
                "this computer's time.monotonic_ns(), not of the camera's clock or the time of day"
            )
        return frame

    def latest(self) -> Frame | None:
        """Return the newest frame, for display only; None if there is none yet."""
        with _named(self._where):
            return self.camera.latest()

    def close(self) -> None:
        """Let go of the device."""
        with _named(self._where):
            self.camera.close()

    def _refuse_other(self, pixels: object) -> None:
        width, height = self._size
        if isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8:
            if pixels.shape == (height, width):
                return
            found = " x ".join(map(str, pixels.shape[1::-1] + pixels.shape[2:]))
        else:
            found = str(getattr(pixels, "dtype", type(pixels).__name__))
        raise Lost(
            f"{self._where}: handed out a picture of {found}, not {width} x {height} px of 8-bit "
            "grey as it was opened; look for a crop, binning or format that was changed meanwhile"
        )


class ForeignAxis:
    """A `YawAxis` that is told to stop whenever a move or a reference run ends by an error.

    Parameters
    ----------
    axis
        Of the driver.
    where
        Names it in messages.
    """

    def __init__(self, axis: YawAxis, where: str) -> None:
        self.axis = axis
        self._where = where

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""
        return self.axis.identity

    @property
    def resolution_rad(self) -> float:
        """One count of the reading, rad."""
        return self.axis.resolution_rad

    @property
    def step_rad(self) -> float:
        """Smallest move, rad."""
        return self.axis.step_rad

    @property
    def range_rad(self) -> tuple[float, float]:
        """Readings within reach, rad."""
        return self.axis.range_rad

    def move(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Standstill:
        """Go to the step nearest to a reading; see `calib.rig.protocols.YawAxis.move`."""
        return self._turned(lambda: self.axis.move(reading_rad, approach=approach))

    def home(self) -> Standstill:
        """Find the reference mark."""
        return self._turned(self.axis.home)

    def standstill(self) -> Standstill:
        """Read the axis where it is."""
        with _named(self._where):
            return self.axis.standstill()

    def stop(self) -> None:
        """Stop at once."""
        with _named(self._where):
            self.axis.stop()

    def close(self) -> None:
        """Stop and let go of the device."""
        with _named(self._where):
            self.axis.close()

    def _turned(self, turn: Callable[[], Standstill]) -> Standstill:
        try:
            with _named(self._where):
                return turn()
        except BaseException:
            with suppress(Exception):
                self.axis.stop()
            raise


def open_camera(driver: CameraDriver, handed: Mapping[str, Any], place: str) -> ForeignCamera:
    """Open a camera by a driver from elsewhere; `place` is its section in rig.toml.

    Raises
    ------
    CalibError
        If it cannot be opened, or is no `Camera`.
    """
    where = f"rig.toml, [{place}] driver {handed['driver']!r}"
    with _opening(where, handed):
        camera = driver(handed)
        if not isinstance(camera, Camera):
            raise _other(where, camera, "Camera")
        return ForeignCamera(camera, where, handed["clock"])


def open_axis(driver: AxisDriver, handed: Mapping[str, Any], place: str) -> ForeignAxis:
    """Open a yaw axis by a driver from elsewhere; as `open_camera`."""
    where = f"rig.toml, [{place}] driver {handed['driver']!r}"
    with _opening(where, handed):
        axis = driver(handed)
        if not isinstance(axis, YawAxis):
            raise _other(where, axis, "YawAxis")
        return ForeignAxis(axis, where)


def _other(where: str, device: object, wanted: str) -> UsageError:
    """Return the refusal of what a driver opened, which is stopped and closed as far as it can."""
    for end in ("stop", "close"):
        with suppress(Exception):
            getattr(device, end)()
    return UsageError(
        f"{where}: opens a {type(device).__name__}, which is no {wanted}; see docs/drivers.md for "
        "what it must have"
    )


@contextmanager
def _opening(where: str, handed: Mapping[str, Any]) -> Iterator[None]:
    """Let a key that a driver misses in its section be one that has to be added."""
    try:
        with _named(where):
            yield
    except Lost as error:
        missing = error.__cause__
        if isinstance(missing, KeyError) and missing.args and missing.args[0] not in handed:
            raise InputError.single(
                where=where, what=f"{missing.args[0]} is missing", remedy="add it to the section"
            ) from error
        raise


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Let what a driver's library raises be a device that is lost."""
    try:
        yield
    except CalibError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:LINE_MAX]
        raise Lost(f"{where}: {type(error).__name__}{f': {text}' if text else ''}") from error
