"""ChArUco boards: each corner is known by the markers around it, so partial views serve too."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import InputError
from calib.geometry.board import Board
from calib.images.detection.board import Found, refine
from calib.images.detection.grid import irregular, seen
from calib.images.detection.picture import Grey

CORNERS_MIN = 6
"""Fewest corners of a view in use: a homography has 8 unknowns, a corner gives 2 equations, and
two more corners check them."""

LINES_MIN = 2
"""Fewest rows and columns they must span: corners in one line leave the pose open."""


ENLARGE_SIDE_PX, ENLARGEMENT = 1300, 2
"""Pictures up to this side are enlarged before the search. On VGA with squares of 17 to 20 px that
finds 90 % of the corners instead of 71 %, to 0.055 px instead of 0.20."""

WINDOW_MARKER_SHARE = 0.8
"""Half a refinement window, as a share of the white rim of the markers: with a marker's corner in
it, a window of 0.3 spacings moved corners by 0.3 px, while this one halves the 0.04 px of OpenCV's
own choice."""

WINDOW_MIN_PX, WINDOW_MAX_PX = 5, 20
"""Half a window of 3 px loses corners to noise. Where the rim asks for less than 5, an enlarged
picture allows it nevertheless, being blurred; in others OpenCV's corner is the better one."""


INVERTED = "charuco:inverted"
"""Detector of boards whose black and white are exchanged."""


class CharucoFinder:
    """A detector for one board. Not shared between threads: OpenCV's keeps state.

    Raises
    ------
    InputError
        If the board lacks its dictionary or marker size, or OpenCV does not know the dictionary.
    """

    def __init__(self, board: Board) -> None:
        number = getattr(cv2.aruco, board.dictionary or "", None)
        if not isinstance(number, int) or not board.marker_mm:
            raise InputError.single(
                where="dataset.toml, [board]",
                what=f"a ChArUco board with dictionary {board.dictionary!r} and marker_mm "
                f"{board.marker_mm!r} cannot be looked for",
                remedy="give dictionary as OpenCV names it, like 'DICT_5X5_100', and marker_mm",
            )
        self._board = board
        self._rim = (board.square_mm - board.marker_mm) / 2 / board.square_mm
        made = cv2.aruco.CharucoBoard(
            (board.columns + 1, board.rows + 1),
            board.square_mm,
            board.marker_mm,
            cv2.aruco.getPredefinedDictionary(number),
        )
        made.setLegacyPattern(board.legacy)
        self._detector = cv2.aruco.CharucoDetector(made)

    def find(self, grey: Grey) -> Found:
        """Look for the board in a grey picture, then in its negative; corners not seen are NaN."""
        found = self._find(grey)
        if found.detector == "none":
            negative = self._find(cv2.bitwise_not(grey))
            if negative.detector != "none":
                return replace(negative, detector=INVERTED)
        return found

    def _find(self, grey: Grey) -> Found:
        factor = ENLARGEMENT if max(grey.shape) <= ENLARGE_SIDE_PX else 1
        if factor > 1:
            grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        corners, ids = self._detector.detectBoard(grey)[:2]
        pixels = np.full((self._board.corner_count, 2), np.nan)
        if ids is not None:
            pixels[np.ravel(ids)] = np.reshape(corners, (-1, 2))
        if not _suffices(seen(pixels), self._board):
            return self._nothing()
        pixels = refine(grey, pixels, self._board, partial(self._windows, enlarged=factor > 1))
        pixels = np.where(irregular(pixels, self._board)[:, None], np.nan, pixels)
        if not _suffices(seen(pixels), self._board):
            return self._nothing()
        return Found((pixels + 0.5) / factor - 0.5, "charuco")

    def _nothing(self) -> Found:
        return Found(np.full((self._board.corner_count, 2), np.nan), "none")

    def _windows(self, gaps: FloatArray, *, enlarged: bool) -> FloatArray:
        """Return half the window of corners with spacings `gaps`, px; 0 leaves a corner alone."""
        half = np.minimum(np.round(WINDOW_MARKER_SHARE * self._rim * gaps), WINDOW_MAX_PX)
        least = WINDOW_MIN_PX if enlarged else 0.0
        return np.where(half < WINDOW_MIN_PX, least, half)


def _suffices(found: BoolArray, board: Board) -> bool:
    """Whether the corners found give a pose."""
    grid = found.reshape(board.rows, board.columns)
    lines = min(int(grid.any(axis=0).sum()), int(grid.any(axis=1).sum()))
    return int(found.sum()) >= CORNERS_MIN and lines >= LINES_MIN
