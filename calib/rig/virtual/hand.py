"""A hand that holds the board before the virtual rig as an outline in a picture asks for.

It knows the picture alone: the board goes where its image fills the outline, whatever lens is
between, and misses by as much as a person does. It sways before it is at rest.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.poses import pose_matrix
from calib.rig.virtual.world import CameraName, World
from calib.simulate.rig import c2_pose

MISSED_DEG: Final = 3.0
MISSED_SHARE: Final = (0.01, 0.01, 0.02)
"""Standard deviations by which the outline is missed: each turn, and x, y and z in parts of z."""

SWAY_MM, SWAY_S = 15.0, 0.15
"""How far the board is from its rest as it comes, and how long it takes to come to rest."""

GENTLER: Final = 0.5
"""Factor on what is missed when the hand tries again."""


class Hand:
    """Holds the board of a virtual rig.

    Parameters
    ----------
    world
        Where it stands.
    done
        So many times it has been held before, by whoever went on from there.
    """

    def __init__(self, world: World, *, done: int = 0) -> None:
        self._world = world
        self._rng = np.random.default_rng([world.settings.virtual.seed, 17, done])

    def hold(self, camera: CameraName, corners_px: FloatArray, *, tries: int = 0) -> None:
        """Hold the board so that a camera sees its corners at pixels, shape (corners, 2).

        Parameters
        ----------
        tries
            How often it was tried before: each time with more care.
        """
        world = self._world
        lens = world.rig.c1 if camera == "c1" else world.rig.c2
        points = world.board.object_points()
        _, turn, shift = cv2.solvePnP(points, corners_px, lens.matrix, lens.distortion)
        pose = pose_matrix(np.concatenate([turn.ravel(), shift.ravel()]))
        pose = self._missed(pose, points.mean(axis=0), care=GENTLER**tries)
        if camera == "c2":
            now = world.yaw(world.clock.now_ns())
            pose = c2_pose(world.rig, np.array([now]))[0] @ pose
        away = self._rng.standard_normal(3)
        away *= SWAY_MM / np.linalg.norm(away)

        def motion(seconds: float) -> FloatArray:
            moved = pose.copy()
            moved[:3, 3] += away * max(0.0, 1 - seconds / SWAY_S) ** 2
            return moved

        world.follow(motion)

    def _missed(self, pose: FloatArray, middle: FloatArray, *, care: float) -> FloatArray:
        """Return a pose, shape (4, 4), missed as a hand does, turned about the board's middle."""
        at = pose[:3, :3] @ middle + pose[:3, 3]
        turn = np.radians(MISSED_DEG) * care * self._rng.standard_normal(3)
        off = care * np.array(MISSED_SHARE) * at[2] * self._rng.standard_normal(3)
        missed = np.eye(4)
        missed[:3, :3] = cv2.Rodrigues(turn)[0] @ pose[:3, :3]
        missed[:3, 3] = at + off - missed[:3, :3] @ middle
        return missed
