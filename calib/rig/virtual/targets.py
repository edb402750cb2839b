"""What may stand before the virtual rig: boards, targets of one point on a sheet, plates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
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

METAL: Final = 0.7
"""Reflectance of a plate."""

ROUND_CELL_MM: Final = 0.5
"""A round corner is made of cells of this size."""

PLATE_MOST_MM: Final = 1e5


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
    corners_mm
        Of a plate, where its corners would be if they were sharp, in the board's frame, shape (3,)
        each, by the names of `calib.gaze.plate`.
    """

    board: Board
    pattern: Pattern
    corners_mm: Mapping[str, FloatArray] = field(default_factory=dict)


def sheet(kind: str, board: Board, *, pixel_mm: float) -> Sheet:
    """Return a target.

    Parameters
    ----------
    kind
        "board", "tag:DICTIONARY:ID", "cross", "blob" or "plate:LENGTH,HEIGHT,RADIUS", as `[virtual]
        target` names it.
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
    if kind.startswith("plate:"):
        return _plate(kind)
    raise UsageError(
        f"rig.toml, [virtual] target: {shown(kind)} is not known; write 'board', "
        "'tag:DICT_APRILTAG_36h11:7', 'cross', 'blob' or 'plate:1400,500,10'"
    )


def _plain(edges: FloatArray, cells: FloatArray) -> Sheet:
    """Return the sheet of cells between edges, mm, centred on its middle."""
    side = float(edges[-1])
    board = Board("chessboard", 3, 3, side / 2, (1, 1))
    lines = edges + board.square_mm
    return Sheet(board, Pattern(lines, lines, np.pad(cells, 1, constant_values=SURROUNDINGS)))


def _plate(kind: str) -> Sheet:
    """Return a bare plate with rounded corners; its middle is the target."""
    try:
        length, height, radius = (float(text) for text in kind.removeprefix("plate:").split(","))
    except ValueError:
        length = height = radius = -1.0
    if not (0 <= radius < min(length, height) / 2 < PLATE_MOST_MM):
        raise UsageError(
            f"rig.toml, [virtual] target: {shown(kind)} is no plate; write length, height and "
            "radius of the corners in mm, such as 'plate:1400,500,10'"
        )
    board = Board("chessboard", 3, 3, height / 2, (1, 1))
    steps = np.linspace(0, radius, round(radius / ROUND_CELL_MM) + 1)
    x, y = (np.unique(np.r_[-side / 2 + steps, side / 2 - steps]) for side in (length, height))
    middle_x, middle_y = np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
    beyond = [
        np.maximum(np.abs(middle) - side / 2 + radius, 0)
        for middle, side in ((middle_x, length), (middle_y, height))
    ]
    cells = np.where(np.hypot(*beyond) <= radius, METAL, SURROUNDINGS)
    at = board.square_mm
    corners = {
        f"{side}-{end}": np.array([at + i * length / 2, at + j * height / 2, 0.0])
        for side, i in (("left", -1), ("right", 1))
        for end, j in (("upper", -1), ("lower", 1))
    }
    pattern = Pattern(x + at, y + at, np.pad(cells, 1, constant_values=SURROUNDINGS))
    return Sheet(board, pattern, corners)


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
