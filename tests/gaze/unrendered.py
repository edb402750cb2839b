"""Virtual rigs whose pictures are not rendered: each is the list of corners that would be found.

Everything else is the loop as it stands: world, clock, frames and their ages, motor, play,
microsteps, the check of the rig, the law of gazing, rows and their noise. In place of rendering and
detection corners err as on rendered pictures: by an error that stays while target and camera rest,
as large as `calib.gaze.target.CORNER_FLOOR` (that was measured on pictures), and by one that is
drawn anew for each picture. `test_coverage` holds this against rendered rigs.
"""

from __future__ import annotations

import math
import zlib
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from calib.gaze import target as targets
from calib.gaze.target import CORNER_FLOOR
from calib.geometry.camera import project
from calib.rig import looking
from calib.rig.virtual.world import World
from tests.rig.virtual_rigs import virtual_rig

PICTURE_NOISE_PX = 0.01
"""Standard deviation of a corner from picture to picture; rendered, 64 targets: 0.009 to 0.011."""


@dataclass(frozen=True)
class _Corners:
    pixels: np.ndarray


def _picture(world, camera, begin_ns, exposure_ns, rng):
    """Return the corners of the board, px, shape (corners, 2), NaN if it is not whole in view."""
    board = world.board
    points = board.object_points()
    lens = world.rig.c1 if camera == "c1" else world.rig.c2
    pose = world.seen(camera, begin_ns + exposure_ns // 2)
    nowhere = np.full((len(points), 2), np.nan)
    if pose is None:
        return nowhere
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    if seen[:, 2].min() <= 0:
        return nowhere
    pixels = project(lens, seen)
    grid = pixels.reshape(board.rows, board.columns, 2)
    spacing = float(np.median(np.hypot(*np.diff(grid, axis=1).reshape(-1, 2).T)))
    inside = (pixels > spacing) & (pixels < np.array(lens.image_size) - 1 - spacing)
    if not inside.all():
        return nowhere
    constant, linear, square = CORNER_FLOOR
    floor = math.hypot(constant, linear / spacing, square / spacing**2)
    resting = np.random.default_rng(zlib.crc32(pixels.round(6).tobytes()))
    return (
        pixels
        + floor * resting.standard_normal(pixels.shape)
        + PICTURE_NOISE_PX * rng.standard_normal(pixels.shape)
    )


@contextmanager
def unrendered_rig(**settings):
    """Open a virtual rig as `virtual_rig` does, without rendering."""
    found = lambda grey, board: _Corners(grey)  # noqa: ARG005, E731 - stands for a detector
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(World, "picture", _picture)
        patch.setattr(targets, "find_chessboard", found)
        patch.setattr(looking, "find_chessboard", found)
        with virtual_rig(**settings) as rig:
            yield rig
