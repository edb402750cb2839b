"""What the tests of the stereo reference share: cameras known and drawn, noisy corners."""

from __future__ import annotations

import board_scenes as scenes
import numpy as np

from calib.geometry.board import Corners
from calib.images.stereo.solve import CameraPair

SIGMA_PX = 0.1
LENS_COVARIANCE = np.diag([0.4, 0.4, 0.5, 0.5, 0.004, 0.02, 1e-4, 1e-4, 0.03]) ** 2
"""Of intrinsics as a good set of images tells them."""

KNOWN = CameraPair((scenes.C1, scenes.C2), (np.zeros((9, 9)), np.zeros((9, 9))))
"""Both cameras, without any error."""


def noisy(rng: np.random.Generator, scene: scenes.Pairs) -> tuple[Corners, Corners]:
    """Return the corners of both cameras with normal errors."""
    return scenes.noisy(rng, scene.c1, SIGMA_PX), scenes.noisy(rng, scene.c2, SIGMA_PX)
