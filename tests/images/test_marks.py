"""Marks inside the squares of a chessboard. Evidence: rendered boards with known corners."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.images.detection.find import detect
from calib.images.detection.marks import window_pattern

BOARD = Board("chessboard", 8, 5, 20.0, (4, 2))
SQUARE_PX = 80
SIZE = (640, 480)


def drawn(kind: str) -> np.ndarray:
    """The board from the front, one square of margin, grey values."""
    columns, rows = BOARD.columns + 1, BOARD.rows + 1
    picture = np.full(((rows + 2) * SQUARE_PX, (columns + 2) * SQUARE_PX), 230, np.uint8)
    rng = np.random.default_rng(7)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for r in range(rows):
        for c in range(columns):
            y, x = (r + 1) * SQUARE_PX, (c + 1) * SQUARE_PX
            if (r + c) % 2 == 0:
                picture[y : y + SQUARE_PX, x : x + SQUARE_PX] = 30
            elif kind == "charuco":
                side = int(0.75 * SQUARE_PX)
                marker = cv2.aruco.generateImageMarker(dictionary, (r * columns + c) // 2, side)
                low = (SQUARE_PX - side) // 2
                picture[y + low : y + low + side, x + low : x + low + side] = np.clip(
                    marker, 30, 230
                )
            elif kind == "marks":
                at = rng.uniform(0.2, 0.8, 2) * SQUARE_PX
                centre = (round(x + at[0]), round(y + at[1]))
                cv2.circle(picture, centre, SQUARE_PX // 7, 30, -1)
    return picture


def views(folder: Path, kind: str, *, count: int = 6) -> tuple[tuple[str, ...], FloatArray]:
    """Write pictures of the board, slanted; return their names and the true corners."""
    rng = np.random.default_rng(3)
    board = cv2.GaussianBlur(drawn(kind), (0, 0), 1.2)
    high, wide = board.shape
    outline = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float32)
    c, r = np.meshgrid(np.arange(BOARD.columns), np.arange(BOARD.rows))
    corners = (np.stack([c.ravel(), r.ravel()], -1) + 2.0) * SQUARE_PX - 0.5
    names, truth = [], []
    for i in range(count):
        to = np.array([[60, 50], [580, 50], [580, 430], [60, 430]]) + rng.uniform(-40, 40, (4, 2))
        turn = cv2.getPerspectiveTransform(outline, to.astype(np.float32))
        picture = cv2.warpPerspective(board, turn, SIZE, flags=cv2.INTER_AREA, borderValue=230)
        picture = np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
        names.append(f"{kind}{i}.png")
        cv2.imwrite(str(folder / names[-1]), picture)
        truth.append(cv2.perspectiveTransform(corners[None], turn)[0])
    return tuple(names), np.array(truth)


def off(found: FloatArray, truth: FloatArray) -> float:
    """Root mean square of the corners' errors, px, whichever end they were read from."""
    errors = [np.nanmean((found - t) ** 2, axis=(1, 2)) for t in (truth, truth[:, ::-1])]
    return float(np.sqrt(np.mean(np.minimum(*errors))))


@pytest.mark.parametrize("kind", ["marks", "charuco"])
def test_marks_inside_squares_are_named_and_do_not_pull(kind: str, tmp_path: Path) -> None:
    names, truth = views(tmp_path, kind)
    found = detect(tmp_path, names, BOARD, image_size=SIZE)
    assert set(found.detector) == {"cascade:classic:small-window"}
    assert "something inside the squares pulls them" in found.remarks[0]
    assert off(found.pixels, truth) < 0.12
    assert ("DICT_4X4" in found.remarks[0]) == (kind == "charuco")
    assert ('type = "charuco"' in found.remarks[0]) == (kind == "charuco")


def test_a_plain_board_keeps_the_large_window(tmp_path: Path) -> None:
    """Negative control."""
    names, truth = views(tmp_path, "plain")
    found = detect(tmp_path, names, BOARD, image_size=SIZE)
    assert set(found.detector) == {"cascade:classic"}
    assert found.remarks == ()
    assert off(found.pixels, truth) < 0.1


def test_noise_of_corners_is_no_pattern() -> None:
    """Negative control, 20 draws: differences of 0.1 px without a pattern, or one of 0.01 px."""
    rng = np.random.default_rng(5)
    grid = 40 * BOARD.object_points()[:, :2] / BOARD.square_mm
    for _ in range(20):
        large = [grid + rng.normal(0, 0.05, grid.shape) for _ in range(8)]
        small = [view + rng.normal(0, 0.1, grid.shape) for view in large]
        pattern = window_pattern(large, small, BOARD)
        assert pattern is not None
        assert not pattern.disturbed
        assert pattern.ratio == pytest.approx(1.0, abs=0.6)
    fine = rng.normal(0, 0.01, grid.shape)
    pattern = window_pattern(large, [v + fine for v in large], BOARD)
    assert pattern is not None
    assert not pattern.disturbed
    assert window_pattern(large[:3], small[:3], BOARD) is None
