"""The hand that puts targets before the rig: an operator's, or the virtual rig's."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.rig.devices import RigDevices
from calib.rig.protocols import Refused
from calib.rig.virtual.operator import Operator
from calib.rig.virtual.world import World

SWAY_MM, SWAY_S = (60.0, 10.0, 40.0), (7.0, 5.0, 11.0)
"""Amplitudes and periods, in x, y and z, of a target that the virtual rig is to follow."""


class Placing(Protocol):
    """Puts targets before the rig and measures their depth by hand."""

    def place(self, name: str) -> None:
        """Put the next target up, at rest."""

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:
        """Return its depth and standard uncertainty, mm; None if there is none to be had."""

    def place_again(self, name: str, *, of: str) -> None:
        """Put a target up again where it stood under the name `of`."""


class PlatePlacing:
    """The hand of a virtual rig that puts plates up.

    Parameters
    ----------
    world
        Where they go.
    """

    def __init__(self, world: World) -> None:
        self._operator = Operator(world)

    def place(self, name: str) -> None:  # noqa: ARG002 - of the protocol
        """Put the plate where C1 sees both its ends."""
        self._operator.show_plate()

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:  # noqa: ARG002 - of the protocol
        """Return nothing: a plate has no one depth."""
        return None

    def place_again(self, name: str, *, of: str) -> None:
        """Leave the plate where it is: no capture returns to one."""


class VirtualPlacing:
    """The hand of a virtual rig.

    Parameters
    ----------
    world
        Where the targets go.
    held_rad
        Reading from which C2 must see them too, rad; None if there is none.
    before
        Names of the targets that have been placed before, in order.
    """

    def __init__(
        self, world: World, *, held_rad: float | None = None, before: Sequence[str] = ()
    ) -> None:
        self._operator = Operator(world, held_rad=held_rad)
        self._poses: dict[str, FloatArray] = {}
        for name in before:
            self.place(name)
            self._operator.ruler_mm()

    def place(self, name: str) -> None:
        """Put the next board where both cameras see all of it."""
        self._poses[name] = self._operator.show_gaze()

    def place_again(self, name: str, *, of: str) -> None:  # noqa: ARG002 - of the protocol
        """Put a board up again exactly where it stood, as a fixture would.

        Raises
        ------
        Refused
            If this hand never put it up.
        """
        if of not in self._poses:
            raise Refused(f"nobody knows where the target of {of} stood")
        self._operator.put(self._poses[of])

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:  # noqa: ARG002 - of the protocol
        """Return the depth as a ruler would tell it."""
        return self._operator.ruler_mm()


class AskedPlacing:
    """An operator at the terminal.

    Parameters
    ----------
    tell
        Prints a line where the operator sees it.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def place(self, name: str) -> None:
        """Ask for the next target and wait for Enter."""
        self._asked(f"{name}: put the target up, at rest, then press Enter")

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:
        """Ask for the depth."""
        while True:
            text = self._asked(f"{name}: its depth in mm").strip()
            try:
                depth = float(text)
            except ValueError:
                depth = math.nan
            if 0 < depth < math.inf:
                return depth, None
            self._tell(f"{text!r} is no depth: a number of millimetres, above 0")

    def place_again(self, name: str, *, of: str) -> None:
        """Ask for a target that stood there before and wait for Enter."""
        self._asked(
            f"{name}: put the target of {of} back where it stood then, at rest, then press Enter"
        )

    def _asked(self, question: str) -> str:
        self._tell(question)
        line = sys.stdin.readline() if sys.stdin is not None else ""
        if not line:
            raise UsageError("standard input ended: an operator has to answer, with Enter at least")
        return line


def placing_for(
    rig: RigDevices,
    tell: Callable[[str], None],
    *,
    held_rad: float | None = None,
    before: Sequence[str] = (),
) -> Placing:
    """Return the hand for a rig; the last two are settings of `VirtualPlacing`."""
    if rig.world is None:
        return AskedPlacing(tell)
    if rig.world.sheet.corners_mm:
        return PlatePlacing(rig.world)
    return VirtualPlacing(rig.world, held_rad=held_rad, before=before)


def set_swaying(rig: RigDevices) -> None:
    """Let the target of a virtual rig sway; does nothing to a real one, whose targets do it."""
    if rig.world is None:
        return
    pose = rig.world.pose(rig.clock.now_ns())
    if pose is None:
        raise UsageError("there is no target to sway")
    rest = pose.copy()

    def motion(seconds: float) -> FloatArray:
        moved = rest.copy()
        phase = 2 * np.pi * seconds / np.array(SWAY_S)
        moved[:3, 3] += np.array(SWAY_MM) * np.sin(phase)
        return moved

    rig.world.follow(motion)
