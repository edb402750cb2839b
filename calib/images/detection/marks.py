"""Marks and dirt inside the squares of a chessboard, which pull corners where a window sees them.

A corner is symmetric, so that windows of two sizes find it at the same place but for noise. Where a
mark reaches into the larger one only, they differ, and by the same in every picture, seen on the
board. That pattern is what tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.images.detection.picture import Grey

SMALL_WINDOW_SPACINGS, SMALL_WINDOW_MIN_PX = 0.15, 3.0
"""Half of the small window, in corner spacings, and px at least: half as large as the usual one. On
a board with marks in its white squares the residuals fell from 0.19 to 0.055 px, on one without
they rose by 2 %."""

PATTERN_MIN_SPACINGS = 1e-3
"""Root mean square of the pattern, in spacings, below which it may stay: 0.04 px at 40 px."""

PATTERN_RATIO = 8.0
"""Mean square of the pattern over that which the scatter between pictures explains: four boards
without marks give 2.0 to 3.4 (a printed edge is not ideal), boards with marks 17 and 53."""

VIEWS_MIN = 4
"""Pictures without which a pattern cannot be told from chance."""

MARKER_SHARE = 0.25
"""Of the white squares that must hold a marker of one dictionary: chance finds one or two."""

_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000")
_TRIED_ON = 2


@dataclass(frozen=True)
class WindowPattern:
    """How corners of two windows differ on the board, in all pictures alike.

    Parameters
    ----------
    spacings
        Root mean square, in spacings of corners.
    px
        Root mean square of the differences, px.
    ratio
        Mean square of the pattern over that which scatter between pictures explains.
    """

    spacings: float
    px: float
    ratio: float

    @property
    def disturbed(self) -> bool:
        """Whether something inside the squares pulls corners."""
        return self.spacings > PATTERN_MIN_SPACINGS and self.ratio > PATTERN_RATIO


def small_windows(gaps: FloatArray) -> FloatArray:
    """Return half the small window, px, for spacings `gaps`, px."""
    half: FloatArray = np.maximum(np.round(SMALL_WINDOW_SPACINGS * gaps), SMALL_WINDOW_MIN_PX)
    return half


def window_pattern(
    large: Sequence[FloatArray], small: Sequence[FloatArray], board: Board
) -> WindowPattern | None:
    """Return the pattern of the differences; None where there are too few pictures.

    Parameters
    ----------
    large, small
        Corners by either window, px, shape (corners, 2) each; NaN where not found.
    """
    if len(large) < VIEWS_MIN:
        return None
    apart = np.array(
        [on_board(one, one - two, board) for one, two in zip(large, small, strict=True)]
    )
    repeated = repeated_pattern(apart)
    if repeated is None:
        return None
    differences = np.array(large) - np.array(small)
    px = float(np.sqrt(np.nanmean(differences**2)))
    return WindowPattern(spacings=repeated[0], px=px, ratio=repeated[1])


def repeated_pattern(apart: FloatArray) -> tuple[float, float] | None:
    """Return the root mean square of what repeats in all views, and its square over chance's.

    Parameters
    ----------
    apart
        Shifts along columns and rows of the board, shape (views, corners, 2); NaN where unknown.
        None is returned where no corner is in `VIEWS_MIN` of them.
    """
    count = np.isfinite(apart).sum(axis=0)
    known = count >= VIEWS_MIN
    if not known.any():
        return None
    values = apart[:, known]
    square = float(np.mean(np.nanmean(values, axis=0) ** 2))
    scatter = float(np.mean(np.nanvar(values, axis=0, ddof=1) / count[known]))
    return float(np.sqrt(square)), square / max(scatter, 1e-18)


def on_board(pixels: FloatArray, shift: FloatArray, board: Board) -> FloatArray:
    """Return shifts, px, along columns and rows of the board, in spacings, shape (corners, 2)."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    steps = np.stack([np.gradient(grid, axis=1), np.gradient(grid, axis=0)], axis=-1)
    steps = steps.reshape(-1, 2, 2)
    good = np.isfinite(steps).all(axis=(1, 2)) & np.isfinite(shift).all(axis=-1)
    found = np.full(shift.shape, np.nan)
    found[good] = np.linalg.solve(steps[good], shift[good][..., None])[..., 0]
    return found


def marker_dictionary(pictures: Sequence[Grey], board: Board) -> str | None:
    """Return the dictionary of ArUco markers that white squares hold; None if they hold none."""
    white = (board.columns + 1) * (board.rows + 1) / 2
    for name in _DICTIONARIES:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        detector = cv2.aruco.ArucoDetector(dictionary)
        for grey in pictures[:_TRIED_ON]:
            ids = detector.detectMarkers(grey)[1]
            if ids is not None and len(np.unique(ids)) > MARKER_SHARE * white:
                return name
    return None
