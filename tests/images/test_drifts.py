"""Crops that differ and a rig that drifts. Evidence: simulated truth, negative controls."""

from __future__ import annotations

from dataclasses import replace

import board_scenes as scenes
import numpy as np
import pytest
from test_joint_lenses import BOTH, Scene

from calib.core.arrays import FloatArray
from calib.geometry.camera import normalise
from calib.images.joint.drifts import centre_shifts, pose_drift
from calib.images.joint.gather import gather
from calib.images.joint.solve import JointSolve, solve_joint
from calib.images.pairs import start_pairs
from calib.images.stereo.gates import steady_gates


def joint_of(
    seed: int, *, crop_px: tuple[float, float] = (0.0, 0.0), drift_rad: float = 0.0
) -> JointSolve:
    """Pairs of C1 from another crop, or C2 turning about its y axis from the first to the last."""
    scene = Scene(4, pairs=12, lens=12, rows=6)
    rng = np.random.default_rng(seed)
    pairs, extra = scene.noisy(rng)
    one = replace(pairs[0], pixels=pairs[0].pixels + np.array(crop_px))
    two = turning(pairs[1].pixels, drift_rad)
    pairs = one, replace(pairs[1], pixels=two)
    cameras = (scenes.C1, scenes.C2)
    start = start_pairs(pairs, scenes.BOARD, cameras=cameras)
    return solve_joint(*gather(start, pairs, extra, scenes.BOARD, cameras=cameras, free=BOTH))


def turning(pixels: FloatArray, drift_rad: float) -> FloatArray:
    """What C2 sees when it turns about its y axis evenly, by so much in all."""
    turned = pixels.copy()
    for i, angle in enumerate(np.linspace(-0.5, 0.5, len(pixels)) * drift_rad):
        xy = normalise(scenes.C2, pixels[i])
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        matrix = scenes.matrix(np.array([0, angle, 0, 0, 0, 0]))[:3, :3]
        turned[i] = scenes.project(scenes.C2, rays @ matrix.T)
    return turned


def failed(joint: JointSolve) -> dict[str, str]:
    gates = steady_gates(centre_shifts(joint), pose_drift(joint))
    return {gate.name: gate.detail for gate in gates if not gate.passed}


def test_chi_squared_without_change_is_that_of_chance() -> None:
    joints = [joint_of(seed) for seed in range(5)]
    drifts = [drift.chi2 for joint in joints if (drift := pose_drift(joint)) is not None]
    shifts = [shift.chi2 for joint in joints for shift in centre_shifts(joint)]
    assert len(drifts) == 5
    assert 2.5 < np.mean(drifts) < 10.5  # 6 expected, standard error 1.5
    assert 1.0 < np.mean(shifts) < 3.4  # 2 expected
    assert not any(failed(joint) for joint in joints)


def test_another_crop_of_the_pairs_is_named() -> None:
    joint = joint_of(20, crop_px=(24.0, -16.0))
    (gate,) = [text for name, text in failed(joint).items() if name == "c1-pairs-crop"]
    assert "another crop" in gate
    shift = next(s for s in centre_shifts(joint) if (s.camera, s.kind) == ("c1", "pair"))
    assert shift.shift_px == pytest.approx([24.0, -16.0], abs=6.0)


def test_a_rig_that_creeps_is_named_with_its_turn() -> None:
    joint = joint_of(21, drift_rad=2e-3)
    assert "creeps" in failed(joint)["stereo-steady"]
    drift = pose_drift(joint)
    assert drift is not None
    assert drift.chi2 > 2 * drift.limit
    assert np.linalg.norm(drift.turn_rad) == pytest.approx(2e-3, rel=0.25)
