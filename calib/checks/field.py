"""Whether the lens of C1 is known where the rows look."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.geometry.camera import project
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.intrinsics.gates import FIELD_STD_MAX
from calib.results.calibration import GazeResult

NAMED = 5
"""Rows that are named at most."""


def field_gate(lens: Intrinsics, gaze: GazeResult) -> Gate:
    """Gate on the uncertainty of C1's projection where rows look."""
    xy = np.stack([gaze.rows.x1c, gaze.rows.y1c], axis=1)
    limit = 2 * FIELD_STD_MAX
    relative = projection_std(lens, xy) / float(lens.camera.matrix[0, 0])
    # Where the lens model has no ray nothing is known.
    bad = np.flatnonzero(~(relative <= limit))
    worst = float(np.nan_to_num(relative, nan=np.inf).max())
    detail = (
        f"where rows look the projection of C1 is certain to {100 * worst:.3f} % of its focal "
        f"length at worst (limit {100 * limit:g})"
    )
    if len(bad):
        named = ", ".join(gaze.rows.ids[i] for i in bad[:NAMED]) + (
            ", ..." if len(bad) > NAMED else ""
        )
        detail = (
            f"{len(bad)} rows look where the lens of C1 is not known, its projection uncertain by "
            f"more than {100 * limit:g} % of the focal length ({named}); take pictures for the "
            "lens with the board there"
        )
    return Gate("c1-field", passed=not len(bad), detail=detail)


def projection_std(lens: Intrinsics, xy: FloatArray) -> FloatArray:
    """Return how uncertain the projection is, px, at directions, shape (n, 2): the nearest node's.

    NaN outside the imager and where the lens model has no ray.
    """
    pixels = project(lens.camera, xy)
    grid = lens.uncertainty.pixels
    step = grid[1, 1] - grid[0, 0]
    place = np.round(pixels / step)
    rows, columns = grid.shape[:2]
    std = np.full(len(xy), np.nan)
    with np.errstate(invalid="ignore"):
        inside = ((place >= 0) & (place < [columns, rows])).all(axis=-1)
    at = place[inside].astype(int)
    std[inside] = lens.uncertainty.std_px[at[:, 1], at[:, 0]]
    return std
