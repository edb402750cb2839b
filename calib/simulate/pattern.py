"""Board patterns as cells of one reflectance between lines: exact at any magnification."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board

BLACK, WHITE, SURROUNDINGS = 0.06, 0.85, 0.35
"""Reflectances: printer's ink, matt paper, the wall behind."""

MARGIN_SQUARES = 0.8
"""White rim around the squares; OpenCV's detectors want about one square."""


@dataclass(frozen=True)
class Pattern:
    """A flat pattern made of rectangles, in the board's frame.

    Parameters
    ----------
    x_mm, y_mm
        Where the reflectance may change, increasing, shapes (k,) and (l,).
    reflectance
        Shape (l + 1, k + 1): entry [j, i] holds between y_mm[j - 1], y_mm[j] and x_mm[i - 1],
        x_mm[i]; the outermost rows and columns are the surroundings.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    reflectance: FloatArray

    def outline(self, points_per_side: int = 20) -> FloatArray:
        """Return points along the rim of the sheet, mm, shape (4 points_per_side, 3), z = 0."""
        t = np.linspace(0, 1, points_per_side, endpoint=False)
        zero, one = np.zeros_like(t), np.ones_like(t)
        around = np.concatenate(
            [np.column_stack(side) for side in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))]
        )
        low = np.array([self.x_mm[0], self.y_mm[0]])
        high = np.array([self.x_mm[-1], self.y_mm[-1]])
        return np.column_stack([low + around * (high - low), np.zeros(len(around))])


def board_pattern(board: Board) -> Pattern:
    """Return the pattern of a board; its origin is the first inner corner."""
    return _chessboard(board) if board.type == "chessboard" else _charuco(board)


def _chessboard(board: Board) -> Pattern:
    rows, columns = np.indices((board.rows + 1, board.columns + 1))
    squares = np.where((rows + columns) % 2 == 0, BLACK, WHITE)
    x = board.square_mm * np.arange(-1.0, board.columns + 1)
    y = board.square_mm * np.arange(-1.0, board.rows + 1)
    return _framed(board, x, y, squares)


def _framed(board: Board, x: FloatArray, y: FloatArray, cells: FloatArray) -> Pattern:
    """Put the white rim and the surroundings around cells, shape (len(y) - 1, len(x) - 1)."""
    rim = MARGIN_SQUARES * board.square_mm
    return Pattern(
        x_mm=np.concatenate([[x[0] - rim], x, [x[-1] + rim]]),
        y_mm=np.concatenate([[y[0] - rim], y, [y[-1] + rim]]),
        reflectance=np.pad(
            np.pad(cells, 1, constant_values=WHITE), 1, constant_values=SURROUNDINGS
        ),
    )


def charuco_board(board: Board) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's description of a ChArUco board.

    Raises
    ------
    ValueError
        If the board lacks its dictionary or marker size, or OpenCV does not know the dictionary.
    """
    if board.dictionary is None or board.marker_mm is None:
        raise ValueError("a ChArUco board needs a dictionary and the side of its markers")
    number = getattr(cv2.aruco, board.dictionary, None)
    if number is None:
        raise ValueError(f"OpenCV knows no marker dictionary {board.dictionary!r}")
    made = cv2.aruco.CharucoBoard(
        (board.columns + 1, board.rows + 1),
        board.square_mm,
        board.marker_mm,
        cv2.aruco.getPredefinedDictionary(number),
    )
    made.setLegacyPattern(board.legacy)
    return made


def _charuco(board: Board) -> Pattern:
    """Return the pattern of a ChArUco board; the lines of its markers' modules cut every square."""
    made = charuco_board(board)
    dictionary = made.getDictionary()
    modules = dictionary.markerSize + 2
    markers = made.getObjPoints()
    # OpenCV's frame starts at the outer corner of the first square; in squares from there:
    places = np.array([np.mean(corners, axis=0)[:2] for corners in markers]) / board.square_mm
    inset = (board.square_mm - float(board.marker_mm or 0)) / 2
    lines = np.concatenate([[0.0], np.linspace(inset, board.square_mm - inset, modules + 1)])
    per_square = len(lines)
    x, y = (
        np.concatenate([(k * board.square_mm + lines) for k in range(n)] + [[n * board.square_mm]])
        for n in (board.columns + 1, board.rows + 1)
    )
    cells = np.full((len(y) - 1, len(x) - 1), BLACK)
    for place, number in zip(places, np.ravel(made.getIds()), strict=True):
        column, row = (int(v) * per_square for v in place)
        square = cells[row : row + per_square, column : column + per_square]
        square[:] = WHITE
        image = dictionary.generateImageMarker(int(number), modules, borderBits=1)
        square[1 : modules + 1, 1 : modules + 1] = np.where(image > 0, WHITE, BLACK)
    return _framed(board, x - board.square_mm, y - board.square_mm, cells)
