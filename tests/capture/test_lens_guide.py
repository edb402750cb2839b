"""The guide of a lens' pictures. Evidence: simulated truth, property, negative control."""

from __future__ import annotations

import numpy as np
import pytest
from held_boards import SIZE, filled, rig_of, seen

from calib.capture.guidance.lens import LensGuide
from calib.capture.guidance.need import Need
from calib.capture.guidance.poses import in_picture, rim
from calib.geometry.board import LensFit
from calib.geometry.camera import project
from calib.geometry.poses import transform
from calib.images.intrinsics.maps import GRID, LensRays, Nodes, _rays, _unit, compare


def guided(seed, views, *, noise_px=0.1):
    """Return a guide after some views as it asks for, what it promised, and the truth."""
    rig, board = rig_of(seed)
    rng = np.random.default_rng(seed + 100)
    guide = LensGuide("c1", board, SIZE, needed_rad=Need().lens_px(1.0))
    promised = []
    for _ in range(views):
        asked = guide.ask()
        pose = filled(rig.c1, board, asked.corners_px, rng)
        guide.take({"c1": seen(rig.c1, board, pose, rng, noise_px=noise_px)})
        promised.append((asked.u_then, guide.u))
    return guide, promised, rig.c1


def true_error_px(guide, camera):
    """Return the rms length of the projection's error over the imager, rotation taken off, px."""
    width, height = SIZE
    grid = np.meshgrid(np.linspace(0, width - 1, GRID[1]), np.linspace(0, height - 1, GRID[0]))
    at = Nodes(np.stack(grid, axis=-1), np.ones(GRID, dtype=bool))
    found = guide.camera
    n = 4 + len(found.distortion)
    fit = LensFit("guide", "plumb-bob", found, np.eye(n) * 1e-12, 0.0,
                  np.zeros((1, 1, 2)), np.zeros((1, 6)), 0)  # fmt: skip
    rays = _unit(_rays(camera, at.pixels.reshape(-1, 2))).reshape(*GRID, 3)
    return compare(fit, LensRays("true", rays, np.zeros(GRID)), at).rms_px


def test_what_is_promised_is_kept_and_the_stated_u_is_the_true_error():
    errors = []
    for seed in range(3):
        guide, promised, camera = guided(seed, 8)
        for then, came in promised[3:]:
            assert came == pytest.approx(then, rel=0.25)
        assert guide.u < 0.25
        errors.append(true_error_px(guide, camera) / guide.u)
    # The mean square of three ratios, each of some six degrees of freedom.
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_poses_asked_for_show_the_whole_board_and_differ():
    rig, board = rig_of(1)
    poses = in_picture(rig.c1, board)
    assert len(poses) > 100
    for pose in poses[:: len(poses) // 20]:
        pixels = project(rig.c1, transform(pose, rim(board)))
        assert ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all()
    guide, _, _ = guided(1, 6)
    first = guide.ask()
    guide.refuse()
    second = guide.ask()
    assert np.abs(first.corners_px - second.corners_px).max() > 10


def test_it_ends_by_what_is_known_not_by_a_number():
    noisy, _, _ = guided(2, 8, noise_px=0.5)
    assert not noisy.is_done
    assert noisy.u > noisy.needed
    clean, _, _ = guided(2, 8, noise_px=0.03)
    assert clean.is_done
    lax = LensGuide("c1", clean.board, SIZE, needed_rad=1.0)
    lax.add(*clean.views[:5])
    assert not lax.is_done, "the chain takes no fewer than six"


def test_a_picture_of_the_middle_is_worth_little():
    guide, _, camera = guided(3, 6)
    asked = guide.ask()
    rng = np.random.default_rng(5)
    pose = filled(camera, guide.board, asked.corners_px, rng)
    assert guide.worth(seen(camera, guide.board, pose, rng).corners) > 0.5
    middle = np.array([0.0, 0, 0, -180, -140, 2500])
    far = seen(camera, guide.board, middle, rng)
    assert guide.worth(far.corners) < 0.2
    view = {"c1": far}
    guide.fault(view)
    assert guide.fault(view) == "it brings too little: fill the outline"
