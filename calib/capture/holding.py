"""Who holds the board as a guide asks: the virtual rig's hand, or an operator at the terminal."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

from calib.capture.guidance.asked import AskedPose
from calib.rig.devices import RigDevices
from calib.rig.protocols import Refused
from calib.rig.virtual.hand import Hand
from calib.rig.virtual.world import World

PATIENCE_S, PATIENCE_PICTURES = 1.5, 5
"""The virtual hand tries anew where the shutter is not released by then, nor by so many pictures: a
slow computer looks seldom, and the board must be still between two looks."""

TRIES_MAX: Final = 5

TELL_S: Final = 2.0
"""An operator at the terminal is told the same no more often."""


class Holding(Protocol):
    """Holds the board."""

    def hold(self, asked: AskedPose) -> None:
        """Begin to hold it as asked."""

    def wait(self, fault: str, waited_s: float) -> None:
        """Hear why no picture is taken yet, after so long by the rig's clock.

        Raises
        ------
        Refused
            If it cannot be held so.
        """


class VirtualHolding:
    """The hand of a virtual rig.

    Parameters
    ----------
    world
        Where the board is.
    done
        Poses held before.
    """

    def __init__(self, world: World, *, done: int = 0) -> None:
        self._hand = Hand(world, done=done)
        self._asked: AskedPose | None = None
        self._tries = 0
        self._until_s = PATIENCE_S
        self._looks = 0

    def hold(self, asked: AskedPose) -> None:
        """Begin to hold the board as asked."""
        self._asked, self._tries, self._until_s, self._looks = asked, 0, PATIENCE_S, 0
        self._hand.hold(asked.role, asked.corners_px)

    def wait(self, fault: str, waited_s: float) -> None:
        """Try again, with more care, after some time."""
        self._looks += 1
        if waited_s < self._until_s or self._looks < PATIENCE_PICTURES or self._asked is None:
            return
        self._looks = 0
        self._tries += 1
        if self._tries == TRIES_MAX:
            raise Refused(f"the outline cannot be filled: {fault}")
        self._until_s = waited_s + PATIENCE_S
        self._hand.hold(self._asked.role, self._asked.corners_px, tries=self._tries)


class ToldHolding:
    """An operator at the terminal, who sees the picture file and reads what is told.

    Parameters
    ----------
    tell
        Prints a line.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._last, self._at = "", 0.0

    def hold(self, asked: AskedPose) -> None:  # noqa: ARG002 - the outline is in the picture
        """Begin anew."""
        self._last = ""

    def wait(self, fault: str, waited_s: float) -> None:  # noqa: ARG002 - people take their time
        """Tell why nothing is taken yet, when that changes."""
        now = time.monotonic()
        if fault != self._last and now - self._at > TELL_S:
            self._last, self._at = fault, now
            self._tell(f"  {fault}")


def holding_for(rig: RigDevices, tell: Callable[[str], None], *, done: int) -> Holding:
    """Return who holds the board of a rig; `done` poses were held before."""
    return ToldHolding(tell) if rig.world is None else VirtualHolding(rig.world, done=done)
