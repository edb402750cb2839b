"""Chessboards in one picture: the detectors, and the refinement all of them share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.board import Board
from calib.images.detection.grid import canonical, irregular, seen, smooth_grid, spacing, squares
from calib.images.detection.marks import small_windows
from calib.images.detection.picture import Grey

SEARCH_SIDE_PX = 640
"""Longer side of the picture in which the classic detector looks first: it then takes 1 ms for any
image, and finds as many boards as at full size (20 of 20 rendered, 19 of 20 hard ones)."""

SECTOR_SIDE_PX = 1280
"""Longer side for the sector-based detector: 0.1 s there, 2 s at 12 MP."""

WINDOW_SPACINGS = 0.3
"""Half a refinement window, in corner spacings: neighbours stay out of it at any roll."""

WINDOW_MIN_PX, WINDOW_MAX_PX = 5, 20
"""Bounds of half a window. Under 5 px noise of 10 grey values moves corners by a pixel; over 20 px
a window gains nothing and costs its area."""

WINDOW_LIMIT_SPACINGS = 0.45
"""A small board may ask for less than `WINDOW_MIN_PX`: here a window meets its neighbour's."""

SMOOTHING_SPACINGS, SMOOTHING_MAX_PX = 0.06, 1.5
"""Standard deviation of the smoothing before refinement. The gradient-based refinement weights
noise with its square: smoothing took 12 MP corners from 0.027 to 0.015 px and bends none, as a
corner is symmetric."""

WRONG_SHARE_MAX = 0.1
"""Share of corners that may be off the grid, and then missing, in a board that counts as found."""

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SECTOR = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-3)

Finder = Callable[[Grey, Board], FloatArray | None]


@dataclass(frozen=True)
class Found:
    """A board in a picture.

    Parameters
    ----------
    pixels
        Shape (corners, 2), px, board order; NaN where a corner was not found.
    detector
        As in `calib.geometry.board.Corners`.
    goes_on
        Whether the chessboard has more squares than declared.
    small
        The corners by a small refinement window; None where the detector has none of its own.
    """

    pixels: FloatArray
    detector: str
    goes_on: bool = False
    small: FloatArray | None = None


def _missing(board: Board) -> Found:
    return Found(np.full((board.corner_count, 2), np.nan), "none")


def find_chessboard(grey: Grey, board: Board, *, detector: str = "cascade") -> Found:
    """Look for a chessboard in a grey picture, shape (height, width).

    Parameters
    ----------
    detector
        A key of `CHESSBOARD_DETECTORS`. "cascade" tries the classic and then the sector-based one;
        both end in the same refinement. A single one may be forced; "sector" then keeps the corners
        that OpenCV's findChessboardCornersSB gives.
    """
    for name, finder, refined in CHESSBOARD_DETECTORS[detector]:
        coarse = finder(grey, board)
        if coarse is None:
            continue
        pixels = _settle(grey, coarse, board) if refined else _unless_irregular(coarse, board)
        if pixels is None:
            continue
        complete = np.where(np.isfinite(pixels), pixels, smooth_grid(pixels, board))
        verdict = squares(grey, complete, board)
        if verdict.is_board:
            ordered = canonical(pixels, verdict, board)
            small = refine(grey, ordered, board, small_windows) if refined else None
            return Found(ordered, name, verdict.goes_on, small)
    return _missing(board)


def _unless_irregular(pixels: FloatArray, board: Board) -> FloatArray | None:
    return None if irregular(pixels, board).any() else pixels


def _settle(grey: Grey, coarse: FloatArray, board: Board) -> FloatArray | None:
    """Refine corners; give those that went astray a second start; drop the ones still astray.

    Returns None where too many are wrong for the grid to be the board.
    """
    pixels = refine(grey, coarse, board)
    astray = irregular(pixels, board)
    if astray.any():
        start = np.where(astray[:, None], smooth_grid(pixels, board), pixels)
        pixels = refine(grey, start, board)
        pixels = np.where(irregular(pixels, board)[:, None], np.nan, pixels)
    # A window that reaches over the border sees an edge that is none.
    pixels = np.where(_near_border(pixels, grey)[:, None], np.nan, pixels)
    lost = ~seen(pixels)
    return None if lost.sum() > WRONG_SHARE_MAX * board.corner_count else pixels


def _near_border(pixels: FloatArray, grey: Grey) -> BoolArray:
    """Return which corners lie nearer to the border than the smallest window reaches."""
    height, width = grey.shape
    inside = (pixels >= WINDOW_MIN_PX) & (pixels <= np.array([width, height]) - 1 - WINDOW_MIN_PX)
    return np.asarray(~inside.all(axis=-1))


def _chessboard_windows(gaps: FloatArray) -> FloatArray:
    """Return half the refinement window, px, for spacings `gaps`, px, of a chessboard."""
    half = np.clip(np.round(WINDOW_SPACINGS * gaps), WINDOW_MIN_PX, WINDOW_MAX_PX)
    limited: FloatArray = np.minimum(half, np.floor(WINDOW_LIMIT_SPACINGS * gaps))
    return limited


