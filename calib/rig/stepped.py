"""The yaw axis of any controller that takes absolute positions: what decides whether a move counts.

A controller's "done" is not believed. After it the position is read until two readings agree, and
then held against the command: by the controller's own steps, which tell a move that another hand
stopped, and by the encoder, which tells a motor that stalled or lost steps. A motor with an encoder
that came to rest elsewhere is sent on a few times; one that counts its own steps cannot know.
"""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Literal, Protocol

from calib.rig.clock import NS_PER_S, Clock, wait
from calib.rig.protocols import (
    Interrupted,
    Nanoseconds,
    ReadingSource,
    Refused,
    Stalled,
    Standstill,
)

OVERSHOOT_STEPS: Final = 8
"""Steps by which the axis goes past before it comes back in the asked direction; more than the
backlash of common worm and belt drives. rig.toml's `overshoot_steps` says another."""

POLL_S: Final = 0.005
SETTLE_S: Final = 0.02
"""Between two readings that have to agree: an axis still creeping by a count of 0.009 deg in this
time would have to turn at 0.45 deg/s, slower than a ramp passes through."""

SETTLE_TIMEOUT_S: Final = 3.0
CORRECTIONS: Final = 3
"""Times that an axis with an encoder is sent on; slip and play are taken up by the first."""


@dataclass(frozen=True)
class State:
    """What a controller tells about itself at one moment.

    Parameters
    ----------
    steps
        The motor's position as the controller counts its own pulses, steps from the zero.
    counts
        The encoder, whole counts; None where only steps are counted.
    moving
        Whether the controller says that it drives the motor.
    """

    steps: float
    counts: int | None
    moving: bool


class Controller(Protocol):
    """A motor controller with absolute positions in steps from its zero."""

    def start(self, steps: float) -> None:
        """Begin to move to a position; return at once."""

    def state(self) -> State:
        """Ask for the position.

        Raises
        ------
        Lost
            If it does not answer.
        """

    def stop(self) -> None:
        """Stop at once."""

    def home(self) -> str:
        """Find the reference mark, blocking; return what identifies this reference run."""

    def close(self) -> None:
        """Let go of the device."""


@dataclass(frozen=True)
class AxisScale:
    """How an axis' readings hang together with what its controller counts.

    Parameters
    ----------
    identity
        Maker, model and serial number.
    source
        What is read.
    step_rad
        Smallest move, rad.
    count_rad
        One count of what is read, rad; counts of 0 steps is `zero_rad`.
    counts_per_step
        For axes without an encoder: what a step is divided into when the position is read back.
    zero_rad
        Reading at the controller's zero, rad.
    range_rad
        Readings within reach, rad.
    overshoot_steps
        Distance beyond a target from which it is approached.
    speed_rad_s
        Slowest speed of a move, rad/s: one that takes three times as long has stalled.
    """

    identity: str
    source: ReadingSource
    step_rad: float
    count_rad: float
    zero_rad: float
    range_rad: tuple[float, float]
    counts_per_step: int = 1
    overshoot_steps: float = OVERSHOOT_STEPS
    speed_rad_s: float = 0.05


@dataclass(frozen=True)
class _Rest:
    state: State
    counts: int
    reading_rad: float
    since_ns: Nanoseconds


