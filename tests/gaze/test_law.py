"""The law by which C2 is turned to a target.

Evidence: simulated truth, on an axis that is nothing but numbers; the slow loop to and fro of a
deadband of half a step is the negative control.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.gaze import centre
from calib.gaze.centre import Aim, Law, Move, Rest, begin, clearance, decide
from calib.rig.protocols import Refused, Standstill

STEP = math.radians(0.05625)
RANGE = (math.radians(40), math.radians(140))
LAW = Law(step_rad=STEP, range_rad=RANGE, field_rad=math.radians(50))


def standing(reading: float) -> Standstill:
    return Standstill(reading, 0, "load encoder", round(reading / STEP), 1, "a")


def gaze(
    law: Law, aim: Aim, truth: float, *, start=math.pi / 2, noise=0.0, seen_within=None, rng=None
):
    """Carry the law out on an axis that goes where it is sent; return what came of it."""
    state, then = begin(law, aim, standing(start))
    visited = []
    while isinstance(then, Move):
        visited.append(then)
        at = then.reading_rad
        residual = truth - at + (noise * rng.standard_normal() if rng is not None else 0.0)
        seen = abs(residual) < (seen_within or law.field_rad / 2)
        state, then = decide(state, at, residual if seen else None)
    assert isinstance(then, Rest)
    return state, visited


def around(reading: float, half: float = 0.1) -> Aim:
    return Aim(reading, reading - half, reading + half)


def test_it_rests_within_three_quarters_of_a_step_and_never_hunts():
    rng = np.random.default_rng(1)
    for _ in range(300):
        truth = rng.uniform(1.2, 1.9)
        aim = around(truth + rng.normal(0, 0.03), 0.2)
        state, visited = gaze(LAW, aim, truth, noise=1e-4, rng=rng)
        assert state.moves <= 3
        assert abs(truth - visited[-1].reading_rad) <= 0.75 * STEP + 5e-4


def test_a_deadband_of_half_a_step_hunts_for_ever(monkeypatch):
    monkeypatch.setattr(centre, "DEADBAND_STEPS", 0.45)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(100):
        truth = 1.5 + rng.uniform(0, STEP)
        first = 1.5 + STEP * rng.integers(-5, 5)
        try:
            gaze(LAW, around(first), truth, noise=5e-4, rng=rng)
        except Refused:
            refused += 1
    assert refused > 3


def test_it_comes_from_below_with_more_than_the_backlash():
    law = Law(STEP, RANGE, math.radians(50), clearance_rad=clearance(10.0, STEP))
    assert law.clearance_rad > 10 * STEP
    _, visited = gaze(law, around(1.5), 1.45, start=1.6)
    for move in visited:
        assert move.via_rad == pytest.approx(move.reading_rad - law.clearance_rad)
    _, visited = gaze(law, around(1.45), 1.5, start=1.6)
    assert visited[1].via_rad is None, "upwards it comes from below already"
    assert clearance(2.0, STEP) == 0, "the axis' own overshoot is enough"


def test_an_open_loop_axis_rests_at_whole_steps():
    full = 16 * STEP
    origin = math.pi / 2 + 0.3 * STEP
    law = Law(full, RANGE, math.radians(50), origin_rad=origin)
    for truth in np.linspace(1.3, 1.4, 23):
        state, visited = gaze(law, around(truth + 0.02), truth)
        steps = (visited[-1].reading_rad - origin) / full
        assert steps == pytest.approx(round(steps), abs=1e-9)
        assert abs(truth - visited[-1].reading_rad) <= 0.75 * full
        assert state.moves <= 3


def test_it_looks_along_the_interval_and_then_gives_up():
    aim = Aim(1.5, 0.9, 2.2)
    field = math.radians(20)
    law = Law(STEP, RANGE, field)
    state, visited = gaze(law, aim, 1.5 + 1.7 * field, seen_within=field)
    assert 1 <= state.looks <= 3
    assert visited[1].reading_rad == pytest.approx(1.5 + field / 2)
    with pytest.raises(Refused, match="does not see the target in 4 pictures"):
        gaze(law, aim, 3.0, seen_within=field / 4)


def test_a_target_out_of_range_is_refused_before_and_on_the_way():
    with pytest.raises(Refused, match="outside the axis' range of 40"):
        begin(LAW, Aim(2.8, 2.7, 2.9), standing(1.5))
    with pytest.raises(Refused, match="needs a reading of 143"):
        gaze(LAW, Aim(2.4, 1.9, 2.6), math.radians(143), seen_within=1.0)


def test_a_reversed_encoder_is_refused_after_six_moves():
    state, then = begin(LAW, around(1.5), standing(1.5))
    for _ in range(5):
        state, then = decide(state, then.reading_rad, then.reading_rad - 1.505)
    with pytest.raises(Refused, match="after 6 moves the target is still"):
        decide(state, then.reading_rad, then.reading_rad - 1.505)