def refine(
    grey: Grey,
    pixels: FloatArray,
    board: Board,
    windows: Callable[[FloatArray], FloatArray] = _chessboard_windows,
) -> FloatArray:
    """Return corners refined to sub-pixels by OpenCV's cornerSubPix, px, shape (corners, 2).

    Missing corners stay missing, and those whose window is under 2 px as they are.

    Parameters
    ----------
    windows
        Gives half the window of each corner, px, from the spacing around it, px, both shape (n,).
    """
    gaps = spacing(pixels, board)
    half = np.zeros_like(gaps)
    half[np.isfinite(gaps)] = windows(gaps[np.isfinite(gaps)])
    found = half >= 2
    if not found.any():
        return pixels
    half = half[found]
    sigma = min(SMOOTHING_SPACINGS * float(np.median(gaps[found])), SMOOTHING_MAX_PX)
    picture, origin = _smoothed_part(grey, pixels[found], reach=int(half.max()), sigma=sigma)
    at = (pixels[found] - origin).astype(np.float32)
    for size in np.unique(half):
        chosen = half == size
        part = np.ascontiguousarray(at[chosen]).reshape(-1, 1, 2).copy()
        cv2.cornerSubPix(picture, part, (int(size), int(size)), (-1, -1), _CRITERIA)
        at[chosen] = part.reshape(-1, 2)
    refined = pixels.copy()
    refined[found] = at.astype(np.float64) + origin
    return refined


def _smoothed_part(
    grey: Grey, pixels: FloatArray, *, reach: int, sigma: float
) -> tuple[Grey, FloatArray]:
    """Return the smoothed part of a picture around some pixels, and its first pixel (u, v)."""
    margin = 2 * reach + math.ceil(3 * sigma) + 2
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - margin, 0, None)
    high = np.ceil(pixels.max(axis=0)).astype(int) + margin
    part = grey[low[1] : high[1], low[0] : high[0]]
    return cv2.GaussianBlur(part, (0, 0), sigma), low.astype(np.float64)


def _reduced(grey: Grey, factor: int) -> Grey:
    """Return a picture made smaller by a whole factor, each pixel the mean of its square."""
    if factor == 1:
        return grey
    height, width = grey.shape[0] // factor, grey.shape[1] // factor
    whole = grey[: height * factor, : width * factor]
    small: Grey = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return small


def _enlarged(corners: FloatArray, factor: int) -> FloatArray:
    """Return pixels of a picture reduced by `factor` as pixels of the whole one, (corners, 2)."""
    pixels: FloatArray = (corners.reshape(-1, 2).astype(np.float64) + 0.5) * factor - 0.5
    return pixels


def _search_classic(grey: Grey, board: Board) -> FloatArray | None:
    """Run findChessboardCorners on a pyramid, from small to large; None if no board."""
    size = (board.columns, board.rows)
    factor = max(1, round(max(grey.shape) / SEARCH_SIDE_PX))
    while True:
        found, corners = cv2.findChessboardCorners(_reduced(grey, factor), size, flags=_CLASSIC)
        if found:
            return _enlarged(corners, factor)
        if factor == 1 or max(grey.shape) / factor > SECTOR_SIDE_PX:
            return None
        factor = factor // 2


def _search_sector(grey: Grey, board: Board) -> FloatArray | None:
    """Run findChessboardCornersSB on a picture of at most `SECTOR_SIDE_PX`; None if no board."""
    factor = math.ceil(max(grey.shape) / SECTOR_SIDE_PX)
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(_reduced(grey, factor), size, flags=_SECTOR)
    return _enlarged(corners, factor) if found else None


def _measure_sector(grey: Grey, board: Board) -> FloatArray | None:
    """Run findChessboardCornersSB as accurately as it can, at full size; None if no board."""
    size, flags = (board.columns, board.rows), _SECTOR | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    return _enlarged(corners, 1) if found else None


CHESSBOARD_DETECTORS: Mapping[str, tuple[tuple[str, Finder, bool], ...]] = MappingProxyType(
    {
        "cascade": (
            ("cascade:classic", _search_classic, True),
            ("cascade:sector", _search_sector, True),
        ),
        "classic": (("classic", _search_classic, True),),
        "sector": (("sector", _measure_sector, False),),
    }
)
"""What each choice of detector tries in turn: name recorded, search, whether to refine."""


def other_count(grey: Grey, board: Board) -> Board | None:
    """Return a board with one corner more or less a side that is seen instead, if there is one."""
    for columns, rows in ((-1, 0), (0, -1), (1, 0), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)):
        other = replace(board, columns=board.columns + columns, rows=board.rows + rows)
        if min(other.columns, other.rows) < 3:
            continue
        found = find_chessboard(grey, other, detector="classic")
        if found.detector != "none" and not found.goes_on:
            return other
    return None
