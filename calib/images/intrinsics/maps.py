"""Maps over the imager: where corners were, how uncertain the lens is there, how lenses differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.board import LensFit
from calib.geometry.camera import Camera, normalise, project, project_points
from calib.images.bundle import finite

CELLS = (6, 8)
"""Rows and columns of the cells in which coverage is counted: about square on 4:3 imagers, and as
large as a board square's neighbourhood in a typical view."""

GRID = (12, 16)
"""Rows and columns of the nodes of uncertainty and difference maps."""

REACH_SHARE = 0.05
"""A node counts as covered if a corner lies within this share of the imager's diagonal."""


@dataclass(frozen=True)
class Coverage:
    """Where on the imager corners were seen.

    Parameters
    ----------
    counts
        Corners in each cell, shape `CELLS`.
    share
        Share of cells with a corner.
    reach
        Distance of the outermost corner from the imager's centre over half its diagonal.
    """

    counts: IntArray
    share: float
    reach: float


@dataclass(frozen=True)
class Nodes:
    """The nodes of maps over the imager.

    Parameters
    ----------
    pixels
        From the first pixel to the last, px, shape (*GRID, 2).
    covered
        Which have corners nearby, shape GRID.
    """

    pixels: FloatArray
    covered: BoolArray


@dataclass(frozen=True)
class LensMap:
    """How uncertain a lens model's projection is over the imager.

    Parameters
    ----------
    pixels
        Nodes, px, shape (rows, columns, 2).
    covered
        Which nodes have corners nearby, shape (rows, columns).
    std_px
        Standard deviation in the worst direction of where a ray is projected, the camera's
        rotation aligned over the covered nodes, px, shape (rows, columns); NaN where the model has
        no ray.
    """

    pixels: FloatArray
    covered: BoolArray
    std_px: FloatArray


@dataclass(frozen=True)
class LensRays:
    """A lens known by its rays at the nodes, whatever its parameters.

    Parameters
    ----------
    name
        Backend and lens model.
    rays
        Unit vectors, shape (rows, columns, 3); NaN where there is none.
    std_px
        Stated projection uncertainty, px, shape (rows, columns).
    """

    name: str
    rays: FloatArray
    std_px: FloatArray


@dataclass(frozen=True)
class LensDifference:
    """How two calibrations of one camera differ over the imager.

    Parameters
    ----------
    first, second
        Their names, backend and lens model.
    pixels
        Nodes, px, shape (rows, columns, 2).
    covered
        Which nodes have corners nearby, shape (rows, columns).
    difference_px
        Second minus first projection of the same ray, rotations aligned over the covered nodes,
        px, shape (rows, columns, 2); NaN where either has no ray.
    expected_px
        Their stated standard deviations combined, px, shape (rows, columns).
    rms_px, max_px
        Of the length of the difference over covered nodes, px.
    expected_rms_px
        Of `expected_px` over covered nodes.
    ratio
        Root mean square over covered nodes of the difference over what is expected there.
    """

    first: str
    second: str
    pixels: FloatArray
    covered: BoolArray
    difference_px: FloatArray
    expected_px: FloatArray
    rms_px: float
    max_px: float
    expected_rms_px: float
    ratio: float


def measure_coverage(pixels: FloatArray, image_size: tuple[int, int]) -> Coverage:
    """Return the coverage of corners, px, shape (..., 2); NaN are left out."""
    at = pixels[finite(pixels)]
    size = np.array(image_size, dtype=np.float64)
    edges = [
        np.linspace(-0.5, side - 0.5, n + 1) for side, n in zip(size[::-1], CELLS, strict=True)
    ]
    counts = np.histogram2d(at[:, 1], at[:, 0], bins=edges)[0]
    radius = np.linalg.norm(at - (size - 1) / 2, axis=-1).max() if len(at) else 0.0
    return Coverage(
        counts=counts.astype(np.int64),
        share=float((counts > 0).mean()),
        reach=float(radius / np.linalg.norm(size / 2)),
    )


def nodes(pixels: FloatArray, image_size: tuple[int, int]) -> Nodes:
    """Return the nodes of an imager on which corners `pixels`, px, shape (..., 2), were seen."""
    width, height = image_size
    grid = np.stack(
        np.meshgrid(np.linspace(0, width - 1, GRID[1]), np.linspace(0, height - 1, GRID[0])),
        axis=-1,
    )
    at = pixels[finite(pixels)]
    reach = REACH_SHARE * float(np.hypot(*image_size))
    near = np.zeros(GRID, dtype=np.bool_)
    for row, out in zip(grid, near, strict=True):
        out[:] = (((row[:, None] - at) ** 2).sum(axis=-1) < reach**2).any(axis=-1)
    return Nodes(grid, near)


