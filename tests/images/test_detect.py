"""Board detection on rendered pictures. Evidence: simulated truth (corners projected by the same
camera that drew the pictures), and pictures spoilt on purpose."""

from __future__ import annotations

from pathlib import Path

import cv2
import lens_scenes as scenes
import numpy as np
import pytest
from drawn_boards import picture, write

from calib.core.errors import InputError
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.images.detection import find as detect_stage
from calib.images.detection.board import CHESSBOARD_DETECTORS, Found, find_chessboard
from calib.images.detection.find import detect
from calib.images.detection.grid import irregular, orient_like, spacing, squares
from calib.images.detection.picture import read_grey, thumbnail
from calib.simulate.pattern import board_pattern
from calib.simulate.render import Optics, prepare, render

SYMMETRIC = Board("chessboard", 7, 5, 25.0, (3, 2))


@pytest.fixture(scope="module")
def drawn() -> list[tuple[np.ndarray, np.ndarray]]:
    """Pictures and their exact corners."""
    held = scenes.poses(12, np.random.default_rng(1))
    return [
        (picture(pose, seed=i), scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD))
        for i, pose in enumerate(held)
    ]


def test_corners_agree_with_the_projected_truth(
    drawn: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    errors = []
    for image, exact in drawn:
        found = find_chessboard(image, scenes.BOARD)
        assert found.detector == "cascade:classic"
        assert not found.goes_on
        errors.append(found.pixels - exact)
    error = np.concatenate(errors)
    assert np.sqrt(np.mean(error**2)) < 0.03
    # 648 corners of 0.02 px: the mean is known to 0.001 px.
    assert np.abs(error.mean(axis=0)).max() < 0.005


@pytest.mark.parametrize("detector", ["classic", "sector"])
def test_a_forced_detector_is_used_and_recorded(
    drawn: list[tuple[np.ndarray, np.ndarray]], detector: str
) -> None:
    image, exact = drawn[0]
    found = find_chessboard(image, scenes.BOARD, detector=detector)
    assert found.detector == detector
    # The sector detector's own corners are some five times as far off as refined ones.
    assert np.sqrt(np.mean((found.pixels - exact) ** 2)) < 0.3


def test_cascade_goes_on_to_the_sector_detector(
    drawn: list[tuple[np.ndarray, np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the first detector misses: refined, the second one's corners are as good."""
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: (False, None))
    image, exact = drawn[0]
    found = find_chessboard(image, scenes.BOARD)
    assert found.detector == "cascade:sector"
    assert np.sqrt(np.mean((found.pixels - exact) ** 2)) < 0.03


def test_hard_pictures() -> None:
    """Blur of 2 px, noise of 8 grey values, dark corners, boards of 15 px a square."""
    imager = prepare(scenes.CAMERA, Optics(psf_px=2.0, noise=8.0, vignetting=1.5))
    far = scenes.poses(
        6, np.random.default_rng(3), place=lambda g: scenes.anywhere(g) * [1, 1, 1] + [0, 0, 250]
    )
    for i, pose in enumerate(far):
        image = render(imager, board_pattern(scenes.BOARD), pose, np.random.default_rng(i))
        found = find_chessboard(image, scenes.BOARD)
        exact = scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD)
        assert found.detector != "none"
        assert np.sqrt(np.nanmean((found.pixels - exact) ** 2)) < 0.4


def test_large_picture_is_searched_small_and_refined_at_full_size() -> None:
    scale = 2
    matrix = np.diag([scale, scale, 1.0]) @ scenes.CAMERA.matrix
    matrix[:2, 2] += (scale - 1) / 2
    camera = Camera(matrix, scenes.CAMERA.distortion, (1280, 960))
    pose = scenes.poses(1, np.random.default_rng(4))[0]
    found = find_chessboard(picture(pose, camera=camera), scenes.BOARD)
    error = found.pixels - scenes.seen_by(camera, pose, scenes.BOARD)
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_order_does_not_hang_on_how_the_board_is_held() -> None:
    """A 9 x 6 board has a first corner, by its colours, upside down too."""
    pose = scenes.poses(1, np.random.default_rng(5))[0]
    for turn in (0, 90, 180, 270):
        spin = cv2.Rodrigues(np.array([0, 0, np.radians(turn)]))[0]
        middle = scenes.BOARD.object_points().mean(axis=0)
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ spin
        turned[:3, 3] = pose[:3, 3] + pose[:3, :3] @ (middle - spin @ middle)
        found = find_chessboard(picture(turned), scenes.BOARD)
        exact = scenes.seen_by(scenes.CAMERA, turned, scenes.BOARD)
        assert np.abs(found.pixels - exact).max() < 0.3, turn


def test_columns_and_rows_exchanged_is_the_same_board() -> None:
    pose = scenes.poses(1, np.random.default_rng(6))[0]
    exchanged = Board("chessboard", 6, 9, 25.0, (0, 0))
    found = find_chessboard(picture(pose), exchanged).pixels
    exact = scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD)
    distance = np.linalg.norm(found[:, None] - exact, axis=-1)
    assert distance.min(axis=1).max() < 0.3
    # Seen from the front: rows clockwise from columns.
    grid = found.reshape(9, 6, 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert across[0] * down[1] - across[1] * down[0] > 0


def test_orient_like_turns_back_what_looks_the_same() -> None:
    rng = np.random.default_rng(7)
    for board, turned in ((SYMMETRIC, True), (scenes.BOARD, False)):
        held = scenes.poses(3, rng, board=board)
        one = np.array([scenes.seen_by(scenes.CAMERA, pose, board) for pose in held])
        other = one + np.array([12.0, 3.0])
        other[1] = other[1, ::-1]
        agreed = orient_like(one, other, board)
        assert np.array_equal(agreed[[0, 2]], other[[0, 2]])
        # Only a board with colours alike from both ends is ever turned.
        assert np.array_equal(agreed[1], other[1, ::-1] if turned else other[1])
    one[2, 0] = np.nan
    assert np.array_equal(orient_like(one, other, board), other, equal_nan=True)


def test_orient_like_knows_quarter_turns_of_square_boards() -> None:
    for count, quarters in ((6, 1), (7, 2)):
        board = Board("chessboard", count, count, 25.0, (0, 0))
        pose = scenes.poses(1, np.random.default_rng(8), board=board)[0]
        one = scenes.seen_by(scenes.CAMERA, pose, board)
        other = np.rot90(one.reshape(count, count, 2), quarters).reshape(-1, 2)
        assert np.array_equal(orient_like(one[None], other[None], board)[0], one)


def test_no_board_is_no_detection() -> None:
    rng = np.random.default_rng(9)
    noise = cv2.GaussianBlur(rng.integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 3)
    for image in (np.full((480, 640), 90, np.uint8), cv2.equalizeHist(noise)):
        found = find_chessboard(image, scenes.BOARD)
        assert found.detector == "none"
        assert np.isnan(found.pixels).all()


def test_grid_with_a_wrong_corner_or_a_skipped_row_is_irregular() -> None:
    pose = scenes.poses(1, np.random.default_rng(10))[0]
    exact = scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD)
    assert not irregular(exact, scenes.BOARD).any()
    moved = exact.copy()
    moved[22] += 0.5 * spacing(exact, scenes.BOARD)[22]
    assert np.flatnonzero(irregular(moved, scenes.BOARD)).tolist() == [22]
    taller = Board("chessboard", 9, 7, 25.0, (0, 0))
    grid = scenes.seen_by(scenes.CAMERA, pose, taller).reshape(7, 9, 2)
    assert irregular(grid[[0, 1, 2, 4, 5, 6]].reshape(-1, 2), scenes.BOARD).any()


def test_corners_of_the_sheet_are_not_inner_corners() -> None:
    """A grid one row too large ends where squares meet white paper."""
    pose = scenes.poses(1, np.random.default_rng(11))[0]
    image = picture(pose)
    exact = scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD)
    right = squares(image, exact, scenes.BOARD)
    assert right.is_board
    assert not right.goes_on
    assert min(right.edge) > 0.8
    taller = Board("chessboard", 9, 7, 25.0, (0, 0))
    assert not squares(image, scenes.seen_by(scenes.CAMERA, pose, taller), taller).is_board
    shorter = Board("chessboard", 9, 5, 25.0, (0, 0))
    assert squares(image, scenes.seen_by(scenes.CAMERA, pose, shorter), shorter).goes_on


