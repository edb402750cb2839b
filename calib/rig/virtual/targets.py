"""What may stand before the virtual rig: boards, and targets of one point on a sheet of paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.dataset.messages import shown
from calib.geometry.board import Board
from calib.simulate.pattern import BLACK, SURROUNDINGS, WHITE, Pattern, board_pattern

TAG_PX, ARM_PX, DISC_PX = 40.0, 24.0, 12.0
"""Side of a tag, arm of a cross and diameter of a disc at the far end of the working depths."""

DISC_CELLS: Final = 60
"""A disc is made of cells so many across, finer than any pixel that sees it."""


@dataclass(frozen=True)
class Sheet:
    """A target as it is printed.

    Parameters
    ----------
    board
        The board; for a target of one point a board of 3 x 3 corners of the sheet's size, whose
        middle corner is the target.
    pattern
        What is printed, in the board's frame.
    """

    board: Board
    pattern: Pattern


def sheet(kind: str, board: Board, *, pixel_mm: float) -> Sheet:
    """Return a target.

    Parameters
    ----------
    kind
        "board", "tag:DICTIONARY:ID", "cross" or "blob", as `[virtual] target` names it.
    board
        Taken for "board".
    pixel_mm
        What a pixel of C1 sees at the far end of the working depths, mm.

    Raises
    ------
    UsageError
        If there is no such target.
    """
    if kind == "board":
        return Sheet(board, board_pattern(board))
    if kind == "cross":
        return _plain(np.array([-1.5, -1, 0, 1, 1.5]) * ARM_PX * pixel_mm, _cross())
    if kind == "blob":
        edges = np.linspace(-1.5, 1.5, DISC_CELLS + 1) * DISC_PX * pixel_mm
        return _plain(edges, _disc())
    if kind.startswith("tag:"):
        cells = _tag(kind)
        modules = len(cells) - 4
        edges = (np.arange(len(cells) + 1) - len(cells) / 2) * TAG_PX * pixel_mm / modules
        return _plain(edges, cells)
    raise UsageError(
        f"rig.toml, [virtual] target: {shown(kind)} is not known; write 'board', "
        "'tag:DICT_APRILTAG_36h11:7', 'cross' or 'blob'"
    )


def _plain(edges: FloatArray, cells: FloatArray) -> Sheet:
    """Return the sheet of cells between edges, mm, centred on its middle."""
    side = float(edges[-1])
    board = Board("chessboard", 3, 3, side / 2, (1, 1))
    lines = edges + board.square_mm
    return Sheet(board, Pattern(lines, lines, np.pad(cells, 1, constant_values=SURROUNDINGS)))


def _cross() -> FloatArray:
    cells = np.full((4, 4), WHITE)
    cells[1, 1] = cells[2, 2] = BLACK
    return cells


def _disc() -> FloatArray:
    middles = (np.arange(DISC_CELLS) + 0.5) / DISC_CELLS * 3 - 1.5
    x, y = np.meshgrid(middles, middles)
    return np.where(np.hypot(x, y) < 0.5, BLACK, WHITE)


def _tag(kind: str) -> FloatArray:
    _, name, number = [*kind.split(":"), "", ""][:3]
    known = getattr(cv2.aruco, name, None)
    if known is None or not number.isdecimal():
        raise UsageError(
            f"rig.toml, [virtual] target: {shown(kind)} names no tag; write "
            "'tag:DICT_APRILTAG_36h11:7', a dictionary of OpenCV and a number in it"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(known)
    if int(number) >= len(dictionary.bytesList):
        raise UsageError(f"rig.toml, [virtual] target: {name} has no tag {number}")
    modules = dictionary.markerSize + 2
    image = dictionary.generateImageMarker(int(number), modules, borderBits=1)
    cells = np.full((modules + 4, modules + 4), WHITE)
    cells[2:-2, 2:-2] = np.where(image > 0, WHITE, BLACK)
    return cells
