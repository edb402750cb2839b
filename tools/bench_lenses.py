"""A lens from the same corners by this program, by a bare OpenCV script and by mrcal's own tool.

Corners are those of a board in a simulated camera, with noise, so that the error that each achieves
is known: the lens found against the true one, turned to fit it best as no calibration tells where
"straight ahead" is, root mean square over the part of the picture that the boards cover.

mrcal-calibrate-cameras is in Debian's package mrcal, beside python3-mrcal that the program needs;
`MRCAL_CALIBRATE_CAMERAS` names it where it lies elsewhere.
"""

from __future__ import annotations

import ast
import os
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from calib.dataset.corner_cache import write_cache
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera, project
from calib.images.bundle import deformed
from calib.images.intrinsics.calibrate import calibrate_intrinsics
from calib.images.intrinsics.maps import compare, nodes, rays_of
from calib.simulate.scene import IntrinsicViews, draw_intrinsic_views

TOOL = "mrcal-calibrate-cameras"
BOARD = Board("chessboard", columns=9, rows=6, square_mm=25.0, target=(4, 3))
SIZE = (640, 480)
TRUE = Camera(
    np.array([[540.0, 0, 322.3], [0, 541.5, 236.8], [0, 0, 1]]),
    np.array([-0.25, 0.08, 8e-4, -5e-4, -0.01]),
    SIZE,
)
VIEWS, NOISE_PX, DRAWS = 20, 0.1, 5


@dataclass(frozen=True)
class Achieved:
    """What a method took, CPU s with its processes, and its error, px; None if it is not there."""

    name: str
    seconds: float
    error_px: float | None


def achieved(bow_mm: float) -> list[Achieved]:
    """Return median time and error of each method on the same corners, drawn `DRAWS` times.

    Parameters
    ----------
    bow_mm
        Of the board across its width; a bare script takes it for flat.
    """
    methods = {"this program": _here, "bare OpenCV": _bare, TOOL: _tool}
    found = []
    for name, method in methods.items():
        each = [_timed(name, method, _corners(draw, bow_mm)) for draw in range(DRAWS)]
        errors = [one.error_px for one in each if one.error_px is not None]
        seconds = median(one.seconds for one in each)
        found.append(Achieved(name, seconds, median(errors) if errors else None))
    return found


def _corners(draw: int, bow_mm: float) -> Corners:
    rng = np.random.default_rng(draw)
    poses = draw_intrinsic_views(TRUE, BOARD, rng, IntrinsicViews(count=VIEWS))
    points = deformed(BOARD.object_points(), np.array([bow_mm, 0.0]))
    seen = np.array([project(TRUE, points @ p[:3, :3].T + p[:3, 3]) for p in poses])
    names = tuple(f"view{i:03d}.png" for i in range(len(poses)))
    noisy = seen + NOISE_PX * rng.standard_normal(seen.shape)
    return Corners(names, noisy, ("cascade:classic",) * len(poses), SIZE)


def _timed(name: str, method: Callable[[Corners], Camera | None], corners: Corners) -> Achieved:
    before = _cpu()
    found = method(corners)
    seconds = _cpu() - before
    return Achieved(name, seconds, None if found is None else _error_px(found, corners))


def _cpu() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _error_px(found: Camera, corners: Corners) -> float:
    """Return the difference from the true lens, px."""
    at = nodes(corners.pixels, SIZE)
    fit = LensFit("", "", TRUE, np.eye(9), 0.0, np.zeros(0), np.zeros(0), 0, None)
    return compare(fit, rays_of(replace(fit, camera=found), at), at).rms_px


def _here(corners: Corners) -> Camera:
    return calibrate_intrinsics(corners, BOARD, camera="c1", seed=0).selected.camera


def _bare(corners: Corners) -> Camera:
    points = BOARD.object_points().astype(np.float32)
    views = [view.astype(np.float32) for view in corners.pixels]
    _, matrix, distortion, _, _ = cv2.calibrateCamera(
        [points] * len(views), views, SIZE, None, None
    )
    return Camera(matrix, distortion.ravel(), SIZE)


def _tool(corners: Corners) -> Camera | None:
    """Run mrcal's tool with the same model as bare OpenCV; None if it is not installed."""
    command = os.environ.get("MRCAL_CALIBRATE_CAMERAS") or shutil.which(TOOL)
    if command is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "corners.vnl").write_text(write_cache([corners]))
        subprocess.run(
            [
                "/usr/bin/python3", command, "--corners-cache", "corners.vnl",
                "--lensmodel", "LENSMODEL_OPENCV5", "--focal", "600",
                "--imagersize", str(SIZE[0]), str(SIZE[1]),
                "--object-spacing", str(BOARD.square_mm / 1000),
                "--object-width-n", str(BOARD.columns), "--object-height-n", str(BOARD.rows),
                "--outdir", ".", "view*.png",
            ],
            cwd=folder, check=True, capture_output=True,
        )  # fmt: skip
        (model,) = Path(folder).glob("*.cameramodel")
        fx, fy, cx, cy, *distortion = ast.literal_eval(model.read_text())["intrinsics"]
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(distortion), SIZE)
