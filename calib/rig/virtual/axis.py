"""The virtual motor controller, and the yaw axis on top of it.

Only what a controller sends crosses over to the driver: its own step count, an encoder's count and
whether it believes that it moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from calib.dataset.fields import Positive
from calib.rig.clock import NS_PER_S, Clock, wait
from calib.rig.options import Options, options
from calib.rig.protocols import Nanoseconds, YawAxis
from calib.rig.settings import AxisSection
from calib.rig.stepped import OVERSHOOT_STEPS, AxisScale, State, SteppedAxis
from calib.rig.virtual.mechanics import Drive, Mechanics
from calib.rig.virtual.settings import VirtualSettings
from calib.rig.virtual.world import World

GRID_PER_FULL: Final = 256
"""Positions that a controller tells apart in a full step, as nearly as whole steps allow."""

ANSWER_S: Final = 0.001
"""Time that a question to the controller takes."""

LOST_FULL_STEPS: Final = 4
"""A motor that falls out of step locks in again four full steps, one electrical turn, further."""

NS_PER_H: Final = 3600 * NS_PER_S

HOMING_ERROR_STEPS: Final = 0.3
HOMING_ERROR_COUNTS: Final = 0.5
"""Standard deviations of where a switch finds the mark, and an encoder its index."""


class VirtualController:
    """A stepper's controller, with an encoder or without, and all that may be wrong with it."""

    def __init__(
        self, mechanics: Mechanics, settings: VirtualSettings, section: AxisSection, clock: Clock
    ) -> None:
        self._mechanics = mechanics
        self._settings = settings
        self._section = section
        self._clock = clock
        self._rng = np.random.default_rng([settings.seed, 7])
        self._pulse_zero = 0.0
        self._encoder_zero = 0.0
        self._homings = 0

    @property
    def home_name(self) -> str:
        """What identifies the reference run in force."""
        return f"{self._settings.seed}-{self._homings}"

    def start(self, steps: float) -> None:
        """Begin to move to a position."""
        self._tick()
        goal = self._on_grid(steps) + self._pulse_zero
        now = self._clock.now_ns()
        way = goal - self._mechanics.pulses(now)
        loses, is_stopped = self._rng.random(2) < (
            self._settings.lost_steps_share,
            self._settings.stopped_share,
        )
        most = LOST_FULL_STEPS * self._mechanics.drive.steps_per_full
        losing = math.copysign(min(most, abs(way)), way) if loses else 0.0
        move = self._mechanics.start(now, goal, losing=losing)
        if is_stopped:
            self._mechanics.stop(now + round(self._rng.uniform() * move.duration_s * NS_PER_S))

    def _on_grid(self, steps: float) -> float:
        degrees = steps * math.degrees(self._mechanics.drive.step_rad)
        units = degrees / math.degrees(self._mechanics.drive.step_rad * self._mechanics.grid)
        if self._settings.truncated:
            # Single precision puts whole steps to either side of a whole number.
            return (
                math.trunc(float(np.float32(units) * np.float32(1 - 1e-7))) * self._mechanics.grid
            )
        return round(units) * self._mechanics.grid

    def state(self) -> State:
        """Ask for the position."""
        self._tick()
        now = self._clock.now_ns()
        early = round(self._settings.early_done_ms * 1e6)
        pulses = self._mechanics.pulses(now) - self._pulse_zero
        return State(pulses, self._encoder(now), self._mechanics.moving(now + early))

    def _encoder(self, now: Nanoseconds) -> int | None:
        if self._section.reads == "counts":
            return None
        angle = math.degrees(
            (self._read(now) - self._encoder_zero) * self._mechanics.drive.step_rad
        )
        noise = self._settings.encoder_noise_deg * self._rng.standard_normal()
        return round((angle + noise) / self._section.resolution_deg)

    def _read(self, now: Nanoseconds) -> float:
        """Return what the encoder sits on, steps."""
        if self._section.reads == "load encoder":
            return self._mechanics.load(now)
        return self._mechanics.rotor(now)

    def stop(self) -> None:
        """Stop at once."""
        self._mechanics.stop(self._clock.now_ns())

    def home(self) -> str:
        """Find the mark on C2's side, from below."""
        for goal in (-20.0, 0.0):
            self.start(goal)
            while self._mechanics.moving(self._clock.now_ns()):
                wait(self._clock, 0.005)
        now = self._clock.now_ns()
        mark = self._mechanics.load(now)
        first, second = self._rng.standard_normal(2)
        self._pulse_zero = self._mechanics.pulses(now) - mark + HOMING_ERROR_STEPS * float(first)
        count = math.radians(self._section.resolution_deg) / self._mechanics.drive.step_rad
        self._encoder_zero = self._read(now) - mark + HOMING_ERROR_COUNTS * count * float(second)
        self._homings += 1
        return self.home_name

    def close(self) -> None:
        """Nothing to let go of."""

    def _tick(self) -> None:
        wait(self._clock, ANSWER_S)


def mechanics(section: AxisSection, settings: VirtualSettings) -> Mechanics:
    """Return the motor of the settings, at rest at 90 degrees."""
    step = section.step_deg or section.resolution_deg
    per_full = (section.full_step_deg or 16 * step) / step
    phase = np.random.default_rng([settings.seed, 8]).uniform(0, 2 * math.pi)
    drive = Drive(
        step_rad=math.radians(step),
        steps_per_full=per_full,
        microstep_error=settings.microstep_error,
        microstep_phase=float(phase),
        backlash_steps=settings.backlash_steps,
        ringing_s=settings.ringing_ms / 1e3,
        reversed=settings.reversed,
    )
    return Mechanics(drive, grid=1 / max(1, round(GRID_PER_FULL / per_full)))


class AxisOptions(Options):
    """Keys of the driver: steps beyond a target from which it is approached."""

    overshoot_steps: Positive = OVERSHOOT_STEPS


def open_axis(settings: Mapping[str, Any]) -> YawAxis:
    """Open the axis of a virtual rig; the driver "virtual"."""
    own = options(AxisOptions, settings)
    world: World = settings["world"]
    section = world.settings.axis
    motor = mechanics(section, world.settings.virtual)
    begun, drift = world.clock.now_ns(), math.radians(world.settings.virtual.drift_deg_h)
    world.turn_by(lambda moment: motor.yaw(moment) + drift * (moment - begun) / NS_PER_H)
    controller = VirtualController(motor, world.settings.virtual, section, world.clock)
    low, high = section.range_deg
    scale = AxisScale(
        identity=f"virtual axis, rig {world.settings.serial}",
        source=section.reads,
        step_rad=motor.drive.step_rad,
        count_rad=math.radians(section.resolution_deg),
        counts_per_step=round(1 / motor.grid),
        zero_rad=math.pi / 2,
        range_rad=(math.radians(low), math.radians(high)),
        overshoot_steps=own.overshoot_steps,
    )
    return SteppedAxis(controller, scale, world.clock, controller.home_name)
