"""Straight edges in a picture, to a few hundredths of a pixel, and where two of them cross.

A plate's corner is rarely sharp enough to be measured by itself; its edges are long. Each is found
point by point along its normal and fitted as a line that a few points off it do not bend. All this
happens in the picture without distortion, where straight edges are straight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.ndimage import uniform_filter1d

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, normalise, project
from calib.images.detection.picture import Grey

PROFILE_PX: Final = 5.0
"""Half the length of the profile across an edge, px."""

PROFILE_STEP_PX: Final = 0.25

LEAST_CONTRAST: Final = 4.0
"""Grey values a pixel by which an edge must rise at its steepest."""

GRADIENT_SHARE: Final = 0.35
"""Of the steepest rise: what lies below does not count for the place of the edge."""

SECOND_SHARE: Final = 0.4
"""A second edge as steep as this share of the first makes a profile doubtful."""

APART_PX, BEYOND_PX = 2.5, 3.0
"""So far from its steepest place an edge counts, and from so far on there is another."""

NEIGHBOURS: Final = 9

TUKEY: Final = 4.685
"""Tuning constant of the biweight: 95 % efficiency for normal errors (Huber and Ronchetti 2009)."""

LEAST_SCALE_PX: Final = 0.02
ITERATIONS: Final = 30


@dataclass(frozen=True)
class EdgeLine:
    """A fitted edge, in px of the picture without distortion.

    Parameters
    ----------
    point, along
        A point on it, the centre of its points, and its unit direction, shape (2,).
    variance, spread
        Of the offset at `point`, px^2, and the sum of squares of the places of its points along
        it, px^2: with both follows the variance at any distance.
    scatter_px
        Robust standard deviation of its points.
    length_px
        Between its outermost points.
    doubtful
        Share of profiles with a second edge.
    count
        Of its points, by their weights.
    """

    point: FloatArray
    along: FloatArray
    variance: float
    spread: float
    scatter_px: float
    length_px: float
    doubtful: float
    count: float

    @property
    def normal(self) -> FloatArray:
        """Unit normal, shape (2,)."""
        return np.array([-self.along[1], self.along[0]])

    def variance_at(self, place: FloatArray) -> float:
        """Return the variance of the offset at a place, shape (2,), px^2."""
        far = float((place - self.point) @ self.along)
        return self.variance * (1 + far**2 * self.count / self.spread)


def ideal(lens: Camera | None, pixels: FloatArray) -> FloatArray:
    """Return pixels, shape (n, 2), as a lens without distortion would have them; NaN for none."""
    if lens is None:
        return pixels
    rays = normalise(lens, pixels, strict=False)
    focal = np.array([lens.matrix[0, 0], lens.matrix[1, 1]])
    centre = np.array([lens.matrix[0, 2], lens.matrix[1, 2]])
    found: FloatArray = rays * focal + centre
    return found


def real(lens: Camera | None, pixels: FloatArray) -> FloatArray:
    """Return the inverse of `ideal`, shape (n, 2)."""
    if lens is None:
        return pixels
    focal = np.array([lens.matrix[0, 0], lens.matrix[1, 1]])
    centre = np.array([lens.matrix[0, 2], lens.matrix[1, 2]])
    rays = (pixels - centre) / focal
    return project(lens, np.column_stack([rays, np.ones(len(rays))]))


def fit_line(
    grey: Grey, lens: Camera | None, start: FloatArray, end: FloatArray
) -> EdgeLine | None:
    """Return the edge along a segment; None if there is none to be seen.

    Parameters
    ----------
    grey
        Picture, shape (height, width), smoothed by some pixel.
    start, end
        Of the segment, px without distortion, shape (2,), good to a few pixels.
    """
    points, doubtful = _edge_points(grey, lens, start, end)
    if len(points) < 8:
        return None
    return _fit(points, doubtful)


def _edge_points(
    grey: Grey, lens: Camera | None, start: FloatArray, end: FloatArray
) -> tuple[FloatArray, float]:
    """Return points of the edge, one a pixel, shape (n, 2), and the share of doubtful profiles."""
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    normal = np.array([-along[1], along[0]])
    places = start + np.arange(0.0, length, 1.0)[:, None] * along
    across = np.arange(-PROFILE_PX, PROFILE_PX + 1e-9, PROFILE_STEP_PX)
    grid = places[:, None, :] + across[None, :, None] * normal
    raw = real(lens, grid.reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
    height, width = grey.shape
    inside = ((raw > 1) & (raw < np.array([width - 2, height - 2]))).all(axis=(1, 2))
    if not inside.any():
        return np.empty((0, 2)), 0.0
    raw = raw[inside]
    values = cv2.remap(
        grey, raw[..., 0].copy(), raw[..., 1].copy(), cv2.INTER_LINEAR
    ).astype(np.float64)  # fmt: skip
    rise = np.abs(np.gradient(values, PROFILE_STEP_PX, axis=1))
    steepest = rise.max(axis=1)
    clear = steepest >= LEAST_CONTRAST
    if not clear.any():
        return np.empty((0, 2)), 0.0
    rise, steepest = rise[clear], steepest[clear]
    # Only around the steepest place: a second edge in the profile is not to pull.
    peak = across[rise.argmax(axis=1)]
    near = np.abs(across[None] - peak[:, None]) <= APART_PX
    weight = np.where((rise >= GRADIENT_SHARE * steepest[:, None]) & near, rise, 0.0)
    offset = (weight * across).sum(axis=1) / weight.sum(axis=1)
    # Of neighbours together, or noise would look like an edge where there is little light.
    along_edge = uniform_filter1d(rise, NEIGHBOURS, axis=0)
    beyond = np.abs(across[None] - peak[:, None]) > BEYOND_PX
    second = np.where(beyond, along_edge, 0.0).max(axis=1) > SECOND_SHARE * along_edge.max(axis=1)
    points = places[inside][clear] + offset[:, None] * normal
    return points, float(second.mean())


def _fit(points: FloatArray, doubtful: float) -> EdgeLine:
    """Return the line through points by total least squares with Tukey's biweight."""
    weight = np.ones(len(points))
    centre, along, scale = points.mean(axis=0), np.zeros(2), 0.0
    for _ in range(ITERATIONS):
        centre = weight @ points / weight.sum()
        away = points - centre
        _, vectors = np.linalg.eigh((away * weight[:, None]).T @ away)
        along = vectors[:, 1]
        offset = away @ vectors[:, 0]
        scale = max(1.4826 * float(np.median(np.abs(offset))), LEAST_SCALE_PX)
        before = weight
        weight = np.clip(1 - (offset / (TUKEY * scale)) ** 2, 0, None) ** 2
        if np.abs(weight - before).max() < 1e-4:
            break
    away = points - centre
    offset, place = away @ np.array([-along[1], along[0]]), away @ along
    kept = weight > 0
    count = float(weight.sum())
    variance = float(weight @ offset**2) / count * _correlation(offset[kept])
    return EdgeLine(
        point=centre,
        along=along,
        variance=variance / count,
        spread=float(weight @ place**2),
        scatter_px=scale,
        length_px=float(np.ptp(place[kept])),
        doubtful=doubtful,
        count=count,
    )


def _correlation(offset: FloatArray) -> float:
    """Return by how much neighbours that err together enlarge the variance of a mean, at least 1.

    The sum of the autocorrelations up to the first negative one (Sokal's window is of no use with
    a hundred points).
    """
    away = offset - offset.mean()
    total = float(away @ away)
    factor = 1.0
    if total == 0:
        return factor
    for lag in range(1, len(away) // 2):
        rho = float(away[:-lag] @ away[lag:]) / total
        if rho <= 0:
            break
        factor += 2 * rho
    return factor


def crossing(one: EdgeLine, other: EdgeLine) -> tuple[FloatArray, FloatArray]:
    """Return where two lines cross, shape (2,), and its covariance, px^2, shape (2, 2)."""
    normals = np.stack([one.normal, other.normal])
    offsets = np.array([one.normal @ one.point, other.normal @ other.point])
    place = np.linalg.solve(normals, offsets)
    inverse = np.linalg.inv(normals)
    covariance = inverse @ np.diag([one.variance_at(place), other.variance_at(place)]) @ inverse.T
    return place, covariance
