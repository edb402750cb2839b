"""Stage: what the images say of the rows of a table: target pixels, reference depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError, InputError, Problem
from calib.dataset.tables import GazeTable
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.images.bundle import deformed, finite
from calib.images.detection.grid import orient_like
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.pairs import single_view_pose
from calib.images.stereo.reference import StereoReference
from calib.images.stereo.solve import CameraPair
from calib.images.stereo.triangulate import position_on_board, shared_names
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import U_PIXEL, CameraSet, ImageObservations

LEAST_PX = 0.01
"""No detector finds corners better, whatever few images say."""

POSE = 6
"""Unknowns of the pose of a board."""


@dataclass(frozen=True)
class CornerNoise:
    """How well corners are found in the board images of each camera.

    Parameters
    ----------
    c1_px, c2_px
        Standard deviation of a coordinate, px; None of a camera whose lens is given, so that the
        images of the rows alone show it.
    warp_mm
        Board deformation along x and y, where a solve told it.
    """

    c1_px: float | None = None
    c2_px: float | None = None
    warp_mm: tuple[float, float] | None = None


def shared_errors(rig: CameraPair, stereo: StereoReference | None) -> CommonErrors:
    """Return what all rows share: C1's and C2's intrinsics and, with stereo, 1T2."""
    if stereo is not None:
        targets = stereo.targets
        return CommonErrors.of(targets.shared_names, targets.shared_covariance)
    names = shared_names(rig.cameras)
    covariance = np.zeros((len(names), len(names)))
    edge = 0
    for block in rig.covariances:
        covariance[edge : edge + len(block), edge : edge + len(block)] = block
        edge += len(block)
    return CommonErrors.of(names, covariance)


def observe_images(
    table: GazeTable,
    board: Board,
    corners_c1: Corners | None,
    corners_c2: Corners | None,
    stereo: StereoReference | None,
    shared: CommonErrors,
    noise: CornerNoise,
    cameras: CameraSet,
) -> ImageObservations:
    """Return what the images of a table's rows say.

    Parameters
    ----------
    corners_c1, corners_c2
        Boards found in the images the rows name; None if they name none.
    noise
        Of the images for the intrinsics; that of the rows' own images counts where it is larger.
    cameras
        C1 and C2 as far as they are known.

    Raises
    ------
    InputError
        If the board was not found in an image that a row names, or its target corner is hidden.
    EstimationError
        If a row takes its depth from a pair that gave none.
    """
    views_c1 = _views(table.image_c1, corners_c1, board)
    views_c2 = _views(table.image_c2, corners_c2, board)
    views_c2 = orient_like(views_c1, views_c2, board)
    pixel_c1, pixel_c2 = views_c1[:, board.target_index], views_c2[:, board.target_index]
    _refuse_missing(table, table.image_c1, pixel_c1)
    _refuse_missing(table, table.image_c2, pixel_c2)
    z, u_z, by_common = _depths(table, stereo, shared)
    _add_by_board(table, board, views_c1, cameras, noise, shared, (z, u_z, by_common))
    return ImageObservations(
        pixel_c1=pixel_c1,
        pixel_c2=pixel_c2,
        u_c1_px=_corner_noise(views_c1, board, cameras.c1, noise.warp_mm, least=noise.c1_px),
        u_c2_px=_corner_noise(views_c2, board, cameras.c2, noise.warp_mm, least=noise.c2_px),
        z_mm=z,
        u_z_mm=u_z,
        z_by_common=by_common,
    )


def _corner_noise(
    views: FloatArray,
    board: Board,
    camera: Camera | None,
    warp_mm: tuple[float, float] | None,
    *,
    least: float | None,
) -> float:
    """Return the standard deviation of a corner coordinate in the images of rows, px.

    Targets stand farther off than boards for intrinsics, their squares are smaller, and corners are
    found less well: on a ChArUco board of 25 px squares to 0.03 px instead of 0.011. What the poses
    of the boards leave of the corners tells, in the median image.

    Parameters
    ----------
    views
        Corners, px, shape (n, corners, 2); NaN where not found.
    least
        What it is at least, px; None if nothing says it.
    """
    if camera is None:
        return U_PIXEL if least is None else least
    points = deformed(board.object_points(), warp_mm)
    found = []
    for view in views:
        coordinates = 2 * int(finite(view).sum())
        if coordinates >= 2 * MIN_CORNERS:
            _, rms = single_view_pose(camera, points=points, pixels=view)
            found.append(rms * np.sqrt(coordinates / (coordinates - POSE)))
    if not found:
        return U_PIXEL if least is None else least
    return max(LEAST_PX if least is None else least, float(np.median(found)))


def _views(names: tuple[str | None, ...], corners: Corners | None, board: Board) -> FloatArray:
    """Return the board's corners in each row's image, (n, corners, 2); NaN without image."""
    views = np.full((len(names), board.corner_count, 2), np.nan)
    if corners is not None:
        place = {name: i for i, name in enumerate(corners.images)}
        for i, name in enumerate(names):
            if name is not None:
                views[i] = corners.pixels[place[name]]
    return views


def _refuse_missing(table: GazeTable, names: tuple[str | None, ...], pixels: FloatArray) -> None:
    problems = [
        Problem(
            where=f"{table.file}, line {table.line[i]} (id {table.ids[i]})",
            what=f"the board, or its target corner, was not found in {name}",
            remedy="look at the picture: the whole board in view, sharp and evenly lit; check the "
            "counts of [board]; or leave the row out",
        )
        for i, name in enumerate(names)
        if name is not None and not np.isfinite(pixels[i]).all()
    ]
    if problems:
        raise InputError(problems)


def _add_by_board(
    table: GazeTable,
    board: Board,
    views: FloatArray,
    cameras: CameraSet,
    noise: CornerNoise,
    shared: CommonErrors,
    depths: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Fill in the depths of rows without reference by the pose of their board in C1.

    The side of a square gives the scale.

    Parameters
    ----------
    views
        Corners in each row's image by C1, px, shape (n, corners, 2).
    depths
        As `_depths` returns them.
    """
    z, u_z, by_common = depths
    open_ = np.isnan(z) & np.isnan(table.z_mm) & finite(views).any(axis=-1)
    rows = np.flatnonzero(open_)
    if not len(rows) or cameras.c1 is None:
        return
    # The position by C1 alone takes nothing from C2; without one, C1 stands in its place.
    both = cameras.c1, cameras.c2 or cameras.c1
    sigma = _corner_noise(views[rows], board, cameras.c1, noise.warp_mm, least=noise.c1_px)
    found = position_on_board(
        views[rows], board, cameras=both, sigma_px=sigma, warp_mm=noise.warp_mm
    )
    names = shared_names(both)
    kept = [names.index(name) for name in shared.names]
    z[rows] = found.position_mm[:, 2]
    u_z[rows] = np.sqrt(found.covariance[:, 2, 2])
    by_common[rows] = found.by_shared[:, 2, kept] @ shared.factor


def _depths(
    table: GazeTable, stereo: StereoReference | None, shared: CommonErrors
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return reference depths, their own standard uncertainty and shared loadings."""
    n = len(table)
    z, u = np.full(n, np.nan), np.full(n, np.nan)
    by_common = np.zeros((n, shared.factor.shape[1]))
    if stereo is None:
        return z, u, by_common
    targets = stereo.targets
    place = {stem: i for i, stem in enumerate(targets.stems)}
    kept = [targets.shared_names.index(name) for name in shared.names]
    for i, stem in enumerate(table.stereo):
        if stem is None:
            continue
        if stem not in place:
            raise EstimationError(
                f"{table.file}, line {table.line[i]} (id {table.ids[i]}): pair {stem} gave no "
                "position: its board was not found in both images, or does not fit the other "
                "pairs; leave the row out"
            )
        k = place[stem]
        z[i] = targets.triangulated.position_mm[k, 2]
        u[i] = np.sqrt(targets.triangulated.covariance[k, 2, 2])
        by_common[i] = targets.triangulated.by_shared[k, 2, kept] @ shared.factor
    return z, u, by_common
