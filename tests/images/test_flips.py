"""Pictures turned or mirrored afterwards. Evidence: simulated truth, negative controls."""

from __future__ import annotations

from dataclasses import replace

import board_scenes as scenes
import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.geometry.board import Corners
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.flips import flipped_pictures, way_gate

CAMERA = replace(scenes.C1, matrix=np.array([[820.0, 0, 646], [0, 822, 473], [0, 0, 1]]))
POINTS = scenes.BOARD.object_points()
SIZE = np.array([1279.0, 959.0])


def drawn(seed: int, sigma_px: float) -> Corners:
    rng = np.random.default_rng(seed)
    found: list[FloatArray] = []
    while len(found) < 20:
        pose = scenes.board_pose(rng, scenes.BOARD, depth=(400, 900), tilt=0.6, spread=0.35)
        pixels = scenes.project(CAMERA, POINTS @ scenes.matrix(pose)[:3, :3].T + pose[3:])
        if np.isfinite(pixels).all():
            found.append(pixels)
    return scenes.noisy(rng, scenes.corners(CAMERA, found), sigma_px)


def named(corners: Corners) -> dict[str, str]:
    fit = fit_opencv(corners, scenes.BOARD, lens="plumb-bob")
    return flipped_pictures(corners, scenes.BOARD, fit, points=POINTS, factor=1.0)


def test_pictures_turned_by_half_a_turn_are_named() -> None:
    corners = drawn(0, 0.05)
    corners.pixels[:7] = SIZE - corners.pixels[:7]
    assert named(corners) == {f"{i:02d}.png": "turned by 180 deg" for i in range(7)}


def test_mirrored_pictures_are_named() -> None:
    corners = drawn(1, 0.05)
    for i in (4, 9):
        view = corners.pixels[i].copy()
        view[:, 0] = SIZE[0] - view[:, 0]
        # A detector counts the corners of what it sees, as of a real board.
        corners.pixels[i] = view.reshape(6, 9, 2)[:, ::-1].reshape(-1, 2)
    found = named(corners)
    assert found == {"04.png": "mirrored left to right", "09.png": "mirrored left to right"}
    gate = way_gate("c1", found, 20)
    assert not gate.passed
    assert "2 of 20 pictures" in gate.detail
    assert "mirrored left to right: 04.png, 09.png" in gate.detail


@pytest.mark.parametrize("seed", range(6))
def test_good_pictures_are_not_named(seed: int) -> None:
    """Negative control, 120 pictures."""
    assert named(drawn(10 + seed, (0.0, 0.05, 0.3)[seed % 3])) == {}
    assert way_gate("c1", {}, 20).passed
