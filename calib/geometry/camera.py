"""Cameras: pixels to rays and back, with derivatives, by the lens models of `calib.geometry.lens`.

A ray (x, y, 1) of the camera's frame is bent by the lens and scaled by the matrix to pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.lens import PROJECTIONS, Projected, ProjectionName

REPROJECTION_TOLERANCE_PX = 1e-6
"""A pixel counts as undistorted when its ray projects back this near; Newton reaches 1e-11."""

_NEWTON_STEPS = 30
_NEWTON_DONE_PX = 1e-10


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera.

    Parameters
    ----------
    matrix
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px, shape (3, 3); the origin of pixel coordinates is
        the centre of the top-left pixel.
    distortion
        The lens in OpenCV's order, shape (k,), with k one of `Projection.counts`.
    image_size
        Width and height, px.
    projection
        Of which lens model the coefficients are.
    """

    matrix: FloatArray
    distortion: FloatArray
    image_size: tuple[int, int]
    projection: ProjectionName = "perspective"


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


def intrinsic_names(camera: Camera) -> tuple[str, ...]:
    """Return the names of the intrinsics in the order of covariances and jacobians."""
    lens = PROJECTIONS[camera.projection].coefficients
    return ("fx", "fy", "cx", "cy", *lens[: len(camera.distortion)])


def intrinsic_vector(camera: Camera) -> FloatArray:
    """Return fx, fy, cx, cy and the distortion as one vector, px and 1, shape (4 + k,)."""
    m = camera.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], camera.distortion])


def camera_from_vector(
    intrinsics: FloatArray,
    image_size: tuple[int, int],
    projection: ProjectionName = "perspective",
) -> Camera:
    """Return the camera of intrinsics in the order of `intrinsic_vector`, shape (4 + k,)."""
    fx, fy, cx, cy = (float(v) for v in intrinsics[:4])
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.array(intrinsics[4:], dtype=np.float64), image_size, projection)


def with_intrinsics(camera: Camera, intrinsics: FloatArray) -> Camera:
    """Return a camera with other intrinsics of the same lens model, shape (4 + k,)."""
    return camera_from_vector(intrinsics, camera.image_size, camera.projection)


def project_points(camera: Camera, points: FloatArray) -> Projected:
    """Project points of the camera's frame, any unit, finite, shape (n, 3), with derivatives."""
    model = PROJECTIONS[camera.projection]
    return model.project(camera.matrix, camera.distortion, points)


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
        by_pixel[good] = np.linalg.inv(projection.by_point[..., :2])
        by_intrinsics[good] = -by_pixel[good] @ projection.by_intrinsics
    return Normalised(xy, by_pixel, by_intrinsics)


def radius_limit(camera: Camera) -> float:
    """Return the tangent off the axis up to which the lens is one to one, inf if everywhere."""
    return PROJECTIONS[camera.projection].limit(camera.distortion)


def _project(camera: Camera, xy: FloatArray) -> Projected:
    """Project finite normalised coordinates, shape (n, 2), which stand at z = 1."""
    return project_points(camera, np.concatenate([xy, np.ones((len(xy), 1))], axis=-1))


def _invert(camera: Camera, pixels: FloatArray, *, strict: bool) -> FloatArray:
    """Return the rays of finite pixels, shape (n, 2); where there is none raise or return NaN."""
    limit = radius_limit(camera)
    xy = _radial_inverse(camera, pixels, limit)
    with np.errstate(all="ignore"):  # a pixel without a ray may run off; it is judged below
        for _ in range(_NEWTON_STEPS):
            projection = _project(camera, xy)
            error = projection.pixels - pixels
            if np.all(np.abs(error) < _NEWTON_DONE_PX):
                break
            xy = xy - _solve(projection.by_point[..., :2], error)
        projection = _project(camera, xy)
        error = np.hypot(*(projection.pixels - pixels).T)
        unfolded = (np.linalg.det(projection.by_point[..., :2]) > 0) & (np.hypot(*xy.T) < limit)
    good = (error < REPROJECTION_TOLERANCE_PX) & unfolded
    if strict and not good.all():
        raise EstimationError(_folded(camera, pixels, good, limit))
    return np.where(good[:, None], xy, np.nan)


def _radial_inverse(camera: Camera, pixels: FloatArray, limit: float) -> FloatArray:
    """Return rays, shape (n, 2), that fit the radial part of the model, by bisection."""
    m = camera.matrix
    distorted = (pixels - m[:2, 2]) / m[[0, 1], [0, 1]]
    radius = np.hypot(*distorted.T)
    found = PROJECTIONS[camera.projection].tangent(camera.distortion, radius, limit)
    factor = np.divide(found, radius, out=np.ones_like(radius), where=radius > 0)
    xy: FloatArray = distorted * factor[:, None]
    return xy


def _solve(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve 2 x 2 systems, shapes (n, 2, 2) and (n, 2); not finite where singular."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    x, y = vector[:, 0], vector[:, 1]
    determinant = a * d - b * c
    solution: FloatArray = np.stack([d * x - b * y, a * y - c * x], axis=-1) / determinant[:, None]
    return solution


def _folded(camera: Camera, pixels: FloatArray, good: BoolArray, limit: float) -> str:
    """Return the message about pixels that no ray reaches."""
    u, v = pixels[~good][0]
    count = int((~good).sum())
    more = f" and {count - 1} more" if count > 1 else ""
    reach = "" if np.isinf(limit) else f" {np.degrees(np.arctan(limit)):.1f} deg off the axis"
    why = f"the lens model folds back{reach}"
    if np.isinf(limit) and camera.projection == "equidistant":
        why = "it looks 90 deg or more off the axis"
    return (
        f"no ray belongs to pixel ({u:.2f}, {v:.2f}){more}: {why}; "
        "check the intrinsics, or calibrate them with board images that reach that part of "
        "the imager"
    )
