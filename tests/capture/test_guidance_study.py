"""Twelve guided pictures against twenty-five chosen by bars of coverage.

Evidence: simulated truth, 20 rigs, corners with 0.1 px of noise, hands that miss the outline.
"""

from __future__ import annotations

import numpy as np
import pytest
from held_boards import SIZE, filled, rig_of, seen
from test_lens_guide import true_error_px

from calib.capture.guidance.lens import LensGuide
from calib.capture.guidance.need import Need
from calib.geometry.camera import project
from calib.geometry.poses import pose_vector, transform
from calib.simulate.scene import _intrinsic_candidate, whole_board_seen

RIGS, GUIDED, BY_BARS = 20, 12, 25

DIFFERENT = 0.2
"""Sum of differences of the four bars by which a picture is new, as ROS' camera_calibration has."""


def bars(corners, board):
    """Return X, Y, size and skew of a board in the picture, each from 0 to 1."""
    grid = corners.reshape(board.rows, board.columns, 2)
    ends = grid[0, 0], grid[0, -1], grid[-1, -1], grid[-1, 0]
    x, y = np.array(ends).T
    area = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
    border = np.sqrt(area)
    place = (corners.mean(axis=0) - border / 2) / (np.array(SIZE) - border)
    one, other = ends[0] - ends[1], ends[2] - ends[1]
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    skew = min(1.0, 2 * abs(np.pi / 2 - np.arccos(np.clip(cosine, -1, 1))))
    return np.array([*np.clip(place, 0, 1), np.sqrt(area / (SIZE[0] * SIZE[1])), skew])


def by_bars(rig, board, rng):
    """Return corners of pictures that differ by the bars, of poses held at random."""
    taken, known = [], []
    while len(taken) < BY_BARS:
        pose = _intrinsic_candidate(rig.c1, board, rng, (10.0, 40.0))
        if not whole_board_seen(rig.c1, board, pose[None])[0]:
            continue
        corners = project(rig.c1, transform(pose_vector(pose), board.object_points()))
        four = bars(corners, board)
        if all(np.abs(four - other).sum() > DIFFERENT for other in known):
            known.append(four)
            taken.append(corners + rng.normal(0, 0.1, corners.shape))
        elif rng.random() < 0.02:
            known = known[1:]  # room for more once the bars are full
    return taken


def both(seed):
    """Return u of both ways and their true errors, px."""
    rig, board = rig_of(seed)
    rng = np.random.default_rng([seed, 3])
    guides = [LensGuide("c1", board, SIZE, needed_rad=Need().lens_px(1.0)) for _ in range(2)]
    for _ in range(GUIDED):
        asked = guides[0].ask()
        pose = filled(rig.c1, board, asked.corners_px, rng)
        guides[0].take({"c1": seen(rig.c1, board, pose, rng)})
    guides[1].add(*by_bars(rig, board, rng))
    return [(guide.u, true_error_px(guide, rig.c1)) for guide in guides]


@pytest.mark.slow
def test_twelve_guided_pictures_are_worth_twenty_five_by_bars():
    found = np.array([both(seed) for seed in range(RIGS)])
    u, error = found[..., 0], found[..., 1]
    assert (u[:, 0] <= u[:, 1]).mean() >= 0.95
    assert np.median(u[:, 0]) < np.median(u[:, 1])
    # What is stated is true: the mean square of 20 ratios, some six degrees of freedom each.
    assert np.sqrt(np.mean((error / u) ** 2, axis=0)).min() > 0.8
    assert np.sqrt(np.mean((error / u) ** 2, axis=0)).max() < 1.2
