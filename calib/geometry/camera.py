"""The pinhole camera with OpenCV's lens model: pixels to rays and back, with derivatives.

A ray (x, y, 1) of the camera's frame is bent by the lens model (radial rational, tangential, thin
prism and tilted imager, with the coefficients k1, k2, p1, p2, k3, ... of OpenCV's documentation,
"Camera Calibration and 3D Reconstruction"; mrcal's LENSMODEL_OPENCV4 to 12 are the same) and scaled
by the matrix to pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError

RADIUS_MAX = 1e3
"""Largest undistorted radius tried, a ray 89.9 deg off the axis: a pinhole model ends there."""

REPROJECTION_TOLERANCE_PX = 1e-6
"""A pixel counts as undistorted when its ray projects back this near; Newton reaches 1e-11."""

_NEWTON_STEPS = 30
_NEWTON_DONE_PX = 1e-10
_BISECTIONS = 40


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera.

    Parameters
    ----------
    matrix
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px, shape (3, 3); the origin of pixel coordinates is
        the centre of the top-left pixel.
    distortion
        OpenCV order k1, k2, p1, p2, k3, ...; shape (k,) with k one of 0, 4, 5, 8, 12, 14.
    image_size
        Width and height, px.
    """

    matrix: FloatArray
    distortion: FloatArray
    image_size: tuple[int, int]


@dataclass(frozen=True)
class Normalised:
    """Undistorted, normalised coordinates with their derivatives.

    Parameters
    ----------
    xy
        Shape (n, 2); the ray is (x, y, 1).
    by_pixel
        d(xy)/d(pixel), 1/px, shape (n, 2, 2).
    by_intrinsics
        d(xy)/d(fx, fy, cx, cy, distortion), shape (n, 2, 4 + k), per px and per 1.
    """

    xy: FloatArray
    by_pixel: FloatArray
    by_intrinsics: FloatArray


@dataclass(frozen=True)
class _Projection:
    """Pixels (n, 2) with their derivatives by x, y (n, 2, 2) and by the intrinsics (n, 2, 4+k)."""

    pixels: FloatArray
    by_xy: FloatArray
    by_intrinsics: FloatArray


def intrinsic_names(camera: Camera) -> tuple[str, ...]:
    """Return the names of the intrinsics in the order of covariances and jacobians."""
    lens = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
    return ("fx", "fy", "cx", "cy", *lens[: len(camera.distortion)])


def intrinsic_vector(camera: Camera) -> FloatArray:
    """Return fx, fy, cx, cy and the distortion as one vector, px and 1, shape (4 + k,)."""
    m = camera.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], camera.distortion])


def camera_from_vector(intrinsics: FloatArray, image_size: tuple[int, int]) -> Camera:
    """Return the camera of intrinsics in the order of `intrinsic_vector`, shape (4 + k,)."""
    fx, fy, cx, cy = (float(v) for v in intrinsics[:4])
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.array(intrinsics[4:], dtype=np.float64), image_size)


def project(camera: Camera, rays: FloatArray) -> FloatArray:
    """Return the pixels, shape (n, 2), of rays or points of the camera's frame.

    Parameters
    ----------
    rays
        Directions or points (any unit), shape (n, 3), or normalised coordinates, shape (n, 2).
        A row with NaN or not in front of the camera (z <= 0) yields NaN.
    """
    pixels = np.full((len(rays), 2), np.nan)
    if rays.shape[-1] == 3:
        z = np.where(rays[:, 2] > 0, rays[:, 2], np.nan)
        rays = rays[:, :2] / z[:, None]
    good = np.isfinite(rays).all(axis=-1)
    if good.any():
        pixels[good] = _project(camera, rays[good]).pixels
    return pixels


def normalise(camera: Camera, pixels: FloatArray, *, strict: bool = True) -> FloatArray:
    """Return undistorted, normalised coordinates x, y of pixels, shape (n, 2) both.

    The lens model is inverted on its branch around the optical axis: radially by bisection, then
    in full by Newton's method. Rows with NaN stay NaN.

    Parameters
    ----------
    strict
        If false, pixels to which no ray belongs become NaN instead of an error.

    Raises
    ------
    EstimationError
        If a pixel lies where the lens model folds back, so that no ray belongs to it.
    """
    xy = np.full(pixels.shape, np.nan)
    good = np.isfinite(pixels).all(axis=-1)
    if good.any():
        xy[good] = _invert(camera, pixels[good], strict=strict)
    return xy


def on_centre_row(camera: Camera, column: FloatArray) -> FloatArray:
    """Return pixels, shape (n, 2), of which a table gives the column alone, shape (n,).

    Near the centre column the row hardly matters.
    """
    return np.stack([column, np.full(len(column), camera.matrix[1, 2])], axis=1)


def without_ray(camera: Camera, pixels: FloatArray) -> BoolArray:
    """Return which pixels, shape (n, 2), no ray of the lens reaches, shape (n,); NaN is none."""
    blind = np.zeros(len(pixels), dtype=np.bool_)
    given = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    if len(given):
        reached = np.isfinite(normalise(camera, pixels[given], strict=False)).all(axis=1)
        blind[given[~reached]] = True
    return blind


