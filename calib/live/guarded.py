"""The axis as jobs have it: what Stop asked of it holds until the next job begins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final, Literal

from calib.core.errors import CalibError
from calib.rig.protocols import Interrupted, Standstill, YawAxis

AGAIN_S: Final = 0.01
STOP_S: Final = 3.0
"""The axis is told to stop again and again for so long: a move that was just beginning may have
forgotten the first time."""

Turned = Callable[[float | None], None]
"""Told of a new reading, rad; None while C2 turns."""


class Stopped(CalibError):  # noqa: N818 - what happened, as users read it
    """Stop was pressed. No `RigError`, which a capture takes for a fault of one target."""

    exit_status = 3


class GuardedAxis:
    """A `YawAxis` that, once stopped, moves no more until it is allowed to.

    Parameters
    ----------
    axis
        The device.
    turned
        Told of readings.
    """

    def __init__(self, axis: YawAxis, turned: Turned) -> None:
        self._axis = axis
        self._turned = turned
        self._stopped = threading.Event()
        self._moving = threading.Event()

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""
        return self._axis.identity

    @property
    def resolution_rad(self) -> float:
        """One count of the reading, rad."""
        return self._axis.resolution_rad

    @property
    def step_rad(self) -> float:
        """Smallest move, rad."""
        return self._axis.step_rad

    @property
    def range_rad(self) -> tuple[float, float]:
        """Readings within reach, rad."""
        return self._axis.range_rad

    @property
    def is_stopped(self) -> bool:
        """Whether nothing may move."""
        return self._stopped.is_set()

    @property
    def is_moving(self) -> bool:
        """Whether a move is under way."""
        return self._moving.is_set()

    def allow(self) -> None:
        """Let the axis move again."""
        self._stopped.clear()

    def refuse_stopped(self) -> None:
        """Raise `Interrupted` after a stop."""
        if self.is_stopped:
            raise Interrupted("stopped")

    def move(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Standstill:
        """Go to a reading; see `calib.rig.protocols.YawAxis.move`."""
        return self._guarded(lambda: self._axis.move(reading_rad, approach=approach))

    def home(self) -> Standstill:
        """Find the reference mark."""
        return self._guarded(self._axis.home)

    def standstill(self) -> Standstill:
        """Read the axis where it is; after a stop no row is to come of it."""
        self.refuse_stopped()
        standing = self._axis.standstill()
        self._turned(standing.reading_rad)
        return standing

    def stop(self) -> None:
        """Stop at once, from any thread; return when no move is under way."""
        self._stopped.set()
        self._axis.stop()
        until = time.monotonic() + STOP_S
        while self._moving.is_set() and time.monotonic() < until:
            time.sleep(AGAIN_S)
            self._axis.stop()

    def close(self) -> None:
        """Stop and let go of the device."""
        self._stopped.set()
        self._axis.close()

    def _guarded(self, moving: Callable[[], Standstill]) -> Standstill:
        # First the flag, then the look at the other one: `stop` does it the other way round.
        self._moving.set()
        try:
            self.refuse_stopped()
            self._turned(None)
            standing = moving()
        finally:
            self._moving.clear()
        self._turned(standing.reading_rad)
        return standing
