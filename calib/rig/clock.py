"""The clock that all devices of a rig go by: this host's, or one that runs as fast as it is asked.

Whoever waits for a device waits by the clock of the rig, so that a simulated rig needs no more time
than its pictures take to render.
"""

from __future__ import annotations

import threading
import time
from typing import Protocol

from calib.rig.protocols import Nanoseconds

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Monotonic time in nanoseconds."""

    def now_ns(self) -> Nanoseconds:
        """Return the time."""

    def wait_until(self, moment: Nanoseconds) -> None:
        """Return when `moment` has come; at once if it is past."""


class HostClock:
    """`time.monotonic_ns`."""

    def now_ns(self) -> Nanoseconds:
        """Return the time."""
        return time.monotonic_ns()

    def wait_until(self, moment: Nanoseconds) -> None:
        """Sleep until `moment`."""
        while (left := moment - time.monotonic_ns()) > 0:
            time.sleep(left / NS_PER_S)


class SimulatedClock:
    """Time that passes only while somebody waits for it. May be shared by threads."""

    def __init__(self, start_ns: Nanoseconds = NS_PER_S) -> None:
        self._now = start_ns
        self._lock = threading.RLock()  # a signal's handler may ask while it is held

    def now_ns(self) -> Nanoseconds:
        """Return the time."""
        with self._lock:
            return self._now

    def wait_until(self, moment: Nanoseconds) -> None:
        """Put the clock forward to `moment`; never back."""
        with self._lock:
            self._now = max(self._now, moment)


def wait(clock: Clock, seconds: float) -> None:
    """Wait some time by a clock, s."""
    clock.wait_until(clock.now_ns() + round(seconds * NS_PER_S))
