"""Targets in pictures: found where they are, as well as is claimed, and not where they are not.

Evidence: simulated truth, rendered pictures.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.gaze.picking import target_near
from calib.gaze.target import Blob, BoardCorner, Cross, Tag, target
from calib.geometry.board import Board
from calib.geometry.camera import Camera, project
from calib.simulate.pattern import BLACK, SURROUNDINGS, WHITE, Pattern, board_pattern
from calib.simulate.render import Optics, prepare, render
from calib.simulate.scene import rotation

CAMERA = Camera(
    np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.array([-0.1, 0.02, 0, 0]), (640, 480)
)
BOARD = Board("chessboard", 9, 7, 30.0, (4, 3))
CHARUCO = Board("charuco", 5, 4, 70.0, (2, 2), "DICT_4X4_50", 52.0)
TAG = Tag("DICT_APRILTAG_36h11", 7)


@cache
def imager():
    return prepare(CAMERA, Optics())


def sheet(edges, cells):
    return Pattern(edges, edges, np.pad(cells, 1, constant_values=SURROUNDINGS))


def tag_sheet(side=130.0):
    number = getattr(cv2.aruco, TAG.dictionary)
    image = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(number), TAG.number, 8)
    cells = np.full((12, 12), WHITE)
    cells[2:10, 2:10] = np.where(image > 0, WHITE, BLACK)
    return sheet((np.arange(13) - 6.0) * side / 8, cells)


def cross_sheet(side=70.0):
    cells = np.full((4, 4), WHITE)
    cells[1, 1] = cells[2, 2] = BLACK
    return sheet(np.array([-1.5, -1, 0, 1, 1.5]) * side, cells)


def disc_sheet(side=35.0):
    edges = np.linspace(-1.5, 1.5, 61) * side
    x, y = np.meshgrid(*[(edges[1:] + edges[:-1]) / 2] * 2)
    return sheet(edges, np.where(np.hypot(x, y) < side / 2, BLACK, WHITE))


def on_board(board):
    return BoardCorner(board), board_pattern(board), board.object_points()[board.target_index]


SCENES = {
    "chessboard": lambda: on_board(BOARD),
    "charuco": lambda: on_board(CHARUCO),
    "tag": lambda: (TAG, tag_sheet(), np.zeros(3)),
    "cross": lambda: (Cross(), cross_sheet(), np.zeros(3)),
    "blob": lambda: (Blob(), disc_sheet(), np.zeros(3)),
}


def view(pattern, point, rng):
    turn = rotation(np.append(rng.uniform(-0.35, 0.35, 2), 0.0)) @ rotation(np.array([0, 0, 0.1]))
    pose = np.eye(4)
    pose[:3, :3] = turn
    at = 1500 * np.append((rng.uniform([230, 190], [410, 290]) - [320, 240]) / 600, 1.0)
    pose[:3, 3] = at - turn @ point
    return render(imager(), pattern, pose, rng), project(CAMERA, at[None])[0]


@pytest.mark.parametrize("kind", SCENES)
def test_it_is_found_as_well_as_is_claimed(kind):
    what, pattern, point = SCENES[kind]()
    rng = np.random.default_rng(3)
    errors, claimed = [], []
    for _ in range(12):
        picture, true = view(pattern, point, rng)
        found = what.find(picture)
        assert found is not None
        errors.append(found.pixel - true)
        claimed.append(found.floor_px)
    # One picture scatters by 0.01 to 0.02 px on top of the floor.
    u = np.hypot(np.array(claimed), 0.02)[:, None]
    assert np.sqrt(np.mean((np.array(errors) / u) ** 2)) < 1.5
    assert u.max() < 0.1


@pytest.mark.parametrize("kind", SCENES)
def test_it_is_not_found_where_another_target_is(kind):
    what, _, _ = SCENES[kind]()
    rng = np.random.default_rng(4)
    for other, scene in SCENES.items():
        # A blob has no identity: a marker's square is one to it.
        if kind not in {other, "blob"}:
            _, pattern, point = scene()
            assert what.find(view(pattern, point, rng)[0]) is None, other
    assert what.find(np.full((480, 640), 90, np.uint8)) is None


@pytest.mark.parametrize("kind", ["chessboard", "tag", "cross"])
def test_pointing_names_the_nearest_that_can_be_gazed_at(kind):
    what, pattern, point = SCENES[kind]()
    board = getattr(what, "board", BOARD)
    picture, true = view(pattern, point, np.random.default_rng(6))
    named = target_near(picture, true + np.array([4, -3]), board=board, lens=CAMERA)
    assert named == what.name
    assert target(named, board).find(picture) is not None
    if kind == "chessboard":
        other = target("corner:1,2", board)
        there = other.find(picture).pixel
        assert target_near(picture, there, board=board, lens=None) == "corner:1,2"
        assert target_near(picture, np.array([5.0, 5.0]), board=board, lens=None) is None


def test_a_cross_with_arms_too_short_for_its_window_is_not_measured():
    rng = np.random.default_rng(5)
    for _ in range(6):
        picture, true = view(cross_sheet(25.0), np.zeros(3), rng)
        found = Cross().find(picture)
        assert found is None or np.hypot(*(found.pixel - true)) < 0.2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ball", "they are board, corner:COLUMN,ROW"),
        ("board:3", "is no target"),
        ("corner", "is no target"),
        ("corner:9,0", "columns 0 to 8"),
        ("corner:a", "write corner:COLUMN,ROW"),
        ("tag:DICT_4X4_51:1", "DICT_4X4_50"),
        ("tag:DICT_4X4_50:one", "such as tag:DICT_4X4_50:7"),
        ("tag:DICT_4X4_50:50", "end with 49"),
    ],
)
def test_a_name_that_is_none_is_refused(text, says):
    with pytest.raises(UsageError, match=says) as refusal:
        target(text, BOARD)
    # It came by --target, --from, --to, a field of the page or a standard's table.
    assert str(refusal.value).startswith(f"target {text}: ")


def test_targets_by_name():
    assert target("corner:1,2", BOARD).board.target == (1, 2)
    assert target("tag:DICT_4X4_50:7", None).number == 7
    assert {target(n, BOARD).name for n in ("board", "blob", "cross")} == {"board", "blob", "cross"}
    with pytest.raises(UsageError, match=r"has no \[board\]"):
        target("board", None)
