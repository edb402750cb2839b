"""The hand that puts targets before the rig: an operator's, or the virtual rig's."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Protocol

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.rig.devices import RigDevices
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


class VirtualPlacing:
    """The hand of a virtual rig.

    Parameters
    ----------
    world
        Where the targets go.
    held_rad
        Reading from which C2 must see them too, rad; None if there is none.
    done
        So many targets have been placed before.
    """

    def __init__(self, world: World, *, held_rad: float | None = None, done: int = 0) -> None:
        self._operator = Operator(world, held_rad=held_rad)
        for _ in range(done):
            self._operator.show_gaze()
            self._operator.ruler_mm()

    def place(self, name: str) -> None:  # noqa: ARG002 - of the protocol
        """Put the next board where both cameras see all of it."""
        self._operator.show_gaze()

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

    def _asked(self, question: str) -> str:
        self._tell(question)
        line = sys.stdin.readline() if sys.stdin is not None else ""
        if not line:
            raise UsageError("standard input ended: an operator has to answer, with Enter at least")
        return line


def placing_for(rig: RigDevices, tell: Callable[[str], None], **virtual: float) -> Placing:
    """Return the hand for a rig; `virtual` are settings of `VirtualPlacing`."""
    if rig.world is None:
        return AskedPlacing(tell)
    if rig.world.sheet.corners_mm:
        return PlatePlacing(rig.world)
    held, done = virtual.get("held_rad"), int(virtual.get("done", 0))
    return VirtualPlacing(rig.world, held_rad=held, done=done)


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
