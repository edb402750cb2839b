"""The virtual motor and what it turns: pulses, rotor, play, C2. Truth that drivers see none of.

Positions are in motor steps from the zero of the factory; the yaw is what an encoder without error
would read, rad. A move is a ramp up, a run and a ramp down.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.rig.clock import NS_PER_S
from calib.rig.protocols import Nanoseconds

SPEED_RAD_S: Final = math.radians(60.0)
ACCELERATION_RAD_S2: Final = math.radians(600.0)
"""A small stepper with a light camera."""

RINGING_HZ: Final = 17.0
_KEPT: Final = 4096
"""Moves remembered; frames look back a few."""


@dataclass(frozen=True)
class Drive:
    """Constants of the motor and its drive train.

    Parameters
    ----------
    step_rad
        One motor step, rad.
    steps_per_full
        Steps in a full step of the motor.
    microstep_error
        Amplitude, share of a full step.
    microstep_phase
        Phase, rad.
    backlash_steps
        Play; C2 is where the rotor is after an approach with growing readings.
    ringing_s
        Time constant; 0 for none.
    reversed
        Whether C2 turns the other way than positions grow.
    """

    step_rad: float
    steps_per_full: float
    microstep_error: float = 0.0
    microstep_phase: float = 0.0
    backlash_steps: float = 0.0
    ringing_s: float = 0.0
    reversed: bool = False


@dataclass(frozen=True)
class _Piece:
    """Constant acceleration from `start_s` on, steps and seconds."""

    start_s: float
    position: float
    speed: float
    acceleration: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed."""
        t = time_s - self.start_s
        return (
            self.position + (self.speed + self.acceleration * t / 2) * t,
            self.speed + self.acceleration * t,
        )


@dataclass(frozen=True)
class Ramp:
    """One move of the pulses: from `start` to `end` within `duration_s` of `start_ns`."""

    start_ns: Nanoseconds
    start: float
    end: float
    duration_s: float
    pieces: tuple[_Piece, ...]

    def at(self, moment: Nanoseconds) -> tuple[float, float]:
        """Return position, steps, and speed, steps/s."""
        time_s = (moment - self.start_ns) / NS_PER_S
        if time_s <= 0:
            return self.start, 0.0
        if time_s >= self.duration_s:
            return self.end, 0.0
        return next(p for p in reversed(self.pieces) if p.start_s <= time_s).at(time_s)

    @property
    def end_ns(self) -> Nanoseconds:
        """When the pulses end."""
        return self.start_ns + math.ceil(self.duration_s * NS_PER_S)


def ramp(start_ns: Nanoseconds, start: float, end: float, step_rad: float) -> Ramp:
    """Return the move from rest to rest."""
    fast, push = SPEED_RAD_S / step_rad, ACCELERATION_RAD_S2 / step_rad
    way = abs(end - start)
    sign = math.copysign(1.0, end - start)
    rising_s = min(fast / push, math.sqrt(way / push))
    top = push * rising_s
    running_s = max(0.0, (way - top * rising_s) / fast) if way else 0.0
    up, down = top * rising_s / 2, top * rising_s / 2
    pieces = (
        _Piece(0.0, start, 0.0, sign * push),
        _Piece(rising_s, start + sign * up, sign * top, 0.0),
        _Piece(rising_s + running_s, end - sign * down, sign * top, -sign * push),
    )
    return Ramp(start_ns, start, end, 2 * rising_s + running_s, pieces)


def braked(move: Ramp, moment: Nanoseconds, step_rad: float, grid: float) -> Ramp:
    """Return how a move ends that is stopped at `moment`, on the controller's grid, steps."""
    position, speed = move.at(moment)
    if speed == 0:
        return replace(move, end=position, duration_s=0.0, start=position, start_ns=moment)
    sign = math.copysign(1.0, speed)
    way = speed**2 / 2 / (ACCELERATION_RAD_S2 / step_rad)
    end = sign * math.ceil((sign * position + way) / grid) * grid
    slowing = speed**2 / 2 / max(abs(end - position), 1e-9)
    piece = _Piece(0.0, position, speed, -sign * slowing)
    return Ramp(moment, position, end, abs(speed) / slowing, (piece,))