@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (9, 5), (10, 6), (9, 7)])
def test_a_count_off_by_one_is_named(
    tmp_path: Path, drawn: list[tuple[np.ndarray, np.ndarray]], columns: int, rows: int
) -> None:
    names = [write(tmp_path, f"{i}.png", drawn[i][0]) for i in range(3)]
    wrong = Board("chessboard", columns, rows, 25.0, (0, 0))
    with pytest.raises(InputError, match=r"9 x 6|goes on beyond") as caught:
        detect(tmp_path, names, wrong, image_size=scenes.SIZE)
    assert f"{columns} x {rows}" in str(caught.value)
    assert "count" in str(caught.value)


def test_deep_and_coloured_images(
    tmp_path: Path, drawn: list[tuple[np.ndarray, np.ndarray]]
) -> None:
    image, exact = drawn[0]
    deep = (image.astype(np.uint16) * 9 + 700).astype(np.uint16)
    deep[5, 5] = 65535  # a hot pixel
    names = [
        write(tmp_path, "deep.png", deep),
        write(tmp_path, "deep.tiff", deep),
        write(tmp_path, "colour.png", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)),
        write(tmp_path, "colour.jpg", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)),
    ]
    found = detect(tmp_path, names, scenes.BOARD, image_size=scenes.SIZE)
    assert found.detector == ("cascade:classic",) * 4
    assert np.sqrt(np.mean((found.pixels - exact) ** 2, axis=(1, 2))).max() < 0.05
    assert read_grey(tmp_path / "deep.png", name="deep").std() > 30


