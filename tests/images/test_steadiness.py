"""C1 turning in the course of the rows, lenses that breathe: what the adjustment makes of it.

Evidence: simulated truth, negative controls, derivatives by differences, a closed form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_scenes import project
from rig_sessions import Layout, Pictured, everything, session
from test_adjustment import adjusted, unknowns_of

from calib.core.arrays import FloatArray
from calib.geometry.camera import normalise
from calib.geometry.poses import rotation
from calib.images.adjustment.gates import STEADY, rig_gates
from calib.images.adjustment.gather import Swept
from calib.images.adjustment.mounting import RIG, pose_of, rig_by_turn_of_c1
from calib.images.joint.allowance import allowed
from calib.images.joint.reduced import Reduced, Unknowns

LAYOUT = Layout(rows=12, lens=8)
SIGMA_PX = 0.08


def turned_rows(pictured: Pictured, turn_rad: FloatArray) -> Pictured:
    """C1 turning evenly from the first row to the last, by so much in all."""
    exact = dict(pictured.exact)
    rows = [name for name in pictured.taken.rows.image_c1 if name is not None]
    for name, share in zip(rows, np.linspace(0, 1, len(rows)), strict=True):
        xy = normalise(pictured.rig.c1, exact[name])
        rays = np.column_stack([xy, np.ones(len(xy))])
        exact[name] = project(pictured.rig.c1, rays @ rotation(share * turn_rad).T)
    return replace(pictured, exact=exact)


def breathing(pictured: Pictured, share: float) -> Pictured:
    """C1 sees near boards larger, by so much from the farthest to the nearest."""
    exact, middle = dict(pictured.exact), pictured.rig.c1.matrix[:2, 2]
    own = [name for name, whose in pictured.cameras.items() if whose == "c1"]
    size = {name: float(np.std(exact[name], axis=0).mean()) for name in own}
    least, most = min(size.values()), max(size.values())
    for name in own:
        factor = 1 + share * (size[name] - least) / (most - least)
        exact[name] = middle + factor * (exact[name] - middle)
    return replace(pictured, exact=exact)


@pytest.fixture(scope="module")
def scene() -> Pictured:
    rng = np.random.default_rng(21)
    return session(rng, everything(rng), LAYOUT)


def test_a_turn_of_c1_moves_the_rig_as_differences_say() -> None:
    rng = np.random.default_rng(0)
    rig = replace(everything(rng), pitch_rad=0.02, height_mm=7.0)
    values = unknowns_of(rig)
    by_turn = rig_by_turn_of_c1(values)
    for k in range(3):
        turn = 1e-5 * np.eye(3)[k]
        for reading in (1.1, 1.5, 1.9):
            # At all readings alike: C2 and its axis move as one rigid body.
            moved = pose_of(values + by_turn @ turn, reading)
            wanted = np.eye(4)
            wanted[:3, :3] = rotation(turn)
            assert moved == pytest.approx(wanted @ pose_of(values, reading), abs=1e-6)
    assert len(by_turn) == len(RIG)


def test_c1_that_turns_by_a_fiftieth_of_a_degree_is_named_with_its_turn(scene: Pictured) -> None:
    turn = np.array([0.0, np.deg2rad(0.02), 0.0])
    found = adjusted(np.random.default_rng(1), turned_rows(scene, turn), sigma_px=SIGMA_PX)
    (gate,) = [gate for gate in rig_gates(found.gates) if gate.name == STEADY]
    assert not gate.passed
    assert "C1 or its mount creeps" in gate.detail
    y = float(gate.detail.split("(")[1].split(",")[1])
    assert y == pytest.approx(1e3 * turn[1], abs=0.15)
    assert "or the zero of the encoder does" in gate.detail


def test_c1_at_rest_is_not_named(scene: Pictured) -> None:
    found = adjusted(np.random.default_rng(2), scene, sigma_px=SIGMA_PX)
    assert found.passed
    assert [gate.name for gate in rig_gates(found.gates)] == [STEADY]


def test_without_pairs_the_adjustment_looks_for_breathing_itself(scene: Pictured) -> None:
    """The rows' boards stand at other distances than those of the lens pictures."""
    for share in (0.0, 0.02):
        own = breathing(scene, share)
        taken = replace(own.taken, pairs=(), held_rad=None, sweep=Swept())
        found = adjusted(np.random.default_rng(3), replace(own, taken=taken), sigma_px=SIGMA_PX)
        passed = {gate.name: gate.passed for gate in rig_gates(found.gates)}
        assert passed["c1-one-lens"] == (share == 0.0)


def test_allowance_is_that_of_the_closed_form() -> None:
    """One unknown x, two views that measure it with unit weight, the second moved by b."""
    scores = np.array([[-1.0], [1.0]])  # of x = 0, where the views say 1 and -1
    reduced = Reduced(Unknowns(np.zeros(1), np.zeros((2, 6))), np.ones((2, 1, 1)), scores, 2.0)
    way = np.array([[[0.0], [1.0]]])
    # Their difference, -2, has variance 2 and is b where nothing is known beforehand.
    for std in (0.1, 1.0, 1e6):
        found = allowed(reduced, way, np.array([std]), 1.0)
        share = std**2 / (std**2 + 2)
        assert found.mean_square[0, 0] == pytest.approx(2 * share + (2 * share) ** 2, rel=1e-6)
        assert found.covariance()[0, 0] == pytest.approx(found.mean_square[0, 0] / 4)
