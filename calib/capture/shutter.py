"""The shutter of guided captures: released when a picture of the board is worth taking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.images.bundle import finite
from calib.images.detection.board import find_chessboard
from calib.images.detection.charuco import CharucoFinder
from calib.images.detection.picture import Grey
from calib.images.repeats import repeat_clusters

COMPLETE: Final = {"chessboard": 0.9, "charuco": 0.5}
"""Share of the corners that must be found. A chessboard is seen whole or wrongly."""

STILL_PX: Final = 0.3
"""Root mean square shift of the corners between two pictures; more, and an exposure of a third of
the time between them blurs corners by what they can be found to."""

EDGE_PX, EDGE_SPACINGS = 4.0, 0.15
"""Width of the edges of squares, px, or in spacings of corners: the wider is still sharp. Sharp
lenses make 2 px; a refinement window of 0.3 spacings must hold the edge."""

WORTH: Final = 0.5
"""Least share of what the pose asked for would bring."""

GAUSSIAN: Final = 1.02
"""Width of a Gaussian edge, 2.56 standard deviations, over its rise by its slope, 2.51 of them."""

PROFILE_PX, PROFILE_STEP = 0.35, 0.25
"""Half the way over which an edge is looked at, in spacings, and its step, px."""


@dataclass(frozen=True)
class View:
    """A picture of the board.

    Parameters
    ----------
    corners
        In board order, px, shape (corners, 2); NaN where not found.
    edge_px
        Width of the edges of its squares, from 10 to 90 %, median, px; NaN if not to be told.
    """

    corners: FloatArray
    edge_px: float

    @property
    def is_seen(self) -> bool:
        """Whether there is a board at all."""
        return bool(np.isfinite(self.corners).any())


class Finder:
    """Looks for one board in pictures of one size."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._charuco = CharucoFinder(board) if board.type == "charuco" else None

    def view(self, grey: Grey) -> View:
        """Return what a picture, shape (height, width), shows of the board."""
        if self._charuco is not None:
            corners = self._charuco.find(grey).pixels
        else:
            corners = find_chessboard(grey, self._board).pixels
        return View(corners, edge_width(grey, corners, self._board))


def edge_width(grey: Grey, corners: FloatArray, board: Board) -> float:
    """Return the width of the edges between squares, from 10 to 90 % of their rise, median, px.

    Across the middle of each side between two corners: the rise over the steepest
    slope, times `GAUSSIAN`.
    """
    grid = corners.reshape(board.rows, board.columns, 2)
    ends = [(grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])]
    start = np.concatenate([one.reshape(-1, 2) for one, _ in ends])
    end = np.concatenate([other.reshape(-1, 2) for _, other in ends])
    both = finite(start) & finite(end)
    if not both.any():
        return float("nan")
    along = (end - start)[both]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length
    half = max(2.0, PROFILE_PX * float(np.median(length)))
    way = np.arange(-half, half + PROFILE_STEP / 2, PROFILE_STEP)
    at = ((start + end)[both] / 2)[:, None] + way[:, None] * across[:, None]
    lines = cv2.remap(
        grey, at[..., 0].astype(np.float32), at[..., 1].astype(np.float32), cv2.INTER_LINEAR
    ).astype(np.float64)
    rise = lines.max(axis=1) - lines.min(axis=1)
    # Noise makes single slopes steep: the slope over a pixel.
    span = round(1 / PROFILE_STEP)
    slope = np.abs(lines[:, span:] - lines[:, :-span]).max(axis=1)
    return float(np.median(GAUSSIAN * rise / np.maximum(slope, 1e-9)))


class Shutter:
    """Judges the pictures of a camera, one after the other.

    Parameters
    ----------
    board
        The board.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self._points = board.object_points()
        self._before: FloatArray | None = None

    def start(self) -> None:
        """Begin anew, for another pose."""
        self._before = None

    def fault(self, view: View, taken: FloatArray) -> str:
        """Return why a picture is not to be taken yet; "" if it is to be.

        Parameters
        ----------
        taken
            Corners of the pictures taken, px, shape (v, corners, 2).
        """
        before, self._before = self._before, view.corners if view.is_seen else None
        if not view.is_seen:
            return "the board is not seen"
        share = float(finite(view.corners).mean())
        if share < COMPLETE[self._board.type]:
            return f"only {100 * share:.0f} % of the corners are seen"
        if before is None or shift(before, view.corners) > STILL_PX:
            return "hold it still"
        if not view.edge_px <= max(EDGE_PX, EDGE_SPACINGS * spacing(view.corners, self._board)):
            return f"blurred: edges of {view.edge_px:.1f} px"
        if self._repeats(view, taken):
            return "nearly the same as a picture taken"
        return ""

    def _repeats(self, view: View, taken: FloatArray) -> bool:
        all_views = np.concatenate([taken, view.corners[None]])
        clusters = repeat_clusters(all_views, self._points)
        return bool((clusters[:-1] == clusters[-1]).any())


def shift(one: FloatArray, other: FloatArray) -> float:
    """Return the root mean square shift of corners, px, shape (corners, 2); inf if none shared."""
    both = finite(one) & finite(other)
    if not both.any():
        return float("inf")
    return float(np.sqrt(np.mean(np.sum((one - other)[both] ** 2, axis=-1))))


def spacing(corners: FloatArray, board: Board) -> float:
    """Return the median spacing of neighbouring corners in a row, px."""
    gaps = np.diff(corners.reshape(board.rows, board.columns, 2), axis=1)
    return float(np.nanmedian(np.hypot(gaps[..., 0], gaps[..., 1])))