@dataclass(frozen=True)
class _Motion:
    """A move with what it does to rotor and C2: pulses lost before and during, C2 before it."""

    ramp: Ramp
    lost: float
    losing: float
    load: float


class Mechanics:
    """Where motor and C2 are at any moment. May be asked by threads while another commands."""

    def __init__(self, drive: Drive, *, grid: float) -> None:
        self.drive = drive
        self.grid = grid
        still = Ramp(0, 0.0, 0.0, 0.0, ())
        self._motions = [_Motion(still, 0.0, 0.0, self._micro(0.0))]
        self._lock = threading.RLock()  # a signal may stop the motor while it is commanded

    def start(self, moment: Nanoseconds, end: float, *, losing: float = 0.0) -> Ramp:
        """Drive the pulses to `end`, steps; `losing` of them do not turn the rotor."""
        with self._lock:
            self._end_at(moment)
            last = self._motions[-1]
            begin = last.ramp.at(moment)[0]
            move = ramp(moment, begin, end, self.drive.step_rad)
            self._add(_Motion(move, last.lost + last.losing, losing, self._load(last, moment)))
            return move

    def stop(self, moment: Nanoseconds) -> None:
        """Brake."""
        with self._lock:
            self._end_at(moment)

    def _end_at(self, moment: Nanoseconds) -> None:
        begun = [motion for motion in self._motions if motion.ramp.start_ns <= moment]
        # What was to come, such as a stop by another hand, does not.
        self._motions = begun or self._motions[:1]
        last = self._motions[-1]
        if moment >= last.ramp.end_ns:
            return
        short = braked(last.ramp, moment, self.drive.step_rad, self.grid)
        self._add(_Motion(short, self._lost(last, moment), 0.0, self._load(last, moment)))

    def _add(self, motion: _Motion) -> None:
        self._motions = [*self._motions[-_KEPT:], motion]

    def moving(self, moment: Nanoseconds) -> bool:
        """Return whether pulses are given."""
        return moment < self._motions[-1].ramp.end_ns

    def pulses(self, moment: Nanoseconds) -> float:
        """Return the position as the controller counts it, steps."""
        return self._at(moment).ramp.at(moment)[0]

    def rotor(self, moment: Nanoseconds) -> float:
        """Return where the rotor is, steps."""
        return self._rotor(self._at(moment), moment)

    def load(self, moment: Nanoseconds) -> float:
        """Return where C2 is, steps, behind the play."""
        motion = self._at(moment)
        return self._load(motion, moment) + self._ringing(motion, moment)

    def yaw(self, moment: Nanoseconds) -> float:
        """Return C2's true yaw, as a reading without error, rad."""
        turn = self.load(moment) * self.drive.step_rad
        return math.pi / 2 + (-turn if self.drive.reversed else turn)

    def _at(self, moment: Nanoseconds) -> _Motion:
        motions = self._motions
        for motion in reversed(motions):
            if motion.ramp.start_ns <= moment:
                return motion
        return motions[0]

    def _lost(self, motion: _Motion, moment: Nanoseconds) -> float:
        way = motion.ramp.end - motion.ramp.start
        if not motion.losing or not way:
            return motion.lost
        gone = (motion.ramp.at(moment)[0] - motion.ramp.start) / way
        return motion.lost + motion.losing * gone

    def _rotor(self, motion: _Motion, moment: Nanoseconds) -> float:
        pulses = motion.ramp.at(moment)[0]
        return pulses - self._lost(motion, moment) + self._micro(pulses)

    def _micro(self, pulses: float) -> float:
        full = self.drive.steps_per_full
        phase = 2 * math.pi * pulses / full + self.drive.microstep_phase
        return self.drive.microstep_error * full * math.sin(phase)

    def _load(self, motion: _Motion, moment: Nanoseconds) -> float:
        rotor = self._rotor(motion, moment)
        return min(max(motion.load, rotor), rotor + self.drive.backlash_steps)

    def _ringing(self, motion: _Motion, moment: Nanoseconds) -> float:
        since = (moment - motion.ramp.end_ns) / NS_PER_S
        if not self.drive.ringing_s or since <= 0 or motion.ramp.start == motion.ramp.end:
            return 0.0
        away = np.exp(-since / self.drive.ringing_s)
        return float(away * math.sin(2 * math.pi * RINGING_HZ * since))
