"""Where a target may stand: in both fields of view and at a reachable yaw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.camera import Camera, normalise
from calib.geometry.parameters import INDEX
from calib.geometry.plane import gaze_at

FIELD_USED = 0.95
"""Share of a field of view that is offered: a target at the very edge is easily cut off."""

GRID_ACROSS, GRID_HIGH, GRID_DEEP = 13, 3, 12
"""Candidates across and over C1's image and in depth; finer ones change u(z) by under 2 %."""

ROUNDING = 1e-9
"""Normalised coordinates this little outside the field are on its edge, found through a depth."""

CLEAR = 2.0
"""Eccentricities that a target must be away from the yaw axis: nearer than one, no gaze plane
reaches it, and near that it says nothing of use."""

_AXIS_X, _AXIS_Z, _OFFSET = (
    INDEX[name] for name in ("baseline_mm", "axis_z_mm", "eccentricity_mm")
)


@dataclass(frozen=True)
class Field:
    """The space in which targets can be seen and gazed at.

    Parameters
    ----------
    x1c, y1c
        Least and greatest usable normalised coordinate in C1.
    half_height_c2
        Greatest usable |y| of a target in C2, normalised; infinite where C2 is not known. Across,
        C2 turns to the target.
    yaw_rad
        Least and greatest reading.
    """

    x1c: tuple[float, float]
    y1c: tuple[float, float]
    half_height_c2: float
    yaw_rad: tuple[float, float]

    def across(self, share: FloatArray) -> FloatArray:
        """Return x1c at shares -1 to 1 of the field, same shape."""
        low, high = self.x1c
        x: FloatArray = (low + high) / 2 + share * (high - low) / 2
        return x

    @property
    def level(self) -> float:
        """The usable y1c nearest to C1's axis."""
        low, high = self.y1c
        return min(max(low, 0.0), high)

    def holds(self, theta: FloatArray, points: FloatArray) -> BoolArray:
        """Return which points, frame C1, mm, shape (m, 3), can be gazed at."""
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        inside = (x >= self.x1c[0] - ROUNDING) & (x <= self.x1c[1] + ROUNDING)
        inside &= (y >= self.y1c[0] - ROUNDING) & (y <= self.y1c[1] + ROUNDING)
        # C2 looks straight at the target: its distance is that from the yaw axis, near enough.
        axis_x, axis_z, offset = theta[[_AXIS_X, _AXIS_Z, _OFFSET]]
        away = np.hypot(points[:, 0] - axis_x, points[:, 2] - axis_z)
        inside &= np.abs(points[:, 1]) <= self.half_height_c2 * away
        # A target at the axis itself is gazed at by no reading.
        inside &= away > CLEAR * np.abs(offset)
        reading = gaze_at(theta, points[inside]).alpha2
        held: BoolArray = inside.copy()
        held[inside] = (reading >= self.yaw_rad[0]) & (reading <= self.yaw_rad[1])
        return held

    def grid(self, theta: FloatArray, depths_mm: tuple[float, float], *, high: bool) -> FloatArray:
        """Return candidate targets, frame C1, mm, shape (m, 3).

        Evenly spaced in x1c, and in 1 / z, as which depth enters the misclosure.

        Parameters
        ----------
        high
            Whether targets at several heights are of use to the model; else all are at `level`.
        """
        z = 1 / np.linspace(1 / depths_mm[0], 1 / depths_mm[1], GRID_DEEP)
        x = np.linspace(*self.x1c, GRID_ACROSS)
        y = np.linspace(*self.y1c, GRID_HIGH) if high else np.array([self.level])
        each: FloatArray = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
        points = each[:, 2:] * np.column_stack([each[:, :2], np.ones(len(each))])
        return points[self.holds(theta, points)]


def field_of(
    c1: Camera | None,
    c2: Camera | None,
    *,
    seen_x1c: FloatArray,
    seen_y1c: FloatArray,
    yaw_rad: tuple[float, float],
) -> Field:
    """Return the field: C1's image where C1 is known, else the range that the rows span.

    Parameters
    ----------
    seen_x1c, seen_y1c
        Of the rows so far, shape (n,); used where C1 is not known.
    """
    if c1 is not None:
        x, y = _image(c1)
    else:
        x = (float(seen_x1c.min()), float(seen_x1c.max()))
        y = (float(seen_y1c.min()), float(seen_y1c.max()))
    half = float("inf") if c2 is None else float(min(abs(v) for v in _image(c2)[1]))
    return Field(x, y, half, yaw_rad)


def _image(camera: Camera) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the usable normalised x and y through the middle of a camera's image."""
    width, height = camera.image_size
    cx, cy = float(camera.matrix[0, 2]), float(camera.matrix[1, 2])
    edges = np.array([[0.0, cy], [width - 1, cy], [cx, 0], [cx, height - 1]])
    centre = np.array([cx, cy])
    seen = normalise(camera, centre + FIELD_USED * (edges - centre))
    return (float(seen[0, 0]), float(seen[1, 0])), (float(seen[2, 1]), float(seen[3, 1]))
