"""Guides of pairs and of the sweep, at corner level. Evidence: simulated truth."""

from __future__ import annotations

import numpy as np
import pytest
from held_boards import filled, rig_of, seen

from calib.capture.guidance.need import Need
from calib.capture.guidance.pairs import LensSays, PairGuide, by_tape, holding_reading
from calib.capture.guidance.sweep import SweepGuide
from calib.geometry.parameters import INDEX
from calib.geometry.poses import pose_matrix, pose_vector
from calib.simulate.rig import c2_pose, yaw_axis_in_c2

NEED = Need()


def in_c2(rig, reading, pose):
    """Return the pose in C2 of a board at a pose in C1, shape (6,)."""
    stands = c2_pose(rig, np.array([reading]))[0]
    return pose_vector(np.linalg.inv(stands) @ pose_matrix(pose))


def test_pairs_find_the_pose_of_c2_whichever_end_it_reads():
    rig, board = rig_of(1)
    rng = np.random.default_rng(1)
    reading = holding_reading(NEED, 200.0)
    lenses = LensSays(rig.c1, None), LensSays(rig.c2, None)
    guide = PairGuide(board, lenses, by_tape(200.0, reading), NEED)
    assert not guide.is_done
    for k in range(4):
        asked = guide.ask()
        pose = filled(rig.c1, board, asked.corners_px, rng)
        one = seen(rig.c1, board, pose, rng)
        two = seen(rig.c2, board, in_c2(rig, reading, pose), rng)
        turned = type(two)(two.corners[::-1], two.edge_px) if k % 2 else two
        guide.take({"c1": one, "c2": turned})
        if k:
            assert guide.u == pytest.approx(asked.u_then, rel=0.4)
    assert guide.is_done
    true = pose_vector(c2_pose(rig, np.array([reading]))[0])
    at = guide.known.problem.at_pose
    covariance = guide.known.covariance()[np.ix_(at, at)]
    off = guide.known.at.shared[at] - true
    # 99.9 % of chi squared with 6 degrees of freedom.
    assert off @ np.linalg.solve(covariance, off) < 22.5


def test_a_sweep_of_two_placements_finds_the_axis():
    rig, board = rig_of(2)
    rng = np.random.default_rng(2)
    guide = SweepGuide(
        board, rig.c2, np.zeros((9, 9)), range_rad=rig.yaw_range_rad,
        resolution_rad=1.6e-4, u_alpha2_rad=0.0, need=NEED,
    )  # fmt: skip
    pixels, readings, placements = [], [], []
    for k in range(2):
        middle = guide.middle_rad
        asked = guide.ask()
        held = filled(rig.c2, board, asked.corners_px, rng)
        view = seen(rig.c2, board, held, rng)
        guide.take({"c2": view})
        in_c1 = pose_vector(c2_pose(rig, np.array([middle]))[0] @ pose_matrix(held))
        for reading in guide.readings(view.corners):
            pixels.append(seen(rig.c2, board, in_c2(rig, reading, in_c1), rng).corners)
            readings.append(reading)
            placements.append(str(k))
        guide.solve(np.array(pixels), np.array(readings), tuple(placements))
    assert guide.u < asked.u_now
    assert guide.is_done == (guide.u <= guide.needed)
    std = np.sqrt(np.diag(np.linalg.inv(guide._information)))
    foot = yaw_axis_in_c2(rig).foot_mm
    assert std[2] < 0.5
    assert rig.theta[INDEX["eccentricity_mm"]] == pytest.approx(-foot[0], abs=1.0)
