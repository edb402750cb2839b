"""What the stages of board images ask of their solutions."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.core.gate import Gate
from calib.geometry.board import Board

RMS_LIMIT_PX = 1.0
"""Corners of a printed board in a sharp picture are found to 0.05 to 0.3 px; images that do not
belong together, or a board miscounted, leave several pixels."""

REJECTED_LIMIT = 0.1
"""A board or lens model that does not fit hides behind outlier rejection: 23 % were discarded on a
fisheye while the rms stayed at 0.8 px. Real boards lose 1 to 3 %."""

SINGLE_VIEW_RMS_PX = 5.0
"""A board of the right size fits a single view to 0.5 px even with a poor lens model; one with a
column or row more or less than stated misses by a good part of a square, 10 px and more."""

OUTLIER_SIGMAS = 5.0
"""A coordinate this many robust standard deviations off is an outlier: 1 of 10^6 normal errors."""

SIGMA_OF_MEDIAN = 1.4826
"""Standard deviation of a normal error over the median of its size."""


def outlier_limit(residuals: FloatArray) -> float:
    """Return the size, px, at which a residual is an outlier among these; NaN are left out."""
    return OUTLIER_SIGMAS * SIGMA_OF_MEDIAN * float(np.nanmedian(np.abs(residuals)))


def gate(name: str, passed: bool, detail: str, *, remedy: str) -> Gate:
    """Return a gate whose detail ends in the remedy where it failed."""
    return Gate(name, bool(passed), detail if passed else f"{detail}; {remedy}")


def fit_gate(
    name: str, residuals: FloatArray, rejected: int, *, remedy: str, left_out: str = ""
) -> Gate:
    """Gate on the residuals, px, shape (..., 2), NaN where missing or rejected.

    Parameters
    ----------
    rejected
        Number of corners discarded as outliers, those of pictures left out whole not counted.
    left_out
        What was left out whole, in words; empty for nothing.
    """
    kept = int(np.isfinite(residuals).sum()) // 2
    share = rejected / (kept + rejected)
    rms = float(np.sqrt(np.nanmean(residuals**2)))
    return gate(
        name,
        rms <= RMS_LIMIT_PX and share <= REJECTED_LIMIT,
        f"rms {rms:.3f} px per coordinate (limit {RMS_LIMIT_PX:g}), {100 * share:.1f} % of corners "
        f"rejected (limit {100 * REJECTED_LIMIT:.0f}){f'; {left_out}' if left_out else ''}",
        remedy=remedy,
    )


def require_board(board: Board, errors: FloatArray, *, where: str) -> None:
    """Raise EstimationError if single views, rms px, shape (n,), do not show the stated board."""
    missed = float(np.median(errors))
    if missed > SINGLE_VIEW_RMS_PX:
        raise EstimationError(
            f"{where}: in the median view a board of {board.columns} x {board.rows} inner corners "
            f"misses the corners found by {missed:.1f} px rms; check [board] columns and rows, and "
            "that the intrinsics are this camera's"
        )