def map_uncertainty(fit: LensFit, at: Nodes) -> LensMap:
    """Return the projection uncertainty of a fit with OpenCV's parameters.

    A change of the intrinsics that a rotation of the camera undoes moves no measured angle, so the
    rotation that best undoes it over the covered nodes is taken off before propagation (mrcal's
    documentation calls it the implied rotation).
    """
    good, undone = by_intrinsics(fit.camera, at)
    spread = undone @ fit.covariance @ undone.swapaxes(-1, -2)
    std = np.full(len(good), np.nan)
    std[good] = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[:, -1], 0))
    return LensMap(at.pixels, at.covered, std.reshape(at.covered.shape))


def by_intrinsics(camera: Camera, at: Nodes) -> tuple[BoolArray, FloatArray]:
    """Return how rays at the nodes move over the imager with the intrinsics, rotation taken off.

    Returns
    -------
    tuple
        At which nodes the model has a ray, shape (nodes,); derivatives there, px, shape
        (good nodes, 2, 4 + k).
    """
    rays = _rays(camera, at.pixels.reshape(-1, 2))
    good = finite(rays)
    projection = project_points(camera, rays[good])
    by_lens = projection.by_intrinsics
    # A small rotation w moves a ray r by w x r.
    by_turn = -projection.by_point @ _cross(rays[good])
    inside = at.covered.ravel()[good]
    turn = by_turn[inside].reshape(-1, 3)
    lens = by_lens[inside].reshape(len(turn), -1)
    return good, by_lens - by_turn @ np.linalg.lstsq(turn, lens, rcond=None)[0]


def fit_name(fit: LensFit) -> str:
    """Return how reports call a fit."""
    return f"{fit.backend} {fit.lens_model}"


def rays_of(fit: LensFit, at: Nodes) -> LensRays:
    """Return a fit with OpenCV's parameters by its rays."""
    rays = _unit(_rays(fit.camera, at.pixels.reshape(-1, 2)))
    std_px = map_uncertainty(fit, at).std_px
    return LensRays(fit_name(fit), rays.reshape(*at.covered.shape, 3), std_px)


def compare(first: LensFit, second: LensRays, at: Nodes) -> LensDifference:
    """Return the difference of a fit and another lens."""
    own = _unit(_rays(first.camera, at.pixels.reshape(-1, 2)))
    other = second.rays.reshape(-1, 3)
    use = at.covered.ravel() & finite(own) & finite(other)
    aligned = other @ _rotation_onto(other[use], own[use]).T
    # A ray beyond the fold of the first lens would be projected to a meaningless place.
    aligned[~finite(own)] = np.nan
    difference = project(first.camera, aligned).reshape(at.pixels.shape) - at.pixels
    expected = np.hypot(map_uncertainty(first, at).std_px, second.std_px)
    inside = use.reshape(at.covered.shape)
    length = np.linalg.norm(difference[inside], axis=-1)
    return LensDifference(
        first=fit_name(first),
        second=second.name,
        pixels=at.pixels,
        covered=at.covered,
        difference_px=difference,
        expected_px=expected,
        rms_px=float(np.sqrt(np.mean(length**2))),
        max_px=float(length.max()),
        expected_rms_px=float(np.sqrt(np.mean(expected[inside] ** 2))),
        ratio=float(np.sqrt(np.mean((length / expected[inside]) ** 2))),
    )


def _rays(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return rays (x, y, 1), shape (n, 3), of pixels; NaN where the lens model has none."""
    xy = normalise(camera, pixels, strict=False)
    return np.concatenate([xy, np.where(finite(xy), 1.0, np.nan)[:, None]], axis=-1)


def _unit(rays: FloatArray) -> FloatArray:
    unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit


def _cross(vectors: FloatArray) -> FloatArray:
    """Return matrices [v]x with [v]x w = v x w, shape (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2
    )


def _rotation_onto(moving: FloatArray, still: FloatArray) -> FloatArray:
    """Return the rotation that takes unit vectors onto others in the least-squares sense, (3, 3).

    Wahba's problem by singular values (Markley 1988, J. Astronaut. Sci. 36).
    """
    u, _, vt = np.linalg.svd(still.T @ moving)
    rotation: FloatArray = u @ np.diag([1, 1, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    return rotation
