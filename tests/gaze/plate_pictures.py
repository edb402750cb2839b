"""Pictures of a plate, ray by ray: nothing of the product's renderer or lens is used."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry.camera import Camera

LENGTH, HEIGHT = 1400.0, 300.0
WALL, METAL = 70.0, 170.0
FINE = 3
CORNER = {
    "left-upper": (0.0, 0.0), "right-upper": (LENGTH, 0.0),
    "left-lower": (0.0, HEIGHT), "right-lower": (LENGTH, HEIGHT),
}  # fmt: skip


def camera(k1: float = 0.0) -> Camera:
    matrix = np.array([[1000.0, 0, 319.5], [0, 1000.0, 239.5], [0, 0, 1]])
    return Camera(matrix, np.array([k1, 0, 0, 0, 0]), (640, 480))


@cache
def _rays(k1: float) -> np.ndarray:
    """Return the rays of all samples of a picture, shape (n, 3)."""
    lens = camera(k1)
    width, height = lens.image_size
    u, v = np.meshgrid(
        (np.arange(width * FINE) + 0.5) / FINE - 0.5, (np.arange(height * FINE) + 0.5) / FINE - 0.5
    )
    bent = (np.stack([u.ravel(), v.ravel()], axis=1) - lens.matrix[:2, 2]) / lens.matrix[0, 0]
    rays = bent
    for _ in range(8 if k1 else 0):
        rays = bent / (1 + k1 * (rays**2).sum(axis=1, keepdims=True))
    return np.column_stack([rays, np.ones(len(rays))])


def picture(
    lens: Camera, pose: np.ndarray, rng: np.random.Generator, *,
    radius: float = 0.0, wall: float = WALL, metal: float = METAL, noise: float = 2.0,
    bevel_mm: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Return a picture of the plate, whose frame has x along it and y down, posed in the camera."""
    width, height = lens.image_size
    rays = _rays(float(lens.distortion[0])) @ pose[:3, :3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    scale = -centre[2] / rays[:, 2]
    x, y = centre[0] + scale * rays[:, 0], centre[1] + scale * rays[:, 1]
    a = np.abs(x - LENGTH / 2) - LENGTH / 2 + radius
    b = np.abs(y - HEIGHT / 2) - HEIGHT / 2 + radius
    outside = (
        np.hypot(np.maximum(a, 0), np.maximum(b, 0)) + np.minimum(np.maximum(a, b), 0) - radius
    )
    grey = np.where((outside < 0) & (scale > 0), metal, wall)
    if bevel_mm:
        grey = np.where((np.abs(outside + bevel_mm / 2) < bevel_mm / 2) & (scale > 0), 250.0, grey)
    grey = cv2.resize(
        grey.reshape(height * FINE, width * FINE).astype(np.float32),
        (width, height),
        interpolation=cv2.INTER_AREA,
    )
    grey = cv2.GaussianBlur(grey, (0, 0), 0.7) + rng.normal(0, noise, (height, width))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def drawn_pose(rng: np.random.Generator, which: str, *, depth_mm: float) -> np.ndarray:
    """Return a pose that shows one end of the plate, its corner near the picture's centre."""
    turn = Rotation.from_euler(
        "yxz", [rng.uniform(-50, 50), rng.uniform(-15, 15), rng.uniform(-12, 12)], degrees=True
    )
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    place = np.array([rng.uniform(-60, 60), rng.uniform(-40, 40), depth_mm])
    pose[:3, 3] = place - pose[:3, :3] @ [*CORNER[which], 0.0]
    return pose


def true_pixel(lens: Camera, pose: np.ndarray, which: str) -> np.ndarray:
    pixel, _ = cv2.projectPoints(
        np.array([[*CORNER[which], 0.0]]), cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3],
        lens.matrix, lens.distortion,
    )  # fmt: skip
    return pixel.ravel()
