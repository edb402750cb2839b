"""Boards held before cameras at corner level, for tests of guides; no picture is rendered."""

from __future__ import annotations

import cv2
import numpy as np

from calib.capture.shutter import View
from calib.geometry.camera import Camera, project
from calib.geometry.poses import transform
from calib.simulate.rig import Noise, draw_rig
from calib.simulate.scene import fitting_board

SIZE = (640, 480)


def rig_of(seed):
    """Return a rig of 200 mm and its board."""
    rng = np.random.default_rng(seed)
    rig = draw_rig(
        rng, model="axis-offset", fixed={"baseline_mm": 200.0}, image_size=SIZE, noise=Noise(0.0)
    )
    return rig, fitting_board(rig, near_mm=1000.0)


def filled(camera: Camera, board, corners_px, rng):
    """Return the pose at which a hand fills an outline, missed as a person does, shape (6,)."""
    points = board.object_points()
    _, turn, shift = cv2.solvePnP(points, corners_px, camera.matrix, camera.distortion)
    pose = np.concatenate([turn.ravel(), shift.ravel()])
    pose[:3] += rng.normal(0, 0.05, 3)
    pose[3:] += rng.normal(0, 0.01, 3) * pose[5]
    return pose


def seen(camera: Camera, board, pose, rng, *, noise_px=0.1):
    """Return what a camera sees of a board at a pose: every corner, with noise."""
    corners = project(camera, transform(pose, board.object_points()))
    return View(corners + rng.normal(0, noise_px, corners.shape), 1.5)
