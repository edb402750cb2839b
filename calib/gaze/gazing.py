"""Gazing with the devices: the loop that carries out the law and takes the row."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.core.arrays import FloatArray
from calib.gaze.aim import Aiming
from calib.gaze.centre import (
    CLEARANCE_STEPS,
    GazeState,
    Law,
    Move,
    Rest,
    begin,
    clearance,
    decide,
)
from calib.gaze.row import (
    GazeRow,
    SeenTarget,
    TargetScatter,
    make_row,
    refuse_moved,
    refuse_unsteady,
)
from calib.gaze.target import Target
from calib.geometry.camera import Camera, normalise
from calib.rig.clock import NS_PER_S
from calib.rig.devices import RigDevices
from calib.rig.protocols import Camera as CameraDevice
from calib.rig.protocols import Frame, Lost, Nanoseconds, Refused, Standstill
from calib.rig.settings import AxisSection

TIMEOUT_S: Final = 3.0
"""A frame that takes longer will not come."""

PICTURES_C1, PICTURES_C2 = 2, 3
"""Pictures of C1 before and after, and of C2 between; one more of C2 ends the row."""

NEXT_NS: Final = 1_000_000
"""The next picture begins so much after the last at least: no camera takes a thousand a second."""

SAME_FRAME_TRIES: Final = 5


def law_of(rig: RigDevices, lens_c2: Camera, *, backlash_steps: float = 0.0) -> Law:
    """Return the law for a rig: at whole steps of the motor where it counts its own steps.

    Parameters
    ----------
    backlash_steps
        As `calib rig check` measured it, in motor steps.
    """
    axis, section = rig.axis, rig.settings.axis
    width = lens_c2.image_size[0]
    edges = normalise(
        lens_c2,
        np.array([[0.0, lens_c2.matrix[1, 2]], [width - 1.0, lens_c2.matrix[1, 2]]]),
        strict=False,
    )[:, 0]
    seen = np.arctan(edges) if np.isfinite(edges).all() else np.array([-0.35, 0.35])
    step, origin = axis.step_rad, None
    if rests_on_whole_steps(section):
        step = math.radians(section.full_step_deg or 0.0)
        standing = axis.standstill()
        origin = standing.reading_rad - standing.counts * axis.resolution_rad
    return Law(
        step_rad=step,
        range_rad=axis.range_rad,
        field_rad=float(seen[1] - seen[0]),
        clearance_rad=clearance(backlash_steps, axis.step_rad),
        origin_rad=origin,
    )


def rests_on_whole_steps(section: AxisSection) -> bool:
    """Return whether C2 is to rest at whole steps of the motor: nothing reads its microsteps."""
    return section.reads == "counts" and section.full_step_deg is not None


@dataclass
class Gazer:
    """A rig that gazes at one kind of target.

    Parameters
    ----------
    rig
        Its devices.
    target
        What is gazed at.
    lens_c2
        C2's lens, by which the angle off its centre column is measured.
    law
        How it is centred.
    lens_c1
        C1's lens, for targets that a lens bends.
    settle_s
        C2 trembles so long after it stands still, as `calib rig check` measured it, s.
    noise_c1, noise_c2
        Scatter of the target's coordinates so far.
    """

    rig: RigDevices
    target: Target
    lens_c2: Camera
    law: Law
    lens_c1: Camera | None = None
    settle_s: float = 0.0
    noise_c1: TargetScatter = field(default_factory=TargetScatter)
    noise_c2: TargetScatter = field(default_factory=TargetScatter)

    def find_in_c1(self) -> SeenTarget:
        """Return where C1 sees the target now.

        Raises
        ------
        Refused
            If it does not.
        """
        return self.pictures(self.rig.c1, self.rig.clock.now_ns(), 1)[0]

    def gaze(self, aiming: Aiming, *, depth_mm: float | None = None) -> GazeRow:
        """Turn C2 to the target and return what is read.

        Parameters
        ----------
        depth_mm
            Depth at which it is expected, mm.

        Raises
        ------
        RigError
            If there is no row to be had; the message says why.
        """
        before = self._before()
        aim = aiming.aim(_mean(before), depth_mm=depth_mm)
        state, standing, first = self._centre(aim_at=begin(self.law, aim, self._standing()))
        return self._row(before, standing, first, moves=state.moves, looks=state.looks)

    def gaze_from(self, reading_rad: float) -> GazeRow:
        """Turn C2 to a reading, whatever it then sees, and return what is read there.

        Raises
        ------
        RigError
            If there is no row to be had; the message says why.
        """
        before = self._before()
        standing = self.stand_at(reading_rad)
        first = self.look(self.rig.c2, self.at_rest(standing))
        if first is None:
            raise Refused(self.unseen("C2"))
        return self._row(before, standing, first, moves=1, looks=0)

    def stand_at(self, reading_rad: float) -> Standstill:
        """Turn C2 to a reading, from as far below as play asks for."""
        far_below = max(self.law.clearance_rad, CLEARANCE_STEPS * self.rig.axis.step_rad)
        via = max(self.law.range_rad[0], reading_rad - far_below)
        return self._go(Move(reading_rad, via))

    def _before(self) -> tuple[SeenTarget, ...]:
        return self.pictures(self.rig.c1, self.rig.clock.now_ns(), PICTURES_C1)

    def _row(
        self,
        before: tuple[SeenTarget, ...],
        standing: Standstill,
        first: SeenTarget,
        *,
        moves: int,
        looks: int,
    ) -> GazeRow:
        """Take the pictures of a row where C2 stands, and return it."""
        c2 = (first, *self.pictures(self.rig.c2, _next(first), PICTURES_C2 - 1))
        after = self.pictures(self.rig.c1, _next(c2[-1]), PICTURES_C1)
        c2 = (*c2, *self.pictures(self.rig.c2, _next(after[-1]), 1))
        self.refuse_turned(standing)
        refuse_moved("C1", before, after, self.noise_c1)
        refuse_unsteady("C1", (*before, *after), self.noise_c1)
        refuse_unsteady("C2", c2, self.noise_c2)
        row = make_row(
            standing,
            c1=(*before, *after),
            c2=c2,
            noise_c1=self.noise_c1.after((*before, *after)),
            noise_c2=self.noise_c2.after(c2),
            moves=moves,
            looks=looks,
        )
        self.noise_c1 = self.noise_c1.after(row.c1)
        self.noise_c2 = self.noise_c2.after(row.c2)
        return row

    def _standing(self) -> Standstill:
        return self.rig.axis.standstill()

    def _centre(
        self, *, aim_at: tuple[GazeState, Move]
    ) -> tuple[GazeState, Standstill, SeenTarget]:
        """Carry out the law; return how it ended, where C2 stands, and the picture that said so."""
        state, move = aim_at
        while True:
            standing = self._go(move)
            seen = self.look(self.rig.c2, self.at_rest(standing))
            residual = None if seen is None else self.residual(seen.observation.pixel)
            state, then = decide(state, standing.reading_rad, residual)
            if isinstance(then, Rest) and seen is not None:
                return state, standing, seen
            if isinstance(then, Move):
                move = then

    def at_rest(self, standing: Standstill) -> Nanoseconds:
        """Return when C2 trembles no more."""
        return standing.since_ns + round(self.settle_s * NS_PER_S)

    def _go(self, move: Move) -> Standstill:
        if move.via_rad is not None:
            self.rig.axis.move(move.via_rad, approach=0)
        return self.rig.axis.move(move.reading_rad, approach=1)

    def residual(self, pixel_c2: FloatArray) -> float | None:
        """Return the angle from C2's centre column to a pixel, (2,), rad; None without ray."""
        x = normalise(self.lens_c2, pixel_c2[None], strict=False)[0, 0]
        return float(np.arctan(x)) if np.isfinite(x) else None

    def refuse_turned(self, standing: Standstill) -> None:
        """Refuse a row through which C2 did not stand still.

        Raises
        ------
        Refused
            With the counts.
        """
        now = self.rig.axis.standstill()
        # An encoder on the edge between two counts reads either.
        spare = 0 if standing.source == "counts" else 1
        if now.home != standing.home or abs(now.counts - standing.counts) > spare:
            raise Refused(
                f"C2 turned while it was looked through: {standing.counts} counts before, "
                f"{now.counts} after; is another program driving it, does the cable pull?"
            )

    def pictures(
        self, camera: CameraDevice, moment: Nanoseconds, count: int
    ) -> tuple[SeenTarget, ...]:
        """Return so many different pictures of the target, the first exposed after `moment`."""
        found: list[SeenTarget] = []
        while len(found) < count:
            last = found[-1] if found else None
            frame = self._frame(camera, _next(last) if last else moment, last)
            seen = self._seen(camera, frame)
            if seen is None:
                why = self._target(camera).fault(frame.pixels)
                raise Refused(self.unseen("C1" if camera is self.rig.c1 else "C2", why))
            found.append(seen)
        return tuple(found)

    def look(
        self, camera: CameraDevice, moment: Nanoseconds, last: SeenTarget | None = None
    ) -> SeenTarget | None:
        """Return a picture with the target, another one than `last`; None if it is not in it."""
        return self._seen(camera, self._frame(camera, moment, last))

    def _frame(self, camera: CameraDevice, moment: Nanoseconds, last: SeenTarget | None) -> Frame:
        for _ in range(SAME_FRAME_TRIES):
            frame = camera.after(moment, timeout_s=TIMEOUT_S)
            if last is None or frame.serial != last.frame.serial:
                return frame
            moment = frame.exposed_ns + NEXT_NS
        raise Lost(f"{camera.identity} hands out one and the same frame again and again")

    def _seen(self, camera: CameraDevice, frame: Frame) -> SeenTarget | None:
        age = (self.rig.clock.now_ns() - frame.exposed_ns) / 1e6
        observation = self._target(camera).find(frame.pixels)
        return None if observation is None else SeenTarget(frame, observation, age)

    def _target(self, camera: CameraDevice) -> Target:
        lens = self.lens_c1 if camera is self.rig.c1 else self.lens_c2
        return self.target if lens is None else self.target.through(lens)

    def unseen(self, name: str, why: str = "") -> str:
        """Return the message about a camera that does not see the target."""
        if why:
            return f"{name}: {why}"
        return (
            f"{name} does not see the target {self.target.name}; is it in the picture, sharp, "
            "evenly lit, and the one that is asked for?"
        )


def _next(seen: SeenTarget) -> Nanoseconds:
    return seen.frame.exposed_ns + NEXT_NS


def _mean(seen: tuple[SeenTarget, ...]) -> FloatArray:
    mean: FloatArray = np.mean([s.observation.pixel for s in seen], axis=0)
    return mean