def normalise_jacobian(camera: Camera, pixels: FloatArray) -> Normalised:
    """Return normalised coordinates of pixels, shape (n, 2), with derivatives.

    By the implicit function theorem: the ray x of a pixel p solves project(x; q) = p, hence
    dx/dp = (d project/dx)^-1 and dx/dq = -(d project/dx)^-1 d project/dq. Rows with NaN stay NaN.

    Raises
    ------
    EstimationError
        As `normalise`.
    """
    xy = normalise(camera, pixels)
    count = 4 + len(camera.distortion)
    by_pixel = np.full((len(xy), 2, 2), np.nan)
    by_intrinsics = np.full((len(xy), 2, count), np.nan)
    good = np.isfinite(xy).all(axis=-1)
    if good.any():
        projection = _project(camera, xy[good])
        by_pixel[good] = np.linalg.inv(projection.by_xy)
        by_intrinsics[good] = -by_pixel[good] @ projection.by_intrinsics
    return Normalised(xy, by_pixel, by_intrinsics)


def radius_limit(camera: Camera) -> float:
    """Return the undistorted radius up to which the radial model is one to one, inf if everywhere.

    The distorted radius r N(r^2) / D(r^2) grows until its derivative or D first vanishes.
    """
    numerator, denominator = _radial(camera)
    s = np.polynomial.Polynomial([0.0, 1.0])
    growth = (numerator + 2 * s * numerator.deriv()) * denominator - (
        2 * s * numerator * denominator.deriv()
    )
    # A leading coefficient of exactly 0 would make the companion matrix infinite.
    roots = np.concatenate([p.trim().roots() for p in (growth, denominator)])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if real.size else float("inf")


def _radial(camera: Camera) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Return N and D of the radial factor as polynomials in the squared radius."""
    k = np.zeros(8)
    head = camera.distortion[:8]
    k[: len(head)] = head
    of = np.polynomial.Polynomial
    return of([1, k[0], k[1], k[4]]), of([1, k[5], k[6], k[7]])


def _project(camera: Camera, xy: FloatArray) -> _Projection:
    """Project finite normalised coordinates, shape (n, 2), with derivatives."""
    # Here, as reading a dataset needs `Camera` but not the 0.2 s of this import.
    import cv2

    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=-1)
    lens = camera.distortion if len(camera.distortion) else None
    pixels, jacobian = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, lens)
    # Columns: rotation 0-2, translation 3-5, fx fy cx cy 6-9, distortion. The points stand at
    # z = 1, so the translation moves x and y themselves.
    by_all = jacobian.reshape(len(xy), 2, -1)
    return _Projection(
        pixels.reshape(-1, 2), by_all[:, :, 3:5], by_all[:, :, 6 : 10 + len(camera.distortion)]
    )


def _invert(camera: Camera, pixels: FloatArray, *, strict: bool) -> FloatArray:
    """Return the rays of finite pixels, shape (n, 2); where there is none raise or return NaN."""
    limit = radius_limit(camera)
    xy = _radial_inverse(camera, pixels, min(limit, RADIUS_MAX))
    with np.errstate(all="ignore"):  # a pixel without a ray may run off; it is judged below
        for _ in range(_NEWTON_STEPS):
            projection = _project(camera, xy)
            error = projection.pixels - pixels
            if np.all(np.abs(error) < _NEWTON_DONE_PX):
                break
            xy = xy - _solve(projection.by_xy, error)
        projection = _project(camera, xy)
        error = np.hypot(*(projection.pixels - pixels).T)
        unfolded = (np.linalg.det(projection.by_xy) > 0) & (np.hypot(*xy.T) < limit)
    good = (error < REPROJECTION_TOLERANCE_PX) & unfolded
    if strict and not good.all():
        raise EstimationError(_folded(pixels, good, limit))
    return np.where(good[:, None], xy, np.nan)


def _radial_inverse(camera: Camera, pixels: FloatArray, limit: float) -> FloatArray:
    """Return rays, shape (n, 2), that fit the radial part of the model, by bisection."""
    m = camera.matrix
    distorted = (pixels - m[:2, 2]) / m[[0, 1], [0, 1]]
    radius = np.hypot(*distorted.T)
    numerator, denominator = _radial(camera)
    low, high = np.zeros_like(radius), np.full_like(radius, limit)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        short = middle * numerator(middle**2) < radius * denominator(middle**2)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    factor = np.divide(low, radius, out=np.ones_like(radius), where=radius > 0)
    xy: FloatArray = distorted * factor[:, None]
    return xy


def _solve(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve 2 x 2 systems, shapes (n, 2, 2) and (n, 2); not finite where singular."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    x, y = vector[:, 0], vector[:, 1]
    determinant = a * d - b * c
    solution: FloatArray = np.stack([d * x - b * y, a * y - c * x], axis=-1) / determinant[:, None]
    return solution


def _folded(pixels: FloatArray, good: BoolArray, limit: float) -> str:
    """Return the message about pixels that no ray reaches."""
    u, v = pixels[~good][0]
    count = int((~good).sum())
    more = f" and {count - 1} more" if count > 1 else ""
    reach = "" if np.isinf(limit) else f" {np.degrees(np.arctan(limit)):.1f} deg off the axis"
    return (
        f"no ray belongs to pixel ({u:.2f}, {v:.2f}){more}: the lens model folds back{reach}; "
        "check the intrinsics, or calibrate them with board images that reach that part of "
        "the imager"
    )
