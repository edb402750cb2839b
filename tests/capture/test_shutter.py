"""The shutter: what is not yet to be taken. Evidence: property, on drawn pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.capture.shutter import Finder, Shutter
from calib.geometry.board import Board

BOARD = Board("chessboard", 7, 5, 20.0, (3, 2))
NONE = np.zeros((0, BOARD.corner_count, 2))


def drawn(*, at=(60.0, 50.0), square=36, blur=0.8):
    """Return a picture of the board, facing the camera, its edges blurred by so much, px."""
    scale = 8
    cells = np.add.outer(np.arange(BOARD.rows + 1), np.arange(BOARD.columns + 1)) % 2
    large = np.kron(cells, np.ones((square * scale, square * scale))) * 180 + 30
    large = np.pad(large, square * scale // 2, constant_values=210).astype(np.float32)
    move = np.array([[1 / scale, 0, at[0]], [0, 1 / scale, at[1]]])
    picture = cv2.warpAffine(
        cv2.GaussianBlur(large, (0, 0), scale * blur), move, (420, 340), flags=cv2.INTER_AREA,
        borderValue=210,
    )  # fmt: skip
    noisy = picture + np.random.default_rng(1).normal(0, 1.5, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def finder():
    return Finder(BOARD)


def faults(finder, *pictures, taken=NONE):
    shutter = Shutter(BOARD)
    return [shutter.fault(finder.view(picture), taken) for picture in pictures]


def test_it_waits_until_the_board_is_still(finder):
    one, moved, nearly = drawn(), drawn(at=(62.0, 50.0)), drawn(at=(62.1, 50.0))
    assert faults(finder, one, moved, nearly) == ["hold it still", "hold it still", ""]


def test_blur_is_told_by_the_width_of_edges(finder):
    sharp, soft = finder.view(drawn()), finder.view(drawn(blur=2.5))
    # From 10 to 90 %: 2.56 standard deviations of the blur, and a little of the pixels.
    assert sharp.edge_px == pytest.approx(2.56 * 0.8, abs=0.5)
    assert soft.edge_px == pytest.approx(2.56 * 2.5, rel=0.15)
    assert faults(finder, drawn(blur=2.5), drawn(blur=2.5))[1].startswith("blurred: edges of 6")


def test_no_board_half_a_board_and_a_repetition_are_not_taken(finder):
    assert faults(finder, np.full((340, 420), 200, np.uint8)) == ["the board is not seen"]
    cut = drawn(at=(-60.0, 50.0))
    assert faults(finder, cut)[0] in {"the board is not seen", "only 60 % of the corners are seen"}
    taken = finder.view(drawn()).corners[None]
    again = drawn(at=(63.0, 50.0))
    assert faults(finder, again, again, taken=taken)[1] == "nearly the same as a picture taken"
    other = drawn(at=(85.0, 60.0))
    assert faults(finder, other, other, taken=taken)[1] == ""
