"""Intrinsics of one camera by mrcal: OpenCV's lens models and, as their cross-check, a spline."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import intrinsic_vector
from calib.images.bundle import finite
from calib.images.mrcal.call import MrcalMissingError
from calib.images.mrcal.solves import (
    LENS_MODELS,
    MIN_CORNERS,
    LensGrid,
    MrcalSolution,
    StartingPoint,
    focal_start,
    lens_fits,
    solve,
    splined_field,
    splined_lens,
    wide_focal,
)
from calib.images.pairs import single_view_pose

PROCESSES = 2
"""Solves side by side, each a process of one thread; OpenCV needs little time beside them."""

SPLINED = "splined"
"""Key of the splined lens in `MrcalFits.failed`."""


@dataclass(frozen=True)
class MrcalFits:
    """What mrcal made of one camera's corners.

    Parameters
    ----------
    fits
        By the names of `calib.images.intrinsics.lenses.LENSES`.
    grids
        mrcal's own account of rays and projection uncertainty of each.
    model_files
        Text of mrcal's ``.cameramodel`` of each, with the inputs of the solve.
    splined
        Rays and uncertainty of the splined lens; None if it failed.
    splined_model
        Its name.
    splined_rms_px
        Root mean square of its residuals per coordinate, px; NaN if it failed.
    failed
        Why a solve failed, by lens.
    missing
        Why there are no fits at all: mrcal is not installed. None if it is.
    version
        mrcal's.
    """

    fits: Mapping[str, LensFit]
    grids: Mapping[str, LensGrid]
    model_files: Mapping[str, str]
    splined: LensGrid | None
    splined_model: str
    splined_rms_px: float
    failed: Mapping[str, str]
    missing: str | None = None
    version: str = "unknown"


WORSE = 1.05
"""A fit with a free board whose rms is larger than one with a flat board by this has not found the
minimum: mrcal's own start, stereographic, fails on some lenses of more than 100 degrees."""


def fit_mrcal(
    corners: Corners,
    board: Board,
    *,
    lenses: Mapping[str, int],
    seed: int,
    grid: tuple[int, int],
    others: Mapping[str, LensFit],
    field_deg: tuple[float, float] | None = None,
) -> MrcalFits:
    """Return intrinsics by mrcal for each lens model, and with a splined one; the board may warp.

    Where a fit fails, or is worse than another backend's, mrcal starts once more from that one.

    Parameters
    ----------
    lenses
        Names, with the number of OpenCV's distortion coefficients.
    seed
        Of mrcal's random numbers.
    grid
        Rows and columns of the grids of rays.
    others
        Fits of another backend to the same corners, by lens model.
    field_deg
        Of a wide lens: its field of view across and down, which the spline is to cover.
    """
    focal = focal_start(corners, board)
    if field_deg is None:
        splined = splined_lens(corners, focal_px=focal)
    else:
        splined = splined_field(*field_deg)
        focal = wide_focal(corners, field_deg[0])
    models = {name: LENS_MODELS[count] for name, count in lenses.items()} | {SPLINED: splined}

    def attempt(name: str) -> MrcalSolution | Exception:
        first = _attempt(corners, board, models[name], seed=seed, focal_px=[focal], grid=grid)
        other = others.get(name)
        if other is None or isinstance(first, MrcalMissingError):
            return first
        if isinstance(first, MrcalSolution) and first.rms_px <= WORSE * other.rms_px:
            return first
        lens = intrinsic_vector(other.camera)[None]
        start = StartingPoint(lens, np.zeros((0, 6)), _all_poses(other, corners, board))
        again = _attempt(corners, board, models[name], seed=seed, start=start, grid=grid)
        if isinstance(again, MrcalSolution) and (
            not isinstance(first, MrcalSolution) or again.rms_px < first.rms_px
        ):
            return again
        return first

    with ThreadPoolExecutor(PROCESSES) as pool:
        answers = dict(zip(models, pool.map(attempt, models), strict=True))
    solved = {name: a for name, a in answers.items() if isinstance(a, MrcalSolution)}
    missing = next((str(a) for a in answers.values() if isinstance(a, MrcalMissingError)), None)
    spline = solved.pop(SPLINED, None)
    return MrcalFits(
        fits={name: lens_fits(solution, [corners])[0] for name, solution in solved.items()},
        grids={name: solution.grids[0] for name, solution in solved.items()},
        model_files={name: solution.model_files[0] for name, solution in solved.items()},
        splined=spline.grids[0] if spline else None,
        splined_model=splined,
        splined_rms_px=spline.rms_px if spline else float("nan"),
        failed={name: str(a) for name, a in answers.items() if isinstance(a, EstimationError)},
        missing=missing,
        version=next((s.version for s in solved.values()), "unknown"),
    )


def _attempt(
    corners: Corners, board: Board, model: str, **options: Any
) -> MrcalSolution | EstimationError | MrcalMissingError:
    """Return the solution, or why there is none."""
    try:
        return solve([corners], board, lens_model=model, **options)
    except (EstimationError, MrcalMissingError) as error:
        return error


def _all_poses(fit: LensFit, corners: Corners, board: Board) -> FloatArray:
    """Return the poses of a fit, (views, 6), with those of views that it left out."""
    poses = fit.poses.copy()
    points = board.object_points()
    for i in np.flatnonzero(~finite(poses)):
        if finite(corners.pixels[i]).sum() >= MIN_CORNERS:
            poses[i] = single_view_pose(fit.camera, points=points, pixels=corners.pixels[i])[0]
    return poses
