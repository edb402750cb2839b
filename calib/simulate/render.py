"""Images of flat boards: every pixel an integral over its area of what its rays meet.

The ray of each pixel is known exactly (the lens model inverted) and meets the board's plane in
closed form. Where a pixel lies on an edge of the pattern it is split into sub-pixels, and an edge
crosses a sub-pixel as a ramp of its width: symmetric, so that no corner is drawn to one side.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, normalise, project, radius_limit
from calib.simulate.pattern import SURROUNDINGS, Pattern

Image = NDArray[np.uint8]
Float32 = NDArray[np.float32]

SUBPIXELS = 2
"""Sub-pixels across a pixel on an edge. Grey values then agree with 72 x 72 sharp samples to 1 % of
the contrast; 3 and 4 agree no better."""

_SAMPLED = 61
"""Of so many pixels one is looked at for the coarsest; odd, so as not to run down a column."""

_CHUNK = 1 << 14
"""Pixels undistorted at once; keeps the jacobians of the lens model in the cache."""


@dataclass(frozen=True)
class Optics:
    """What lens and imager do to the picture apart from distortion.

    Parameters
    ----------
    psf_px
        Standard deviation of the Gaussian point spread function, px.
    noise
        Standard deviation of the grey values' noise, 8-bit steps.
    vignetting
        Share s of the natural fall-off, gain = 1 / (1 + s tan^2)^2: 1 is cos^4, 0 none. Of a wide
        lens the angle stands for its tangent.
    exposure
        Grey value of a perfect white on the optical axis, 8-bit steps.
    """

    psf_px: float = 0.7
    noise: float = 1.5
    vignetting: float = 0.5
    exposure: float = 250.0


@dataclass(frozen=True)
class Imager:
    """A camera with the rays of its pixels.

    Parameters
    ----------
    camera, optics
        As given.
    rays
        Normalised x and y of each pixel's centre, shape (2, height, width).
    slopes
        d(rays)/d(u, v), 1/px, shape (2, 2, height, width), first index x and y, second u and v.
    gain
        Grey value of a perfect white, shape (height, width).
    """

    camera: Camera
    optics: Optics
    rays: Float32
    slopes: Float32
    gain: Float32


def prepare(camera: Camera, optics: Optics, *, spacing_px: int = 1) -> Imager:
    """Return the imager of a camera: what all its images share, computed once.

    Parameters
    ----------
    spacing_px
        Rays are found for every so many pixels and between them by splines of degree 5, which at 8
        is a hundred times as fast and misses no ray of a lens in use by 1e-7.
    """
    rays = _rays(camera, spacing_px)
    slopes = np.stack([np.stack(np.gradient(r)[::-1]) for r in rays])
    fall = (rays**2).sum(axis=0)
    if camera.projection != "perspective":
        # Wide lenses are built not to darken like a pinhole: by the angle, not its tangent.
        fall = np.arctan(np.sqrt(fall)) ** 2
    gain = optics.exposure / (1 + optics.vignetting * fall) ** 2
    single = np.float32
    return Imager(camera, optics, rays.astype(single), slopes.astype(single), gain.astype(single))


def _rays(camera: Camera, spacing_px: int) -> FloatArray:
    """Return normalised x and y of each pixel's centre, shape (2, height, width)."""
    width, height = camera.image_size
    if spacing_px == 1:
        return _rays_at(camera, np.arange(float(width)), np.arange(float(height)))
    u, v = (np.linspace(0, n - 1, max(8, n // spacing_px)) for n in (width, height))
    splines = [RectBivariateSpline(v, u, rays, kx=5, ky=5) for rays in _rays_at(camera, u, v)]
    return np.stack([spline(np.arange(height), np.arange(width)) for spline in splines])


def _rays_at(camera: Camera, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return normalised x and y at columns u and rows v, shape (2, len(v), len(u))."""
    pixels = np.stack([grid.ravel() for grid in np.meshgrid(u, v)], axis=-1)
    parts = np.array_split(pixels, -(-len(pixels) // _CHUNK))
    rays = np.concatenate([normalise(camera, part) for part in parts])
    return rays.T.reshape(2, len(v), len(u))


def render(imager: Imager, pattern: Pattern, pose: FloatArray, rng: np.random.Generator) -> Image:
    """Return the 8-bit image, shape (height, width), of a pattern.

    Parameters
    ----------
    pose
        Camera from board, shape (4, 4), mm.
    rng
        Of the noise.
    """
    return expose(imager, pattern, pose[None], rng)


def expose(imager: Imager, pattern: Pattern, poses: FloatArray, rng: np.random.Generator) -> Image:
    """Return the 8-bit image, shape (height, width), of a pattern that moves while it is exposed.

    Parameters
    ----------
    poses
        Camera from board at moments equally far apart, shape (n, 4, 4), mm.
    rng
        Of the noise.
    """
    picture = _scene(imager, pattern, poses[0])
    for pose in poses[1:]:
        picture += _scene(imager, pattern, pose)
    if len(poses) > 1:
        picture /= np.float32(len(poses))
    picture *= imager.gain
    picture += np.float32(imager.optics.noise) * rng.standard_normal(picture.shape, np.float32)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _scene(imager: Imager, pattern: Pattern, pose: FloatArray) -> Float32:
    """Return what is before the camera, shape (height, width), in units of reflectance."""
    picture = np.full(imager.gain.shape, SURROUNDINGS, dtype=np.float32)
    window = _window(imager, pattern, pose)
    picture[window] = _irradiance(imager, pattern, pose, window)
    return picture


def _window(imager: Imager, pattern: Pattern, pose: FloatArray) -> tuple[slice, slice]:
    """Return the rows and columns of the image which the board and its blur may touch."""
    height, width = imager.gain.shape
    rim = pattern.outline() @ pose[:3, :3].T + pose[:3, 3]
    limit = radius_limit(imager.camera)
    if np.any(rim[:, 2] <= 0) or np.any(np.hypot(*(rim[:, :2] / rim[:, 2:]).T) >= limit):
        return slice(0, height), slice(0, width)
    pixels = project(imager.camera, rim)
    # The rim bulges between its projected points by far less than this.
    pad = 8 + 4 * imager.optics.psf_px
    low = np.floor(pixels.min(axis=0) - pad).astype(int)
    high = np.ceil(pixels.max(axis=0) + pad).astype(int)
    (left, right), (top, bottom) = (
        np.clip([a, b], 0, n) for a, b, n in zip(low, high, (width, height), strict=True)
    )
    return slice(top, bottom), slice(left, right)


def _irradiance(
    imager: Imager, pattern: Pattern, pose: FloatArray, window: tuple[slice, slice]
) -> Float32:
    """Return the blurred picture of the pattern inside the window, in units of reflectance."""
    to_board = np.linalg.inv(pose[:3, [0, 1, 3]]).astype(np.float32)
    rays, slopes = imager.rays[:, *window], imager.slopes[:, :, *window]
    hits = _meet(to_board, rays)
    near_sheet = _near_sheet(pattern, hits)
    if not near_sheet.any():
        return np.full(near_sheet.shape, SURROUNDINGS, dtype=np.float32)
    row, column = (index[::_SAMPLED] for index in np.nonzero(near_sheet))
    reach = _reach(to_board, rays[:, row, column], slopes[:, :, row, column])
    nearest = [_nearest(lines, hit) for lines, hit in zip(_lines(pattern), hits, strict=True)]
    on_line = [np.abs(away) < near for (_, away), near in zip(nearest, reach, strict=True)]
    on_edge = near_sheet & (on_line[0] | on_line[1])
    picture = _sharp(pattern, nearest)
    picture[on_edge] = _split(pattern, to_board, rays[:, on_edge], slopes[:, :, on_edge])
    if imager.optics.psf_px > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), imager.optics.psf_px)
    return picture


def _near_sheet(pattern: Pattern, hits: Float32) -> NDArray[np.bool_]:
    """Return which hits, shape (2, ...), lie on the sheet or within half its size of it.

    Towards the horizon of the board's plane a pixel spans more than the sheet, and yet sees none
    of it: such pixels are no edges.
    """
    near = np.ones(hits.shape[1:], dtype=bool)
    for lines, hit in zip(_lines(pattern), hits, strict=True):
        span = float(lines[-1] - lines[0])
        near &= np.abs(hit - np.float32((lines[0] + lines[-1]) / 2)) < span
    return near


def _lines(pattern: Pattern) -> tuple[FloatArray, FloatArray]:
    return pattern.x_mm, pattern.y_mm


def _meet(to_board: Float32, rays: Float32) -> Float32:
    """Return where rays, shape (2, ...), meet the board's plane: X, Y, mm, shape (2, ...).

    The pose maps (X, Y, 1) to depth times (x, y, 1); its inverse gives X, Y and 1 over depth. Rays
    that meet the plane behind the camera are sent far off the board.
    """
    x, y = rays
    inverse_depth = to_board[2, 0] * x + to_board[2, 1] * y + to_board[2, 2]
    inverse_depth = np.maximum(inverse_depth, np.float32(1e-9))
    return np.stack([(h[0] * x + h[1] * y + h[2]) / inverse_depth for h in to_board[:2]])


def _gradients(to_board: Float32, rays: Float32, slopes: Float32) -> Float32:
    """Return d(X, Y)/d(u, v), mm/px, shape (2, 2, n), at rays of shape (2, n)."""
    hits = _meet(to_board, rays)
    x, y = rays
    inverse_depth = to_board[2, 0] * x + to_board[2, 1] * y + to_board[2, 2]
    fall = to_board[2, 0] * slopes[0] + to_board[2, 1] * slopes[1]
    return np.stack(
        [
            (h[0] * slopes[0] + h[1] * slopes[1] - hit * fall) / inverse_depth
            for h, hit in zip(to_board[:2], hits, strict=True)
        ]
    )


def _reach(to_board: Float32, rays: Float32, slopes: Float32) -> FloatArray:
    """Return how near a line in x and in y a pixel on an edge may be, mm, shape (2,).

    Half a pixel's diagonal and half a ramp, at the coarsest of the pixels given, with a fifth to
    spare for those between. Rays of shape (2, n).
    """
    steepest = np.hypot(*_gradients(to_board, rays, slopes).swapaxes(0, 1))
    pixels = np.sqrt(0.5) + 0.5 / SUBPIXELS
    reach: FloatArray = 1.2 * pixels * steepest.max(axis=1).astype(np.float64)
    return reach


def _nearest(lines: FloatArray, at: Float32) -> tuple[NDArray[np.intp], Float32]:
    """Return the number of the nearest line and the signed distance from it, mm, shapes as `at`."""
    single = lines.astype(np.float32)
    number = np.searchsorted((single[1:] + single[:-1]) / 2, at)
    return number, at - single[number]


def _sharp(pattern: Pattern, nearest: list[tuple[NDArray[np.intp], Float32]]) -> Float32:
    """Return the reflectance without regard to the size of pixels."""
    (column, dx), (row, dy) = nearest
    cells = pattern.reflectance.astype(np.float32)
    return cells[row + (dy > 0), column + (dx > 0)]


def _split(pattern: Pattern, to_board: Float32, rays: Float32, slopes: Float32) -> Float32:
    """Return the mean reflectance of pixels, rays of shape (2, n), by their sub-pixels."""
    cells = pattern.reflectance.astype(np.float32)
    width = cells.shape[1]
    flat = cells.ravel()
    total = np.zeros(rays.shape[1], np.float32)
    # A ramp as wide as a sub-pixel, from the gradient at the pixel's centre.
    gradient = _gradients(to_board, rays, slopes)
    per_ramp = SUBPIXELS / np.hypot(gradient[:, 0], gradient[:, 1])
    offsets = ((np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5).astype(np.float32)
    for du in offsets:
        for dv in offsets:
            hits = _meet(to_board, rays + du * slopes[:, 0] + dv * slopes[:, 1])
            column, dx = _nearest(pattern.x_mm, hits[0])
            row, dy = _nearest(pattern.y_mm, hits[1])
            right = np.clip(dx * per_ramp[0] + np.float32(0.5), 0, 1)
            below = np.clip(dy * per_ramp[1] + np.float32(0.5), 0, 1)
            first = row * width + column
            upper = flat[first] + right * (flat[first + 1] - flat[first])
            first += width
            lower = flat[first] + right * (flat[first + 1] - flat[first])
            total += upper + below * (lower - upper)
    return total / np.float32(SUBPIXELS**2)
