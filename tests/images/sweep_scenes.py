"""Sweeps of simulated rigs, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable

import board_scenes as scenes
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import camera_from_vector, intrinsic_vector
from calib.geometry.parameters import INDEX
from calib.geometry.poses import pose_vector
from calib.images.sweep.model import ENCODER
from calib.images.sweep.solve import SweepReadings
from calib.images.sweep.yaw_axis import SweepResult, yaw_sweep
from calib.simulate.rig import TrueRig, c2_pose, draw_rig

SIGMA_PX = 0.1
LENS_STD = np.array([0.4, 0.4, 0.5, 0.5, 0.004, 0.02, 1e-4, 1e-4, 0.03])
WIDE = np.deg2rad(np.linspace(70, 110, 17))
NARROW = np.deg2rad(np.linspace(89, 91, 17))

Edit = Callable[[Corners, SweepReadings], tuple[Corners, SweepReadings]]


def unchanged(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
    return found, shown


def drawn_rig(rng: np.random.Generator) -> TrueRig:
    """A rig with every error that a sweep can meet, the encoder's drawn from their priors."""
    encoder = {p.name: rng.normal(0, p.prior_std) for p, _ in ENCODER if p.prior_std}
    return draw_rig(rng, model="axis-tilt", fixed=encoder)


def solve(
    rng: np.random.Generator,
    rig: TrueRig,
    *,
    readings: FloatArray = WIDE,
    sigma_px: float = SIGMA_PX,
    lens_std: FloatArray = LENS_STD,
    board: Board = scenes.BOARD,
    edit: Edit = unchanged,
) -> SweepResult:
    """Sweep a rig, with C2's intrinsics off the truth by their uncertainty."""
    scene = scenes.sweep(rng, rig, readings=readings, board=board)
    found = scenes.noisy(rng, scene.found, sigma_px)
    shown = SweepReadings(scene.alpha2_rad, scene.placements, rig.resolution_rad, 0.0)
    found, shown = edit(found, shown)
    drawn = intrinsic_vector(rig.c2) + lens_std * rng.normal(size=9)
    return yaw_sweep(
        found,
        shown,
        board,
        camera=camera_from_vector(drawn, rig.c2.image_size),
        covariance=np.diag(lens_std**2),
        pose_12=pose_vector(c2_pose(rig, np.array(1.5))),
    )


def true_values(rig: TrueRig, names: tuple[str, ...]) -> FloatArray:
    return rig.theta[[INDEX[name] for name in names]]
