"""Lens models: from points in front of a camera to pixels, with derivatives, and back.

A model is one entry of `PROJECTIONS`; whatever projects, undistorts, reads, writes or mirrors a
camera asks there. A ray is (x, y, 1) in the camera's frame, its tangent r = sqrt(x^2 + y^2) that of
the angle off the optical axis.

``perspective``
    A pinhole, its image bent (radial rational, tangential, thin prism and tilted imager, with the
    coefficients k1, k2, p1, p2, k3, ... of OpenCV's documentation, "Camera Calibration and 3D
    Reconstruction"; mrcal's LENSMODEL_OPENCV4 to 12 are the same). For fields of up to some 100
    degrees.
``equidistant``
    The image height grows with the angle t off the axis: f t (1 + k1 t^2 + k2 t^4 + k3 t^6 +
    k4 t^8) (Kannala and Brandt 2006, doi 10.1109/TPAMI.2006.153, eq. 6; OpenCV's ``fisheye``,
    ``equidistant`` of ROS and Kalibr). For wide lenses; rays at 90 degrees and more off the axis
    have no x and y, and no pixel here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from calib.core.arrays import BoolArray, FloatArray

ProjectionName = Literal["perspective", "equidistant"]

TANGENT_MAX: Final = 1e3
"""Largest tangent tried, a ray 89.9 deg off the axis."""

_BISECTIONS = 40
_ON_AXIS = 1e-9


class Projected(NamedTuple):
    """Pixels, shape (n, 2), and their derivatives by points, (n, 2, 3), and intrinsics, (n, 2, p).

    Intrinsics are fx, fy, cx, cy, then the lens.
    """

    pixels: FloatArray
    by_point: FloatArray
    by_intrinsics: FloatArray


@dataclass(frozen=True)
class Projection:
    """A lens model.

    Parameters
    ----------
    words
        What reports call it.
    coefficients
        Their names, in the order of OpenCV.
    counts
        How many of them a lens may have.
    odd
        Names of those that change their sign in a mirror.
    project
        Of camera matrix, px, (3, 3), lens, (k,), and points in the camera's frame, any unit,
        (n, 3): pixels and derivatives.
    limit
        Of a lens: the tangent up to which it is one to one, infinite if everywhere.
    tangent
        Of a lens, distorted radii in units of the focal length, (n,), and a limit: the tangents,
        at most the limit, whose radial part these are.
    """

    words: str
    coefficients: tuple[str, ...]
    counts: tuple[int, ...]
    odd: frozenset[str]
    project: Callable[[FloatArray, FloatArray, FloatArray], Projected]
    limit: Callable[[FloatArray], float]
    tangent: Callable[[FloatArray, FloatArray, float], FloatArray]


def _perspective(matrix: FloatArray, lens: FloatArray, points: FloatArray) -> Projected:
    if not len(points):
        return Projected(np.empty((0, 2)), np.empty((0, 2, 3)), np.empty((0, 2, 4 + len(lens))))
    # Here, as reading a dataset needs cameras but not the 0.2 s of this import.
    import cv2

    still = np.zeros(3)
    pixels, jacobian = cv2.projectPoints(points, still, still, matrix, lens if len(lens) else None)
    # Columns: rotation, translation (as good as the point itself), fx fy cx cy, distortion.
    by_all = jacobian.reshape(len(points), 2, -1)
    return Projected(pixels.reshape(-1, 2), by_all[..., 3:6], by_all[..., 6 : 10 + len(lens)])


def _perspective_limit(lens: FloatArray) -> float:
    """Return the tangent r where the slope of r N(r^2) / D(r^2), or D, first vanishes."""
    numerator, denominator = _rational(lens)
    s = np.polynomial.Polynomial([0.0, 1.0])
    growth = (numerator + 2 * s * numerator.deriv()) * denominator - (
        2 * s * numerator * denominator.deriv()
    )
    return float(np.sqrt(_first_root(growth, denominator)))


def _perspective_tangent(lens: FloatArray, radius: FloatArray, limit: float) -> FloatArray:
    numerator, denominator = _rational(lens)

    def is_short(middle: FloatArray) -> BoolArray:
        return np.asarray(middle * numerator(middle**2) < radius * denominator(middle**2))

    return _bisected(is_short, radius, min(limit, TANGENT_MAX))


def _rational(lens: FloatArray) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Return N and D of the radial factor as polynomials in the squared tangent."""
    k = np.zeros(8)
    k[: len(lens[:8])] = lens[:8]
    return np.polynomial.Polynomial([1, k[0], k[1], k[4]]), np.polynomial.Polynomial(
        [1, k[5], k[6], k[7]]
    )


