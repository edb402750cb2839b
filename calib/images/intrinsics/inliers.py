"""Which corners of board views a fit uses: those that stand out go, largest first."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.images.checks import outlier_limit
from calib.images.detection.grid import seen
from calib.images.mrcal.solves import MIN_CORNERS

PEEL_SHARE = 0.5
"""Of a view's outliers only those beyond this share of its largest residual go in one round: a
corner far off bends the pose, and with it the residuals of good corners."""

VIEW_SHARE_MIN = 0.5
"""A view that loses more than half of its corners as outliers is dropped altogether."""


def without_outliers(residuals: FloatArray, used: BoolArray) -> BoolArray:
    """Return which corners, shape (views, corners), to use next."""
    size = np.where(used, np.abs(residuals).max(axis=-1), 0.0)
    limit = outlier_limit(np.where(used[..., None], residuals, np.nan))
    kept: BoolArray = used & (
        size <= np.maximum(limit, PEEL_SHARE * size.max(axis=-1, keepdims=True))
    )
    whole = seen(residuals).sum(axis=-1)
    kept[kept.sum(axis=-1) < np.maximum(MIN_CORNERS, VIEW_SHARE_MIN * whole)] = False
    return kept