class SteppedAxis:
    """A `YawAxis` on top of a `Controller`.

    `stop` may be called from any thread; whatever ends a move early, an error of the program or a
    signal included, the motor is stopped first.
    """

    def __init__(self, controller: Controller, scale: AxisScale, clock: Clock, home: str) -> None:
        self._controller = controller
        self._scale = scale
        self._clock = clock
        self._home = home
        self._approached: Literal[-1, 1] = 1
        self._stopped = threading.Event()

    @property
    def identity(self) -> str:
        """Maker, model and serial number."""
        return self._scale.identity

    @property
    def resolution_rad(self) -> float:
        """One count of the reading, rad."""
        return self._scale.count_rad

    @property
    def step_rad(self) -> float:
        """Smallest move, rad."""
        return self._scale.step_rad

    @property
    def range_rad(self) -> tuple[float, float]:
        """Readings within reach, rad."""
        return self._scale.range_rad

    def move(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Standstill:
        """Go to the step nearest to a reading; see `calib.rig.protocols.YawAxis.move`."""
        self._check_range(reading_rad)
        self._stopped.clear()
        try:
            return self._standstill(self._arrive(reading_rad, approach))
        except BaseException:
            self._halt()
            raise

    def standstill(self) -> Standstill:
        """Read the axis where it is."""
        if self._controller.state().moving:
            raise Interrupted("the axis moves; wait for it, or stop it")
        return self._standstill(self._settled())

    def home(self) -> Standstill:
        """Find the reference mark; readings are of a new homing from now on."""
        self._stopped.clear()
        try:
            self._home = self._controller.home()
            self._approached = 1
            return self._standstill(self._settled())
        except BaseException:
            self._halt()
            raise

    def stop(self) -> None:
        """Stop at once."""
        self._stopped.set()
        self._controller.stop()

    def close(self) -> None:
        """Stop and let go of the device."""
        try:
            self.stop()
        finally:
            self._controller.close()

    def _check_range(self, reading_rad: float) -> None:
        low, high = self._scale.range_rad
        if not low <= reading_rad <= high:
            raise Refused(
                f"the axis is asked for {math.degrees(reading_rad):.3f} deg, outside its range of "
                f"{math.degrees(low):g} to {math.degrees(high):g} deg; move the target, or widen "
                "range_deg in rig.toml if the mount allows"
            )

    def _arrive(self, reading_rad: float, approach: Literal[-1, 0, 1]) -> _Rest:
        """Move until the reading is within a step of the command."""
        overshoot = self._scale.overshoot_steps
        rest = self._settled()
        for attempt in range(1 + CORRECTIONS):
            away = round((reading_rad - rest.reading_rad) / self._scale.step_rad)
            if attempt and abs(away) <= 1:
                return rest
            rest = self._go(rest, away, approach, overshoot)
            if self._scale.source == "counts":
                return rest
            # Play wider than the overshoot leaves the axis on the wrong side of it.
            overshoot *= 2
        off = (reading_rad - rest.reading_rad) / self._scale.step_rad
        if abs(off) < 1.5:
            return rest
        raise Stalled(
            f"the axis came to rest {off:+.1f} steps from its command after {1 + CORRECTIONS} "
            "attempts; look for a blocked mount, too high a speed, or a wrong step_deg"
        )

    def _go(self, rest: _Rest, away: int, approach: Literal[-1, 0, 1], overshoot: float) -> _Rest:
        """Move by so many steps and arrive from the asked side."""
        goal = round(rest.state.steps) + away
        turned = approach not in (0, self._approached)
        if approach and (away * approach < 0 or (turned and abs(away) < overshoot)):
            rest = self._leg(self._before(goal, approach, overshoot))
        if abs(goal - rest.state.steps) > 0.5:
            rest = self._leg(goal)
        return rest

    def _before(self, goal: int, approach: int, overshoot: float) -> int:
        """Return the step from which to approach, at the end of the range at the furthest."""
        low, high = ((r - self._scale.zero_rad) / self._scale.step_rad for r in self.range_rad)
        wanted = goal - approach * overshoot
        return round(min(max(wanted, low), high))

    def _leg(self, steps: int) -> _Rest:
        """Make one move and hold the controller's own steps against the command."""
        before = self._controller.state().steps
        self._controller.start(steps)
        self._wait_for_done(abs(steps - before) * self._scale.step_rad)
        rest = self._settled()
        if rest.state.steps != before:
            self._approached = 1 if rest.state.steps > before else -1
        if self._stopped.is_set():
            raise Interrupted("the move was stopped")
        if abs(rest.state.steps - steps) > 0.5:
            raise Interrupted(
                f"the axis stands {rest.state.steps - steps:+.1f} steps from the end of its move: "
                "it was stopped by another hand or a limit switch"
            )
        return rest

    def _wait_for_done(self, distance_rad: float) -> None:
        limit = 3 * distance_rad / self._scale.speed_rad_s + SETTLE_TIMEOUT_S
        deadline = self._clock.now_ns() + round(limit * NS_PER_S)
        while self._controller.state().moving:
            if self._stopped.is_set():
                raise Interrupted("the move was stopped")
            if self._clock.now_ns() > deadline:
                raise Stalled(f"the axis still moves after {limit:.1f} s; is its speed so low?")
            wait(self._clock, POLL_S)

    def _settled(self) -> _Rest:
        """Read until two readings agree; the axis is at rest since before the second."""
        deadline = self._clock.now_ns() + round(SETTLE_TIMEOUT_S * NS_PER_S)
        last = self._controller.state()
        while self._clock.now_ns() < deadline:
            wait(self._clock, SETTLE_S)
            asked = self._clock.now_ns()
            state = self._controller.state()
            if not state.moving and self._agree(last, state):
                counts = self._counts(state)
                return _Rest(state, counts, self._reading(counts), asked)
            last = state
        raise Stalled(
            f"two readings of the axis never agree within {SETTLE_TIMEOUT_S:g} s; look for another "
            "program that drives it, vibration, or noise of the encoder"
        )

    def _agree(self, first: State, second: State) -> bool:
        if first.counts is None or second.counts is None:
            return first.steps == second.steps
        return first.steps == second.steps and abs(first.counts - second.counts) <= 1

    def _counts(self, state: State) -> int:
        if state.counts is None:
            return round(state.steps * self._scale.counts_per_step)
        return state.counts

    def _reading(self, counts: int) -> float:
        if self._scale.source == "counts":
            return self._scale.zero_rad + counts / self._scale.counts_per_step * self.step_rad
        return self._scale.zero_rad + counts * self._scale.count_rad

    def _standstill(self, rest: _Rest) -> Standstill:
        return Standstill(
            reading_rad=rest.reading_rad,
            since_ns=rest.since_ns,
            source=self._scale.source,
            counts=rest.counts,
            approached=self._approached,
            home=self._home,
        )

    def _halt(self) -> None:
        """Stop after a failure without hiding it."""
        with suppress(Exception):
            self._controller.stop()