def _equidistant(matrix: FloatArray, lens: FloatArray, points: FloatArray) -> Projected:
    across, z = points[:, :2], points[:, 2]
    r = np.hypot(*across.T)
    angle = np.arctan2(r, z)
    powers = angle[:, None] ** np.arange(3, 3 + 2 * len(lens), 2)
    height = angle + powers @ lens
    growth = 1 + (powers / np.where(angle > 0, angle, 1.0)[:, None]) @ (
        lens * np.arange(3, 3 + 2 * len(lens), 2)
    )
    # Distorted coordinates are s (x, y); on the axis s is 1 / z and its slopes by x and y vanish.
    off = r > _ON_AXIS * np.abs(z)
    safe = np.where(off, r, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(off, height / safe, 1 / z)
        square = r**2 + z**2
        # ds/dr over r, and ds/dz.
        by_r = np.where(off, (growth * z / square - s) / safe**2, 0.0)
        by_z = -growth / square
    by_point = np.empty((len(points), 2, 3))
    by_point[..., :2] = by_r[:, None, None] * across[:, :, None] * across[:, None, :]
    by_point[..., [0, 1], [0, 1]] += s[:, None]
    by_point[..., 2] = by_z[:, None] * across
    focal = np.diag(matrix)[:2]
    bent = s[:, None] * across
    by_intrinsics = np.zeros((len(points), 2, 4 + len(lens)))
    by_intrinsics[:, [0, 1], [0, 1]] = bent
    by_intrinsics[:, [0, 1], [2, 3]] = 1.0
    by_intrinsics[..., 4:] = (across / safe[:, None] * focal)[..., None] * powers[:, None, :]
    return Projected(bent * focal + matrix[:2, 2], by_point * focal[:, None], by_intrinsics)


def _equidistant_limit(lens: FloatArray) -> float:
    """Return the tangent of the angle at which the image height ceases to grow."""
    growth = np.polynomial.Polynomial([1.0, *(lens * np.arange(3, 3 + 2 * len(lens), 2))])
    angle = np.sqrt(_first_root(growth))
    return float(np.tan(angle)) if angle < np.pi / 2 else float("inf")


def _equidistant_tangent(lens: FloatArray, radius: FloatArray, limit: float) -> FloatArray:
    height = np.polynomial.Polynomial([1.0, *lens])

    def is_short(middle: FloatArray) -> BoolArray:
        return np.asarray(middle * height(middle**2) < radius)

    angle = _bisected(is_short, radius, float(np.arctan(min(limit, TANGENT_MAX))))
    tangent: FloatArray = np.tan(angle)
    return tangent


def _bisected(
    is_short: Callable[[FloatArray], BoolArray], radius: FloatArray, limit: float
) -> FloatArray:
    low, high = np.zeros_like(radius), np.full_like(radius, limit)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        short = is_short(middle)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return low


def _first_root(*polynomials: np.polynomial.Polynomial) -> float:
    """Return the smallest positive real root, infinite if there is none."""
    # A leading coefficient of exactly 0 would make the companion matrix infinite.
    roots = np.concatenate([p.trim().roots() for p in polynomials])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))) & (roots.real > 0)]
    return float(real.min()) if real.size else float("inf")


PROJECTIONS: Final[Mapping[ProjectionName, Projection]] = MappingProxyType(
    {
        "perspective": Projection(
            words="perspective",
            coefficients=(
                *("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
                *("s1", "s2", "s3", "s4", "tx", "ty"),
            ),
            counts=(0, 4, 5, 8, 12, 14),
            odd=frozenset({"cx", "p2", "s1", "s2", "ty"}),
            project=_perspective,
            limit=_perspective_limit,
            tangent=_perspective_tangent,
        ),
        "equidistant": Projection(
            words="equidistant (fisheye)",
            coefficients=("k1", "k2", "k3", "k4"),
            counts=(4,),
            odd=frozenset({"cx"}),
            project=_equidistant,
            limit=_equidistant_limit,
            tangent=_equidistant_tangent,
        ),
    }
)
"""The lens models, by the name that files give them."""


def coefficients_fault(projection: ProjectionName, count: int) -> str | None:
    """Return how many coefficients the lens model has if not this many; else None."""
    counts = PROJECTIONS[projection].counts
    if count in counts:
        return None
    whose = "OpenCV's models have" if projection == "perspective" else f"{projection} lenses have"
    return f"{whose} {', '.join(map(str, counts))}"
