"""The rig gazes: rows are right to within their uncertainty or refused with the reason.

Evidence: simulated truth, behind the protocols of devices.
"""

from __future__ import annotations

import numpy as np
import pytest
from true_instrument import aiming, gazer, measuring

from calib.gaze.following import Follower
from calib.gaze.measured import position
from calib.gaze.placing import set_swaying
from calib.rig.protocols import Interrupted, Lost, Refused, RigError, Stalled
from calib.rig.virtual.operator import Operator
from tests.rig.virtual_rigs import OPEN_LOOP, virtual_rig

U_LOAD_DEG = 0.009 / np.sqrt(12)

HOSTILE = {
    "frames": {
        "latency_frames": 4, "clock_offset_s": 3600.0, "clock_drift_ppm": 100.0,
        "dropped_share": 0.1, "torn_share": 0.1,
    },
    "motor": {
        "lost_steps_share": 0.05, "stopped_share": 0.05, "truncated": True, "backlash_steps": 10.0,
        "early_done_ms": 30.0,
    },
    "hand": {"moving_share": 0.5, "backlash_steps": 3.0, "latency_frames": 2},
}  # fmt: skip


def gazes(count, *, u_alpha2_deg=U_LOAD_DEG, **virtual):
    """Gaze at targets; return (z - truth) / u of each row, and why others were refused."""
    with virtual_rig(**virtual) as rig:
        hand, eye, where = Operator(rig.world), gazer(rig), aiming(rig)
        instrument = measuring(rig, u_alpha2_deg=u_alpha2_deg)
        scores, refused = [], []
        for _ in range(count):
            hand.show_gaze()
            try:
                row = eye.gaze(where)
            except RigError as error:
                refused.append(error)
                continue
            found = position(instrument, row, model="selected")
            true = rig.world.target(row.c2[-1].frame.exposed_ns)[2]
            scores.append((found.position_mm[0, 2] - true) / found.std_mm[0, 2])
        return np.array(scores), refused


def test_a_sound_rig_gazes_at_every_target():
    scores, refused = gazes(24)
    assert refused == []
    assert np.abs(scores).max() < 4
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.4


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_rigs_give_right_rows_or_say_why_not(kind):
    scores, refused = gazes(12, seed=2, **HOSTILE[kind])
    assert len(scores) >= 3
    assert np.abs(scores).max() < 5
    for error in refused:
        assert isinstance(error, Refused | Stalled | Interrupted | Lost)
        assert len(str(error)) > 30
    assert bool(refused) == (kind != "frames")


def test_frames_that_lie_about_their_moment_spoil_rows():
    """Negative control: it is the age of frames that makes rows right."""
    scores, refused = gazes(12, stale=True, early_done_ms=100.0)
    assert refused or np.abs(scores).max() > 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("seed", range(6))
def test_no_row_of_a_hostile_rig_is_far_off(kind, seed):
    scores, _ = gazes(36, seed=10 + seed, **HOSTILE[kind])
    assert np.abs(scores).max(initial=0) < 5


def test_a_left_rig_gazes_too():
    scores, refused = gazes(6, baseline_mm=-200.0)
    assert refused == []
    assert np.abs(scores).max() < 4


def test_whole_steps_leave_a_residual_that_is_measured():
    with virtual_rig(axis=OPEN_LOOP) as rig:
        hand, eye, where = Operator(rig.world), gazer(rig), aiming(rig)
        instrument = measuring(rig, u_alpha2_deg=0.0005)
        residuals = []
        for _ in range(6):
            hand.show_gaze()
            row = eye.gaze(where)
            steps = np.degrees(row.standstill.reading_rad - np.pi / 2) / 0.9
            assert steps == pytest.approx(round(steps), abs=1e-6)
            residuals.append(abs(eye.residual(row.pixel_c2)))
            found = position(instrument, row, model="selected")
            true = rig.world.target(row.c2[-1].frame.exposed_ns)[2]
            assert abs(found.position_mm[0, 2] - true) < 4 * found.std_mm[0, 2]
    assert max(residuals) > np.deg2rad(0.1)


def test_a_moving_target_is_followed():
    with virtual_rig() as rig:
        Operator(rig.world).show_gaze()
        eye, where = gazer(rig), aiming(rig)
        instrument = measuring(rig, u_alpha2_deg=U_LOAD_DEG)
        depth = position(instrument, eye.gaze(where), model="selected").position_mm[0, 2]
        set_swaying(rig)
        follower, scores, begun = Follower(eye, where), [], rig.clock.now_ns()
        for _ in range(20):
            row = follower.row(depth)
            found = position(instrument, row, model="selected")
            depth = found.position_mm[0, 2]
            true = rig.world.target(row.c2[0].frame.exposed_ns)
            scores.append((found.position_mm[0] - true) / found.std_mm[0])
        seconds = (rig.clock.now_ns() - begun) / 1e9
    assert np.abs(scores).max() < 4
    assert seconds < 20 * 0.6, "a row every move and a few frames"


def test_a_target_that_is_taken_away_is_named():
    with virtual_rig() as rig:
        Operator(rig.world).show_gaze()
        eye = gazer(rig)
        rig.world.remove()
        with pytest.raises(Refused, match="C1 does not see the target board"):
            eye.gaze(aiming(rig))
