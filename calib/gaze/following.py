"""Gazing at a target that moves: C2 is sent to where it will be, and looked through where it rests.

C2 need not have the target in the middle of its picture: what is off is measured. Each row is of
the moment of C2's picture; where C1 would have seen the target then is told by its own pictures
just before and after.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.core.arrays import FloatArray
from calib.gaze import follow
from calib.gaze.aim import Aiming
from calib.gaze.follow import Track
from calib.gaze.gazing import Gazer
from calib.gaze.row import GazeRow, SeenTarget, make_row
from calib.rig.clock import NS_PER_S
from calib.rig.protocols import Nanoseconds, Refused, Sureness

FIRST_CYCLE_S: Final = 0.4
"""Time from a picture of C1 to one of C2 before it has been measured."""

U_MOMENT_S: Final[Mapping[Sureness, float]] = {
    "trigger": 0.0005, "camera clock": 0.001, "arrival": 0.01,
}  # fmt: skip
"""By how much the moments of two cameras' pictures may be wrong against each other."""

STRAY_SHARE, STRAY_PX = 0.5, 3.0
"""What the detector finds farther from where the flow led than half the target's size, or so many
pixels, is another target."""

UNSTEADY_PX_S2: Final = 20.0
"""Change of speed, on top of the speed itself in a second, that a hand may bring about."""


@dataclass
class Follower:
    """A rig that follows one target.

    Parameters
    ----------
    gazer
        The rig, at a target that may move.
    aiming
        Where C2 has to look.
    """

    gazer: Gazer
    aiming: Aiming
    _track: Track | None = None
    _cycle_s: float = FIRST_CYCLE_S

    def row(self, depth_mm: float | None) -> GazeRow:
        """Return the next row.

        Parameters
        ----------
        depth_mm
            Depth last measured, mm; None before the first.

        Raises
        ------
        RigError
            If there is none; the message says why. The next call looks again.
        """
        rig, gazer = self.gazer.rig, self.gazer
        started = rig.clock.now_ns()
        first = self._seen_in_c1(started)
        meet = first.frame.exposed_ns + round(self._cycle_s * NS_PER_S)
        aim = self.aiming.aim(self._at(meet), depth_mm=depth_mm)
        low, high = gazer.law.range_rad
        goal = gazer.law.place(aim.first_rad)
        if not low <= goal <= high:
            raise Refused(
                f"the target goes where C2 needs a reading of {math.degrees(goal):.2f} deg; the "
                f"axis' range is {math.degrees(low):g} to {math.degrees(high):g} deg"
            )
        standing = rig.axis.move(goal, approach=1)
        before = self._seen_in_c1(gazer.at_rest(standing))
        c2 = gazer.look(rig.c2, before.frame.exposed_ns)
        if c2 is None:
            raise Refused(gazer.unseen("C2"))
        after = self._seen_in_c1(c2.frame.exposed_ns)
        gazer.refuse_turned(standing)
        self._cycle_s = (c2.frame.exposed_ns - first.frame.exposed_ns) / NS_PER_S
        pixel, extra = _between(before, after, c2)
        row = make_row(
            standing, c1=(before, after), c2=(c2,), noise_c1=gazer.noise_c1,
            noise_c2=gazer.noise_c2, moves=1, looks=0,
        )  # fmt: skip
        return replace(
            row, pixel_c1=pixel, u_c1_px=float(np.hypot(row.u_c1_px * math.sqrt(2), extra))
        )

    def _seen_in_c1(self, moment: Nanoseconds) -> SeenTarget:
        """Return a picture of C1 with the target measured in it, and go on with its track."""
        rig = self.gazer.rig
        seen = self.gazer.look(rig.c1, moment)
        if seen is None:
            self._track = None
            raise Refused(self.gazer.unseen("C1"))
        if self._track is None:
            self._track = follow.start(seen.frame, seen.observation.pixel)
            return seen
        led = follow.flowed(self._track, seen.frame)
        self._track = follow.seen(self._track, seen.frame, seen.observation.pixel)
        if led is not None:
            stray = float(np.hypot(*(led.pixels[-1] - seen.observation.pixel)))
            if stray > max(STRAY_PX, STRAY_SHARE * seen.observation.size_px):
                self._track = None
                raise Refused(
                    f"what C1 finds is {stray:.1f} px from where the target went: another one"
                )
        return seen

    def _at(self, moment: Nanoseconds) -> FloatArray:
        if self._track is None:
            raise ValueError("there is no track before a first picture")
        return self._track.at(moment)


def _between(before: SeenTarget, after: SeenTarget, c2: SeenTarget) -> tuple[FloatArray, float]:
    """Return where C1 saw the target at the moment of C2's picture, and what is uncertain of it.

    Between two pictures a target goes straight, but for what it can change of its way meanwhile:
    its speed is taken to change by no more than itself and `UNSTEADY_PX_S2` in a second.
    """
    times = [s.frame.exposed_ns / NS_PER_S for s in (before, c2, after)]
    span = max(times[2] - times[0], 1e-6)
    share = (times[1] - times[0]) / span
    way = after.observation.pixel - before.observation.pixel
    pixel: FloatArray = before.observation.pixel + share * way
    speed = float(np.abs(way).max() / span)
    u_moment = max(U_MOMENT_S[s.frame.sure] for s in (before, after, c2))
    return pixel, float(np.hypot(speed * u_moment, (speed + UNSTEADY_PX_S2) * span**2 / 8))
