"""Solves of one lens model by the solver that stands behind it.

OpenCV's where a camera is perspective, this program's own where the lens is wide.
"""

from __future__ import annotations

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera
from calib.images.intrinsics.by_opencv import fit_opencv, solve_views
from calib.images.intrinsics.by_views import Views, fit_views, solve
from calib.images.intrinsics.lenses import LENSES


def solve_lens(
    corners: Corners,
    board: Board,
    used: BoolArray,
    *,
    lens: str,
    points: FloatArray,
    start: Camera,
) -> Camera:
    """Solve over the corners `used`, shape (views, corners), the board of shape `points`, mm.

    Raises
    ------
    EstimationError
        If there are too few views, or no solution is found.
    """
    if LENSES[lens].projection == "perspective":
        return solve_views(corners, board, used, lens=lens, points=points, start=start).camera
    problem = Views(start, points, corners.pixels, used, warp=False)
    return problem.camera_at(solve(problem))


def fit_lens(
    corners: Corners, board: Board, *, lens: str, points: FloatArray, start: Camera
) -> LensFit:
    """Return intrinsics with outliers rejected, the board of shape `points`, mm.

    Raises
    ------
    EstimationError
        If no solution is found, or the views leave a parameter open.
    """
    if LENSES[lens].projection == "perspective":
        return fit_opencv(corners, board, lens=lens, points=points, start=start)
    return fit_views(corners, points, start=start, lens=lens, warp=False)
