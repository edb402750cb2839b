"""95 % intervals of gazed depths hold what they say, for every kind of reading.

Evidence: simulated truth over many rigs. Each is checked as `calib rig check` does, its zero is
found by gazes at known targets, then other targets are measured: what is left is the rows' own
noise and the zero's, which is all that gazing answers for. Pictures of the many rigs are not
rendered (see `unrendered`); rendered rigs are held against those.
"""

from __future__ import annotations

import numpy as np
import pytest
from true_instrument import aiming, gazer, measuring
from unrendered import unrendered_rig

from calib.gaze.measured import position, positions
from calib.rig.check import check_rig
from calib.rig.protocols import RigError
from calib.rig.virtual.operator import Operator
from tests.rig.virtual_rigs import virtual_rig

RIGS, KNOWN, GAZES = 100, 12, 10
RENDERED = 8
STEP = {"step_deg": 0.05625, "full_step_deg": 0.9}
FINE = {"resolution_deg": 0.009, **STEP}
KINDS = {
    "load encoder": ({"reads": "load encoder", **FINE}, {"backlash_steps": 3.0}),
    "motor encoder": ({"reads": "motor encoder", **FINE}, {"backlash_steps": 3.0}),
    "counts": (
        {"reads": "counts", "resolution_deg": 0.05625, "step_deg": 0.05625, "full_step_deg": None},
        {"backlash_steps": 3.0, "microstep_error": 0.05},
    ),
    "whole steps": (
        {"reads": "counts", "resolution_deg": 0.05625, **STEP},
        {"backlash_steps": 3.0, "microstep_error": 0.05},
    ),
}  # fmt: skip

MOST = {"counts": 1.0}
"""Microsteps err as a sine, never beyond its amplitude of 1.4 standard uncertainties: 1.96 of
them, as of a normal error, hold it nearly always. Too long, which does no harm; an interval that
counts on the sine would be too short for a motor whose errors are no sine."""


def study(seed, axis, virtual, *, opened=virtual_rig):
    """Return the scores (z - truth) / u of one rig, whether the intervals hold, and median u/z."""
    with opened(axis=axis, seed=seed, **virtual) as rig:
        hand = Operator(rig.world)
        hand.show_gaze()
        check = check_rig(rig, rig.world.board)
        assert check.failed == ()
        eye = gazer(rig, backlash_steps=check.backlash_steps, settle_s=check.settle_s)
        known = _gazed(rig, hand, eye, KNOWN)
        turned, plain = (
            positions(
                measuring(rig, u_alpha2_deg=check.u_alpha2_deg, zero=(zero, 0.0)),
                [row for row, _ in known],
                model="selected",
            ).position_mm[:, 2]
            for zero in (1e-5, 0.0)
        )
        zeros = (np.array([true for _, true in known]) - plain) / (turned - plain) * 1e-5
        spread = float(np.std(zeros, ddof=1) / np.sqrt(len(zeros)))
        instrument = measuring(
            rig, u_alpha2_deg=check.u_alpha2_deg, zero=(float(zeros.mean()), spread)
        )
        scores, held, relative = [], [], []
        for row, true in _gazed(rig, hand, eye, GAZES):
            found = position(instrument, row, model="selected")
            scores.append((found.position_mm[0, 2] - true) / found.std_mm[0, 2])
            held.append(bool(found.low95_mm[0] <= true <= found.high95_mm[0]))
            relative.append(found.std_mm[0, 2] / true)
    return scores, held, float(np.median(relative))


def _gazed(rig, hand, eye, count):
    """Gaze at so many targets; return the rows with the true depths."""
    rows = []
    for _ in range(count):
        hand.show_gaze()
        try:
            row = eye.gaze(aiming(rig))
        except RigError:
            continue
        rows.append((row, float(rig.world.target(row.c2[-1].frame.exposed_ns)[2])))
    return rows


def rms(scores):
    return float(np.sqrt(np.mean(np.square(scores))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold(kind, record_property):
    rigs = [study(seed, *KINDS[kind], opened=unrendered_rig) for seed in range(1, RIGS + 1)]
    scores, held = (np.concatenate([rig[k] for rig in rigs]) for k in (0, 1))
    share = float(np.mean(held))
    record_property("share", share)
    record_property("rms", rms(scores))
    assert len(held) > 0.9 * RIGS * GAZES
    # Of 1,000 intervals that hold 95 % the share has a binomial standard deviation of 0.7 %, over
    # rigs, whose ten share one zero, up to 0.8: 93 and 97 % are 2.6 of them away at least.
    assert 0.93 <= share <= MOST.get(kind, 0.97), share
    assert np.abs(scores).max() < 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_rendered_rigs_err_as_those_without_pictures(kind):
    """The same rigs both ways: rows are as uncertain, and err as much for it."""
    both = [
        [study(seed, *KINDS[kind], opened=opened) for seed in range(1, RENDERED + 1)]
        for opened in (virtual_rig, unrendered_rig)
    ]
    scores = [np.concatenate([rig[0] for rig in rigs]) for rigs in both]
    ratios = [full[2] / fast[2] for full, fast in zip(*both, strict=True)]
    assert 0.85 < np.median(ratios) < 1.15
    # The ratio of two roots of mean squares of 80 scores scatters by 11 %.
    assert 0.7 < rms(scores[0]) / rms(scores[1]) < 1.4
