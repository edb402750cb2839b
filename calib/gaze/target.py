"""What can be gazed at, and how it is found in one picture.

Whatever follows a target, its position is measured by the target's own detector alone, and where
the target has a name (a tag, a ChArUco corner) it is known by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Protocol, Self

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.dataset.manifest import DICTIONARIES
from calib.dataset.messages import suggestion
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.images.detection.board import find_chessboard
from calib.images.detection.charuco import CharucoFinder
from calib.images.detection.picture import Grey

KINDS: Final = (
    "board", "corner:COLUMN,ROW", "tag:DICTIONARY:ID", "blob", "cross", "plate:CORNER",
)  # fmt: skip
"""Targets as a user names them."""

DARK_SHARE: Final = 0.5
"""A pixel belongs to a dark spot below this share of the way from the darkest grey to the usual."""

BLOB_MIN_PX, BLOB_MAX_SHARE = 20, 0.1
"""Smallest area of a blob, and largest as a share of the picture."""

ROUNDNESS_MIN: Final = 0.8
"""Least 4 pi area / perimeter^2 of a blob: a disc at 45 degrees still has 0.9."""

CROSS_WINDOW_PX: Final = 12
"""Half the window in which the arms of a cross are balanced."""

TAG_WINDOW_SHARE, TAG_WINDOW_PX = 0.15, (3, 12)
"""Half the window that refines a tag's corners, as a share of its side, and its bounds."""


@dataclass(frozen=True)
class TargetObservation:
    """A target in a picture.

    Parameters
    ----------
    pixel
        Its centre, px, shape (2,).
    floor_px
        Standard uncertainty of a coordinate that does not average out over pictures at rest, px:
        what the detector is off by for the place of the target between pixels. Measured on
        rendered pictures, see docs/rig.md.
    size_px
        Mean spacing of its corners, or its diameter, px.
    marks_px
        Points by which it was found, px, shape (n, 2), NaN where not seen: a board's corners, a
        tag's, the ends of a plate's edges. To look at.
    """

    pixel: FloatArray
    floor_px: float
    size_px: float
    marks_px: FloatArray = field(default_factory=lambda: np.empty((0, 2)), compare=False)


class Target(Protocol):
    """Something that can be found in a picture."""

    @property
    def name(self) -> str:
        """As the user named it."""

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where it is, shape (height, width) of the picture; None if it is not seen."""

    def through(self, lens: Camera) -> Target:
        """Return the target as it is found in the pictures of a lens."""

    def fault(self, grey: Grey) -> str:
        """Return why it is not seen in a picture as far as that can be said; "" else."""


class _AnyLens:
    """A target so small that no lens bends it, and of which a picture says nothing else."""

    def through(self, lens: Camera) -> Self:  # noqa: ARG002 - of the protocol
        """Return the target itself."""
        return self

    def fault(self, grey: Grey) -> str:  # noqa: ARG002 - of the protocol
        """Return nothing."""
        return ""


FLOOR_PX: Final = 0.025
"""Standard uncertainty of a large and sharp target's coordinate that repeats do not show. On
rendered pictures of 640 x 480 px, 60 poses a kind, tilted up to 30 degrees: tags of 24, 48 and 80
px 0.034, 0.022 and 0.020 px; crosses with arms of 24 and 40 px 0.021 and 0.023; discs of 12 and 24
px 0.024 and 0.054."""

CORNER_FLOOR: Final = (0.008, 0.26, 1.2)
"""The same of chessboard corners, the root of the sum of squares of a constant, px, a part that
falls with the side of a square, px times px, and one with its square. Rendered,
100 poses each: squares of 6, 8, 12, 18, 28, 36 px 0.054, 0.038, 0.024, 0.018, 0.013, 0.011."""


def _corner_floor(spacing_px: float) -> float:
    """Return a corner's floor, px; small squares leave it little edge to be found by."""
    constant, linear, square = CORNER_FLOOR
    return math.hypot(constant, linear / spacing_px, square / spacing_px**2)


def _tag_floor(side_px: float) -> float:
    return max(FLOOR_PX, 0.8 / side_px)


def _blob_floor(diameter_px: float) -> float:
    """Return a disc's floor, px: the image of its centre is not the centre of its image."""
    return float(np.hypot(FLOOR_PX, 8e-5 * diameter_px**2))


