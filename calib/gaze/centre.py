"""The law by which C2 is turned to a target: a pure state machine, which touches no device.

Each move is absolute and followed by rest, so the law has gain 1 and neither integral nor filter:
the angle r between C2's centre column and the target, measured at rest, is the next move. It ends
where another move could gain nothing; what is left of r is measured and belongs to the row.

An axis that counts its own steps without an encoder knows its microsteps badly. There C2 stops at
whole steps of the motor, where the error of microsteps is always the same, and r may be large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from calib.rig.protocols import Refused, Standstill

DEADBAND_STEPS: Final = 0.75
"""Residual at which the axis is left where it is. At half a step noise makes it step to and fro
for ever; at 0.75 it never does."""

MOVES_MAX: Final = 6
"""Times that C2 comes to rest on its way to one target; 99 of 100 gazes need fewer."""

LOOKS_MAX: Final = 4
"""Pictures without the target after which the search ends."""

CLEARANCE_STEPS: Final = 8.0
"""By so much at least an axis goes past its goal to come back from below."""

BACKLASH_FACTOR, BACKLASH_SPARE_STEPS = 1.5, 2.0
"""By how much more than the measured backlash it goes past."""


@dataclass(frozen=True)
class Law:
    """What holds for all gazes of a rig.

    Parameters
    ----------
    step_rad
        Distance between the places where C2 may rest, rad: the motor's step, or a whole step.
    range_rad
        Readings within reach, rad.
    field_rad
        C2's horizontal field of view, rad.
    clearance_rad
        Way below its goal from which C2 comes, rad; 0 leaves it to the axis.
    origin_rad
        Reading of one place where C2 may rest, rad; None where the axis may rest anywhere.
    moves_max, looks_max
        When to give up.
    """

    step_rad: float
    range_rad: tuple[float, float]
    field_rad: float
    clearance_rad: float = 0.0
    origin_rad: float | None = None
    moves_max: int = MOVES_MAX
    looks_max: int = LOOKS_MAX

    def place(self, reading_rad: float) -> float:
        """Return the reading nearest to `reading_rad` at which C2 may rest, rad."""
        if self.origin_rad is None:
            return reading_rad
        return self.origin_rad + self.step_rad * round(
            (reading_rad - self.origin_rad) / self.step_rad
        )


def clearance(backlash_steps: float, step_rad: float) -> float:
    """Return the way below its goal from which C2 is to come, rad; 0 if the axis' own will do."""
    wanted = BACKLASH_FACTOR * backlash_steps + BACKLASH_SPARE_STEPS
    return wanted * step_rad if wanted > CLEARANCE_STEPS else 0.0


@dataclass(frozen=True)
class Aim:
    """Where C2 is to look for a target.

    Parameters
    ----------
    first_rad
        Reading expected, rad.
    low_rad, high_rad
        Readings between which the target must be: those of its nearest and farthest depth, rad.
    """

    first_rad: float
    low_rad: float
    high_rad: float


@dataclass(frozen=True)
class Move:
    """Go to a reading and take a picture; `via_rad` is visited before, if it is given."""

    reading_rad: float
    via_rad: float | None = None


@dataclass(frozen=True)
class Rest:
    """C2 gazes at the target: take the row where it stands."""


@dataclass(frozen=True)
class GazeState:
    """How far a gaze is.

    Parameters
    ----------
    law, aim
        As given.
    at_rad
        Where C2 stands or was last sent, rad.
    moves, looks
        Moves made; pictures without the target.
    to_try
        Readings still to be looked from, in order, rad.
    """

    law: Law
    aim: Aim
    at_rad: float
    moves: int = 0
    looks: int = 0
    to_try: tuple[float, ...] = ()


def begin(law: Law, aim: Aim, standing: Standstill) -> tuple[GazeState, Move]:
    """Return the first move.

    Raises
    ------
    Refused
        If no reading at which the target can be is within reach.
    """
    low, high = max(aim.low_rad, law.range_rad[0]), min(aim.high_rad, law.range_rad[1])
    if low > high:
        raise Refused(
            f"the target needs readings between {_deg(aim.low_rad)} and {_deg(aim.high_rad)}, "
            f"outside the axis' range of {_deg(law.range_rad[0])} to {_deg(law.range_rad[1])}; "
            "move the target"
        )
    first = min(max(aim.first_rad, low), high)
    state = GazeState(law, aim, standing.reading_rad, to_try=_search(law, first, low, high))
    return _moved(state, first)


def decide(
    state: GazeState, reading_rad: float, residual_rad: float | None
) -> tuple[GazeState, Move | Rest]:
    """Return what to do after a picture of C2 at rest.

    Parameters
    ----------
    reading_rad
        Where C2 stands, rad.
    residual_rad
        Angle from its centre column to the target, rad; None if the target is not in the picture.

    Raises
    ------
    Refused
        If the target is not found, out of reach, or not centred by the last move.
    """
    law, state = state.law, replace(state, at_rad=reading_rad)
    if residual_rad is None:
        return _look_elsewhere(state)
    if abs(residual_rad) <= DEADBAND_STEPS * law.step_rad:
        return state, Rest()
    if state.moves >= law.moves_max:
        raise Refused(
            f"after {state.moves} moves the target is still {_deg(residual_rad)} off C2's centre "
            "column; does it move, is step_deg right, does the encoder count the right way, has "
            "the drive more play than overshoot_steps?"
        )
    return _moved(state, reading_rad + law.step_rad * round(residual_rad / law.step_rad))


def _look_elsewhere(state: GazeState) -> tuple[GazeState, Move]:
    state = replace(state, looks=state.looks + 1)
    if state.looks >= state.law.looks_max or not state.to_try or state.moves >= state.law.moves_max:
        raise Refused(
            f"C2 does not see the target in {state.looks} pictures between "
            f"{_deg(state.aim.low_rad)} and {_deg(state.aim.high_rad)}; is it hidden, out of "
            "focus, or nearer or farther than the rig works?"
        )
    return _moved(replace(state, to_try=state.to_try[1:]), state.to_try[0])


def _moved(state: GazeState, reading_rad: float) -> tuple[GazeState, Move]:
    """Return the move to the place nearest to a reading, from below where the law says so."""
    law = state.law
    goal = law.place(reading_rad)
    low, high = law.range_rad
    if not low <= goal <= high:
        raise Refused(
            f"the target needs a reading of {_deg(goal)}, outside the axis' range of {_deg(low)} "
            f"to {_deg(high)}; move the target"
        )
    via = None
    if law.clearance_rad and (goal < state.at_rad or state.moves == 0):
        via = max(low, goal - law.clearance_rad)
    return replace(state, moves=state.moves + 1), Move(goal, via)


def _search(law: Law, first: float, low: float, high: float) -> tuple[float, ...]:
    """Return readings half a field apart on either side of the first, the nearest first."""
    half = law.field_rad / 2
    beyond = []
    for i in range(1, law.looks_max + 1):
        beyond += [first + i * half, first - i * half]
    inside = [r for r in beyond if low - half / 2 <= r <= high + half / 2]
    return tuple(min(max(r, low), high) for r in inside)


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.3f} deg"