def test_all_unusable_images_are_named_at_once(
    tmp_path: Path,
    drawn: list[tuple[np.ndarray, np.ndarray]],
    capfd: pytest.CaptureFixture[str],
) -> None:
    image = drawn[0][0]
    write(tmp_path, "good.png", image)
    write(tmp_path, "small.png", image[:, :600])
    for name in ("cut.png", "cut.jpg", "cut.tiff"):
        path = tmp_path / name
        write(tmp_path, name, image)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no picture")
    bad = ["small.png", "cut.png", "cut.jpg", "cut.tiff", "empty.png", "text.png", "gone.png"]
    with pytest.raises(InputError) as caught:
        detect(tmp_path, ["good.png", *bad], scenes.BOARD, image_size=scenes.SIZE)
    assert [problem.where for problem in caught.value.problems] == bad
    assert "600 x 480" in caught.value.problems[0].what
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("error", [cv2.error("assertion failed"), MemoryError()])
def test_a_search_that_breaks_down_names_its_image(
    tmp_path: Path,
    drawn: list[tuple[np.ndarray, np.ndarray]],
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    """Faults made on purpose, in one of the threads: all others go on, all faults are told."""
    names = [write(tmp_path, f"{i}.png", drawn[i][0]) for i in range(3)]
    spoilt = {names[0], names[2]}
    broken = {read_grey(tmp_path / n, name=n).tobytes() for n in spoilt}

    def find(grey: np.ndarray, board: Board, *, detector: str) -> Found:
        if grey.tobytes() in broken:
            raise error
        return find_chessboard(grey, board, detector=detector)

    monkeypatch.setattr(detect_stage, "find_chessboard", find)
    told: list[int] = []
    with pytest.raises(InputError) as caught:
        detect(
            tmp_path,
            names,
            scenes.BOARD,
            image_size=scenes.SIZE,
            progress=lambda done, _: told.append(done),
        )
    assert told == [1, 2, 3]
    assert {p.where for p in caught.value.problems} == spoilt
    assert all("broke down" in p.what for p in caught.value.problems)


def test_each_image_is_read_once_and_progress_is_told(
    tmp_path: Path, drawn: list[tuple[np.ndarray, np.ndarray]]
) -> None:
    names = [write(tmp_path, f"{i}.png", drawn[i][0]) for i in range(2)]
    blank = write(tmp_path, "blank.png", np.zeros((480, 640), np.uint8))
    told: list[tuple[int, int]] = []
    known = {"gone.png": drawn[2][1], "dashes.png": np.full((54, 2), np.nan)}
    threads = cv2.getNumThreads()
    found = detect(
        tmp_path,
        [*names, names[0], blank, *known],
        scenes.BOARD,
        image_size=scenes.SIZE,
        cache=known,
        progress=lambda done, total: told.append((done, total)),
    )
    assert told == [(i, 5) for i in range(1, 6)]
    assert cv2.getNumThreads() == threads
    assert np.array_equal(found.pixels[2], found.pixels[0])
    assert np.array_equal(found.pixels[4], drawn[2][1])
    assert found.detector == (*("cascade:classic",) * 3, "none", "cache", "none")
    assert detect(tmp_path, [], scenes.BOARD, image_size=scenes.SIZE).pixels.shape == (0, 54, 2)


def test_cached_corners_outside_of_the_image_are_refused(tmp_path: Path) -> None:
    known = {"a.png": np.full((54, 2), 700.0)}
    with pytest.raises(InputError, match=r"a\.png: corner \(700\.0, 700\.0\) is outside"):
        detect(tmp_path, ["a.png"], scenes.BOARD, image_size=scenes.SIZE, cache=known)


def test_choices_of_detector() -> None:
    assert tuple(CHESSBOARD_DETECTORS) == ("cascade", "classic", "sector")


def test_a_thumbnail_is_the_picture_made_smaller(
    drawn: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    image, _ = drawn[0]
    small = thumbnail(image, width=image.shape[1] // 2)
    assert small.shape == (image.shape[0] // 2, image.shape[1] // 2)
    means = image.reshape(small.shape[0], 2, small.shape[1], 2).mean(axis=(1, 3))
    assert np.abs(small - means).max() <= 0.5