@dataclass(frozen=True)
class BoardCorner(_AnyLens):
    """One corner of a chessboard or ChArUco board."""

    board: Board
    name: str = "board"

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where the corner is; None if the board or this corner is not seen."""
        pixels = board_corners(grey, self.board)
        pixel = pixels[self.board.target_index]
        if not np.isfinite(pixel).all():
            return None
        size = _spacing(pixels, self.board)
        return TargetObservation(pixel, _corner_floor(size), size, pixels)


def board_corners(grey: Grey, board: Board) -> FloatArray:
    """Return a board's corners in a picture, px, shape (corners, 2); NaN where not seen."""
    """Return the corners of a board in a picture, px, (corners, 2); NaN where not found."""
    if board.type == "charuco":
        return CharucoFinder(board).find(grey).pixels
    return find_chessboard(grey, board).pixels


def _spacing(pixels: FloatArray, board: Board) -> float:
    grid = pixels.reshape(board.rows, board.columns, 2)
    gaps = np.hypot(*np.diff(grid, axis=1).reshape(-1, 2).T)
    gaps = gaps[np.isfinite(gaps)]
    return float(np.median(gaps)) if len(gaps) else float("nan")


@dataclass(frozen=True)
class Tag(_AnyLens):
    """The centre of one ArUco marker or AprilTag: where the diagonals of its corners cross."""

    dictionary: str
    number: int

    @property
    def name(self) -> str:
        """As the user named it."""
        return f"tag:{self.dictionary}:{self.number}"

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where the tag is; None if it is not seen, or seen twice."""
        number = getattr(cv2.aruco, self.dictionary)
        finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number))
        quads, ids, _ = finder.detectMarkers(grey)
        mine = [q for q, i in zip(quads, np.ravel([] if ids is None else ids), strict=True)
                if int(i) == self.number]  # fmt: skip
        if len(mine) != 1:
            return None
        corners = mine[0].reshape(4, 2).astype(np.float32)
        side = float(np.mean(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T)))
        window = int(np.clip(TAG_WINDOW_SHARE * side, *TAG_WINDOW_PX))
        refined = corners.reshape(-1, 1, 2).copy()
        cv2.cornerSubPix(grey, refined, (window, window), (-1, -1), _CRITERIA)
        quad = refined.reshape(4, 2).astype(np.float64)
        return TargetObservation(_crossing(quad), _tag_floor(side), side, quad)


_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)


def _crossing(quad: FloatArray) -> FloatArray:
    """Return where the diagonals of a quadrilateral cross: its centre in perspective, (2,)."""
    a, b, c, d = (np.append(corner, 1.0) for corner in quad)
    x = np.cross(np.cross(a, c), np.cross(b, d))
    centre: FloatArray = x[:2] / x[2]
    return centre


@dataclass(frozen=True)
class Blob(_AnyLens):
    """The one dark disc before a bright ground: its centre of darkness. It has no identity.

    A disc's centre of area is not the image of its centre; at small discs the difference is below
    the noise, and it is the user's to keep them small.
    """

    name: str = "blob"

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where the disc is; None if there is none, or more than one."""
        low, usual = float(np.min(grey)), float(np.median(grey))
        level = low + DARK_SHARE * (usual - low)
        count, labels, stats, _ = cv2.connectedComponentsWithStats((grey < level).astype(np.uint8))
        found = [i for i in range(1, count) if _is_disc(labels, stats[i], i, grey.size)]
        if len(found) != 1:
            return None
        x, y, width, height, area = (int(v) for v in stats[found[0]])
        pad = max(3, width // 4)
        rows = slice(max(0, y - pad), y + height + pad)
        columns = slice(max(0, x - pad), x + width + pad)
        darkness = np.clip(usual - grey[rows, columns].astype(np.float64), 0, None)
        darkness[darkness < DARK_SHARE / 2 * (usual - low)] = 0.0
        v, u = np.mgrid[rows, columns][:, : darkness.shape[0], : darkness.shape[1]]
        total = darkness.sum()
        centre = np.array([(u * darkness).sum(), (v * darkness).sum()]) / total
        diameter = float(2 * np.sqrt(area / np.pi))
        return TargetObservation(centre, _blob_floor(diameter), diameter)


def _is_disc(labels: FloatArray, stats: FloatArray, number: int, size: int) -> bool:
    x, y, width, height, area = (int(v) for v in stats)
    if not BLOB_MIN_PX <= area <= BLOB_MAX_SHARE * size or x == 0 or y == 0:
        return False
    part = (labels[y : y + height, x : x + width] == number).astype(np.uint8)
    outlines, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    perimeter = cv2.arcLength(outlines[0], closed=True)
    return bool(4 * np.pi * cv2.contourArea(outlines[0]) >= ROUNDNESS_MIN * perimeter**2)


@dataclass(frozen=True)
class Cross(_AnyLens):
    """The crossing of four squares, dark and bright in turn (a checker target), anywhere."""

    name: str = "cross"

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where the cross is; None if there is none, or another as clear."""
        smooth = cv2.GaussianBlur(grey, (0, 0), 1.5).astype(np.float32)
        # A saddle of grey values: the determinant of the second derivatives is most negative.
        xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=5) for order in _SECOND)
        saddle = xy * xy - xx * yy
        rim = CROSS_WINDOW_PX + 1
        inside = np.zeros_like(saddle)
        inside[rim:-rim, rim:-rim] = saddle[rim:-rim, rim:-rim]
        _, best, _, at = cv2.minMaxLoc(inside)
        if best <= 0:
            return None
        cv2.circle(inside, at, 2 * CROSS_WINDOW_PX, 0.0, -1)
        if cv2.minMaxLoc(inside)[1] > best / 2:
            return None
        point = np.array([[at]], dtype=np.float32)
        cv2.cornerSubPix(grey, point, (CROSS_WINDOW_PX, CROSS_WINDOW_PX), (-1, -1), _CRITERIA)
        pixel = point.reshape(2).astype(np.float64)
        if np.hypot(*(pixel - at)) > CROSS_WINDOW_PX / 2 or not _has_four_arms(grey, pixel):
            return None
        return TargetObservation(pixel, FLOOR_PX, float(2 * CROSS_WINDOW_PX))


_SECOND = ((2, 0), (0, 2), (1, 1))


def _has_four_arms(grey: Grey, pixel: FloatArray) -> bool:
    """Return whether a circle around the window crosses four edges: else others are in it."""
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    radius = np.sqrt(2) * CROSS_WINDOW_PX
    u, v = (pixel[:, None] + radius * np.stack([np.cos(turn), np.sin(turn)])).astype(np.float32)
    ring = cv2.remap(
        grey, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
    )[0].astype(np.float64)  # fmt: skip
    bright = ring > (ring.min() + ring.max()) / 2
    return int(np.count_nonzero(bright != np.roll(bright, 1))) == 4


def target(text: str, board: Board | None) -> Target:
    """Return the target that a user names; see `KINDS`.

    Raises
    ------
    UsageError
        If it is none, or needs a board and the rig has none.
    """
    kind, _, rest = text.partition(":")
    makers: dict[str, Callable[[], Target]] = {
        "board": lambda: _on_board(text, board),
        "corner": lambda: _on_board(text, board),
        "tag": lambda: _tag(text, rest),
        "blob": Blob,
        "cross": Cross,
        "plate": lambda: _on_plate(text, rest),
    }
    if kind not in makers or (bool(rest) != (kind in {"corner", "tag", "plate"})):
        raise UsageError(f"target {text}: is no target; they are {', '.join(KINDS)}")
    return makers[kind]()


def _on_board(text: str, board: Board | None) -> BoardCorner:
    if board is None:
        raise UsageError(f"target {text}: rig.toml has no [board]; add it, or name another target")
    if text == "board":
        return BoardCorner(board)
    parts = text.removeprefix("corner:").split(",")
    if len(parts) != 2 or not all(p.isascii() and p.isdigit() for p in parts):
        raise UsageError(f"target {text}: write corner:COLUMN,ROW, counted from 0")
    column, row = int(parts[0]), int(parts[1])
    if column >= board.columns or row >= board.rows:
        raise UsageError(
            f"target {text}: the board has columns 0 to {board.columns - 1} and rows 0 to "
            f"{board.rows - 1}"
        )
    described = {name: getattr(board, name) for name in board.__dataclass_fields__}
    return BoardCorner(Board(**(described | {"target": (column, row)})), text)


def _on_plate(text: str, rest: str) -> Target:
    # Edges are found by more than this room's small targets need.
    from calib.gaze.plate import CORNERS, PlateCorner

    if rest not in CORNERS:
        raise UsageError(f"target {text}: a plate has the corners {', '.join(CORNERS)}")
    return PlateCorner(rest)


def _tag(text: str, rest: str) -> Tag:
    dictionary, _, number = rest.rpartition(":")
    if dictionary not in DICTIONARIES:
        hint = suggestion(dictionary, DICTIONARIES)
        raise UsageError(f"target {text}: unknown dictionary {dictionary!r}; {hint}")
    if not (number.isascii() and number.isdigit()):
        raise UsageError(f"target {text}: write tag:DICTIONARY:ID, such as tag:{dictionary}:7")
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    if int(number) >= len(known.bytesList):
        raise UsageError(f"target {text}: tags of {dictionary} end with {len(known.bytesList) - 1}")
    return Tag(dictionary, int(number))
