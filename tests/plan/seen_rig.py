"""A rig with images whose corners are in a cache: nothing is rendered, nothing detected."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.corner_cache import write_cache
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, project
from calib.geometry.parameters import vector
from calib.geometry.plane import gaze_at

SIZE = (1280, 960)
CAMERA = Camera(np.array([[1000.0, 0, 640], [0, 1000.0, 480], [0, 0, 1]]), np.zeros(5), SIZE)
BOARD = Board("chessboard", 7, 5, 20.0, (3, 2))
THETA = vector(
    {"baseline_mm": 120.0, "delta2_rad": 0.01, "axis_z_mm": -12.0, "eccentricity_mm": 3.0}
)
HELD_RAD = np.deg2rad(85.0)
NOISE_PX = 0.05

MANIFEST = """\
format = 1
name = "seen"
[encoder]
resolution_deg = 0.01
[board]
type = "chessboard"
columns = 7
rows = 5
square_mm = 20.0
corners = "corners.vnl"
target = "centre"
[cameras.c1]
image_size = [1280, 960]
matrix = [[1000, 0, 640], [0, 1000, 480], [0, 0, 1]]
[cameras.c2]
image_size = [1280, 960]
matrix = [[1000, 0, 640], [0, 1000, 480], [0, 0, 1]]
"""

STEREO = """\
[stereo]
c1 = "stereo/c1/*.png"
c2 = "stereo/c2/*.png"
alpha2_deg = 85.0
"""

GAZE = """\
[gaze]
table = "gaze.csv"
"""


def held_c2() -> tuple[FloatArray, FloatArray]:
    """Return rotation (C2 to C1) and place of C2 while the pairs were taken."""
    sine, cosine = np.sin(HELD_RAD), np.cos(HELD_RAD)
    across, ahead = np.array([sine, 0, cosine]), np.array([-cosine, 0, sine])
    axis = np.array([THETA[0], 0, THETA[2]])
    return np.column_stack([across, [0, 1, 0], ahead]), axis + THETA[3] * across


def seen_rig(folder: Path, *, sections: str = STEREO + GAZE, rows: int = 10) -> Path:
    """Write the dataset: targets seen by C1, their depths by stereo."""
    rng = np.random.default_rng(8)
    z = np.linspace(700, 1600, rows)
    points = np.column_stack([rng.uniform(-0.25, 0.35, rows) * z, rng.uniform(-60, 60, rows), z])
    shape = BOARD.object_points() - BOARD.object_points()[BOARD.target_index]
    rotation, place = held_c2()
    views: dict[str, list[FloatArray]] = {"c1": [], "c2": []}
    for point in points:
        turned = shape @ _turn(rng.uniform(-0.4, 0.4)).T + point
        views["c1"].append(project(CAMERA, turned))
        views["c2"].append(project(CAMERA, (turned - place) @ rotation))
    names = {c: tuple(f"stereo/{c}/g{i:02d}.png" for i in range(rows)) for c in views}
    cache = [
        Corners(
            names[c],
            np.array(seen) + rng.normal(0, NOISE_PX, (rows, BOARD.corner_count, 2)),
            ("cache",) * rows,
            SIZE,
        )
        for c, seen in views.items()
    ]
    readings = np.rad2deg(gaze_at(THETA, points).alpha2)
    lines = [
        f"g{i:02d},{names['c1'][i]},{reading:.2f},g{i:02d}" for i, reading in enumerate(readings)
    ]
    folder.mkdir(parents=True)
    (folder / "dataset.toml").write_text(MANIFEST + sections)
    (folder / "corners.vnl").write_text(write_cache(cache))
    table = "\n".join(["id,image_c1,alpha2_deg,stereo", *lines])
    (folder / "gaze.csv").write_text(f"{table}\n")
    return folder


def _turn(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
