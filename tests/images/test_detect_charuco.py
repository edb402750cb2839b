"""ChArUco boards are found. Evidence: pictures drawn with their exact corners."""

from __future__ import annotations

from pathlib import Path

import lens_scenes as scenes
import numpy as np
import pytest
from drawn_boards import picture, write

from calib.core.errors import InputError
from calib.geometry.board import Board
from calib.images.detection.charuco import CharucoFinder
from calib.images.detection.find import detect

CHARUCO = Board("charuco", 6, 5, 25.0, (0, 0), "DICT_4X4_50", 19.0)
SYMMETRIC = Board("chessboard", 7, 5, 25.0, (3, 2))


def near(rng: np.random.Generator) -> np.ndarray:
    return np.array([rng.uniform(-60, 60), rng.uniform(-50, 50), rng.uniform(300, 420)])


def test_charuco_in_part() -> None:
    """Shifted partly out of the picture: the corners left are found, the others are NaN."""
    pose = scenes.poses(1, np.random.default_rng(12), board=CHARUCO, place=near)[0]
    exact = scenes.seen_by(scenes.CAMERA, pose, CHARUCO)
    pose[0, 3] -= pose[2, 3] * (np.median(exact[:, 0]) - 20) / 540
    exact = scenes.seen_by(scenes.CAMERA, pose, CHARUCO)
    inside = exact[:, 0] > 15
    assert 8 < inside.sum() < 25
    found = CharucoFinder(CHARUCO).find(picture(pose, CHARUCO))
    seen = np.isfinite(found.pixels[:, 0])
    assert found.detector == "charuco"
    assert not seen[exact[:, 0] < 0].any()
    assert seen[inside].mean() > 0.6
    assert np.sqrt(np.nanmean((found.pixels - exact) ** 2)) < 0.1


def test_an_inverted_charuco_board_is_found_and_told(tmp_path: Path) -> None:
    held = scenes.poses(2, np.random.default_rng(13), board=CHARUCO, place=near)
    names = [
        write(tmp_path, f"{i}.png", 255 - picture(pose, CHARUCO, seed=i))
        for i, pose in enumerate(held)
    ]
    found = detect(tmp_path, names, CHARUCO, image_size=scenes.SIZE)
    assert found.detector == ("charuco:inverted",) * 2
    exact = np.array([scenes.seen_by(scenes.CAMERA, pose, CHARUCO) for pose in held])
    assert np.sqrt(np.nanmean((found.pixels - exact) ** 2)) < 0.06
    assert "black and white are exchanged" in found.remarks[0]
    assert "2 of 2 pictures" in found.remarks[0]


def test_charuco_with_too_few_corners_is_not_found() -> None:
    pose = scenes.poses(1, np.random.default_rng(12), board=CHARUCO, place=near)[0]
    exact = scenes.seen_by(scenes.CAMERA, pose, CHARUCO)
    pose[0, 3] -= pose[2, 3] * (exact[:, 0].max() - 20) / 540
    found = CharucoFinder(CHARUCO).find(picture(pose, CHARUCO))
    assert found.detector == "none"
    assert np.isnan(found.pixels).all()


def test_charuco_corners_are_accurate_and_unbiased() -> None:
    finder, errors = CharucoFinder(CHARUCO), []
    held = scenes.poses(6, np.random.default_rng(13), board=CHARUCO, place=near)
    for i, pose in enumerate(held):
        found = finder.find(picture(pose, CHARUCO, seed=i))
        errors.append(found.pixels - scenes.seen_by(scenes.CAMERA, pose, CHARUCO))
    error = np.concatenate(errors)
    assert np.isfinite(error).all(axis=-1).mean() > 0.95
    assert np.sqrt(np.nanmean(error**2)) < 0.06
    # 180 corners of 0.04 px: the mean is known to 0.003 px.
    assert np.abs(np.nanmean(error, axis=0)).max() < 0.012


def test_small_charuco_boards_are_enlarged() -> None:
    """Squares of 17 to 20 px: as they are, corners would be off by 0.2 px."""
    finder, errors = CharucoFinder(CHARUCO), []
    far = scenes.poses(4, np.random.default_rng(14), board=CHARUCO, place=lambda g: near(g) * 2)
    for i, pose in enumerate(far):
        found = finder.find(picture(pose, CHARUCO, seed=i))
        errors.append(found.pixels - scenes.seen_by(scenes.CAMERA, pose, CHARUCO))
    error = np.concatenate(errors)
    assert np.isfinite(error).all(axis=-1).mean() > 0.5
    assert np.sqrt(np.nanmean(error**2)) < 0.1


@pytest.mark.parametrize(("dictionary", "marker"), [("DICT_9X9", 19.0), (None, 19.0), ("x", None)])
def test_charuco_without_its_particulars_is_refused(
    tmp_path: Path, dictionary: str | None, marker: float | None
) -> None:
    board = Board("charuco", 6, 5, 25.0, (0, 0), dictionary, marker)
    name = write(tmp_path, "a.png", np.zeros((480, 640), np.uint8))
    with pytest.raises(InputError, match="DICT_5X5_100"):
        detect(tmp_path, [name], board, image_size=scenes.SIZE)
