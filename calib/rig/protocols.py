"""What a camera and a yaw axis must do to be used for measuring.

The types carry two rules. A frame is asked for by the moment after which it was exposed, so that a
picture taken before the motor stopped cannot be had. A reading comes only as part of a
`Standstill`, so that a row cannot pair the reading of one stop with the picture of another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from calib.core.errors import CalibError

Nanoseconds: TypeAlias = int
"""Of this host's monotonic clock, as `time.monotonic_ns` counts them."""

ReadingSource: TypeAlias = Literal["load encoder", "motor encoder", "counts"]
"""What a reading is: of an encoder on C2's side, of one on the motor's, or the steps commanded."""

Sureness: TypeAlias = Literal["trigger", "camera clock", "arrival"]
"""How it is known when a frame was exposed: it was triggered after the moment asked for; the
camera's clock says so, held against the host's; or it arrived so late that it must be so."""


class RigError(CalibError):
    """The rig did not do what was asked; no row comes of it."""

    exit_status = 3


class Refused(RigError):  # noqa: N818 - what happened to the rig, as users read it
    """Asked for something outside what the device or the law of gazing allows."""


class Stalled(RigError):  # noqa: N818 - what happened to the rig, as users read it
    """The axis came to rest elsewhere than commanded, or not at all."""


class Interrupted(RigError):  # noqa: N818 - what happened to the rig, as users read it
    """The move was stopped by another hand or by `YawAxis.stop`."""


class Lost(RigError):  # noqa: N818 - what happened to the rig, as users read it
    """The device does not answer, or sends nothing that can be used."""


@dataclass(frozen=True)
class Frame:
    """A whole picture and when it was exposed.

    Parameters
    ----------
    pixels
        8-bit grey, shape (height, width).
    exposed_ns
        Begin of the exposure; the truth may be later, by as much as `sure` leaves open, never
        earlier: a frame that says it was exposed after a moment was.
    sure
        How the beginning is known.
    serial
        Number of the frame as its camera counts them.
    """

    pixels: NDArray[np.uint8]
    exposed_ns: Nanoseconds
    sure: Sureness
    serial: int


@dataclass(frozen=True)
class Standstill:
    """The axis at rest.

    Parameters
    ----------
    reading_rad
        What was read after the axis had come to rest, rad.
    since_ns
        It has been at rest at least since then.
    source
        What the reading is of.
    counts
        The reading in whole counts: equal counts are the same stop, if nothing moved between.
    approached
        Side from which the axis came: 1 while the reading grew, -1 while it fell.
    home
        Identifies the reference run that the counts rest on. Rows of two homings have two zero
        errors.
    """

    reading_rad: float
    since_ns: Nanoseconds
    source: ReadingSource
    counts: int
    approached: Literal[-1, 1]
    home: str


@runtime_checkable
class Camera(Protocol):
    """A camera with fixed settings: exposure, gain, focus, white balance."""

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height, px."""

    def after(self, moment: Nanoseconds, *, timeout_s: float) -> Frame:
        """Return a whole frame whose exposure began after `moment`.

        Raises
        ------
        Lost
            If none came in time.
        """

    def latest(self) -> Frame | None:
        """Return the newest frame, for display only; None if there is none yet."""

    def close(self) -> None:
        """Let go of the device."""


@runtime_checkable
class YawAxis(Protocol):
    """The motor that turns C2. Moves are absolute, block, and end at rest."""

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""

    @property
    def resolution_rad(self) -> float:
        """One count of the reading, rad."""

    @property
    def step_rad(self) -> float:
        """Smallest move, rad: a count, or the motor's step where an encoder is finer."""

    @property
    def range_rad(self) -> tuple[float, float]:
        """Readings within reach, rad."""

    def move(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Standstill:
        """Go to the step nearest to a reading and return how the axis stands there.

        The reading is read back until two agree, and held against the command.

        Parameters
        ----------
        approach
            Side from which to arrive; the axis overshoots if it must. 0 takes the short way.

        Raises
        ------
        Refused
            If the reading is out of reach.
        Stalled, Interrupted, Lost
            If the axis did not arrive; it is at rest as far as it can be told.
        """

    def standstill(self) -> Standstill:
        """Read the axis where it is.

        Raises
        ------
        Interrupted
            If it moves.
        """

    def home(self) -> Standstill:
        """Find the reference mark; readings are of a new homing from now on."""

    def stop(self) -> None:
        """Stop at once. May be called from any thread, also during a move."""

    def close(self) -> None:
        """Stop and let go of the device."""


CameraDriver: TypeAlias = Callable[[Mapping[str, Any]], Camera]
"""Opens a camera with the settings of its section in rig.toml."""

AxisDriver: TypeAlias = Callable[[Mapping[str, Any]], YawAxis]
