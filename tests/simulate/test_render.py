"""Evidence: independent tool (OpenCV's undistortion, boards and detectors) and simulated truth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.geometry.board import Board
from calib.geometry.camera import Camera, project
from calib.images.detection.board import find_chessboard
from calib.simulate.pattern import BLACK, SURROUNDINGS, WHITE, board_pattern, charuco_board
from calib.simulate.render import Imager, Optics, prepare, render
from calib.simulate.rig import draw_camera
from calib.simulate.scene import IntrinsicViews, draw_intrinsic_views, rotation

CHESSBOARD = Board("chessboard", 9, 7, 30.0, (4, 3))
CHARUCO = Board("charuco", 9, 7, 30.0, (4, 3), "DICT_4X4_100", 22.0)
LEGACY = Board("charuco", 8, 5, 30.0, (4, 3), "DICT_5X5_100", 20.0, legacy=True)
PINHOLE = Camera(np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]]), np.zeros(0), (640, 480))
PLAIN = Optics(psf_px=0.0, noise=0.0, vignetting=0.0, exposure=250.0)


def lens(size: tuple[int, int] = (640, 480)) -> Camera:
    """A camera with more distortion than any drawn one: 18 px at the corner of a VGA image."""
    drawn = draw_camera(np.random.default_rng(1), image_size=size)
    return Camera(drawn.matrix, np.array([-0.3, 0.1, 1e-3, -8e-4, 0.0]), size)


def facing(board: Board, *, distance: float, turn: tuple[float, float, float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rotation(np.array(turn))
    middle = board.square_mm * np.array([board.columns - 1, board.rows - 1, 0]) / 2
    pose[:3, 3] = np.array([0, 0, distance]) - pose[:3, :3] @ middle
    return pose


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_grey_values_are_area_means_of_the_distorted_board(board: Board) -> None:
    """Against OpenCV's undistortion of 32 x 32 points a pixel, each looked up without smoothing."""
    camera, pattern, side = lens(), board_pattern(board), 32
    pose = facing(board, distance=450, turn=(0.3, 0.4, 0.13))
    image = render(prepare(camera, PLAIN), pattern, pose, np.random.default_rng(0))

    top, left, height, width = 330, 420, 48, 64
    u = left - 0.5 + (np.arange(width * side) + 0.5) / side
    v = top - 0.5 + (np.arange(height * side) + 0.5) / side
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(
        pixels, camera.matrix, camera.distortion, criteria=(3, 30, 1e-12)
    ).reshape(-1, 2)
    plane = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(pose[:3, [0, 1, 3]]).T
    x, y = plane[:, 0] / plane[:, 2], plane[:, 1] / plane[:, 2]
    sharp = pattern.reflectance[np.searchsorted(pattern.y_mm, y), np.searchsorted(pattern.x_mm, x)]
    means = sharp.reshape(height, side, width, side).mean(axis=(1, 3))
    assert means.std() > 0.2  # black and white squares are in the window

    difference = image[top : top + height, left : left + width] / PLAIN.exposure - means
    # Rounding to 8 bits takes 0.5 / 250; of the rest, 1 % of the contrast is an edge out of place
    # by 0.01 px.
    assert np.abs(difference).max() < 0.5 / 250 + 0.01 * (WHITE - BLACK)


def test_corners_found_again_are_unbiased() -> None:
    """Mean of found minus projected under 0.01 px, over 80 views by 4 lenses."""
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(4):
        camera = draw_camera(rng, image_size=(640, 480))
        imager, pattern = prepare(camera, Optics()), board_pattern(CHESSBOARD)
        for pose in draw_intrinsic_views(camera, CHESSBOARD, rng, IntrinsicViews(count=20)):
            found = find_chessboard(render(imager, pattern, pose, rng), CHESSBOARD).pixels
            points = CHESSBOARD.object_points() @ pose[:3, :3].T + pose[:3, 3]
            errors.append(found - project(camera, points))
    assert len(errors) == 80
    seen = np.concatenate([e for e in errors if np.isfinite(e).all()])
    assert len(seen) > 0.95 * 80 * CHESSBOARD.corner_count
    np.testing.assert_array_less(np.abs(seen.mean(axis=0)), 0.01)
    # Clean pictures: a corner is better than 0.1 px, or it is another corner.
    assert np.abs(seen).max() < 0.3
    assert seen.std() < 0.05


@pytest.mark.parametrize("board", [CHARUCO, LEGACY], ids=["new", "legacy"])
def test_charuco_board_equals_opencvs(board: Board) -> None:
    """Corners and their numbers, by OpenCV's own detector with OpenCV's own board."""
    imager = prepare(lens((960, 720)), Optics())
    pose = facing(board, distance=450, turn=(0.2, -0.3, 0.1))
    image = render(imager, board_pattern(board), pose, np.random.default_rng(3))
    corners, numbers, markers, _ = cv2.aruco.CharucoDetector(charuco_board(board)).detectBoard(
        image
    )
    assert len(numbers) == board.corner_count
    assert len(markers) == (board.columns + 1) * (board.rows + 1) // 2
    points = board.object_points()[np.ravel(numbers)] @ pose[:3, :3].T + pose[:3, 3]
    difference = corners.reshape(-1, 2) - project(imager.camera, points)
    assert np.abs(difference).max() < 0.3


def test_charuco_without_its_markers_is_refused() -> None:
    with pytest.raises(ValueError, match="side of its markers"):
        board_pattern(Board("charuco", 9, 7, 30.0, (4, 3)))
    with pytest.raises(ValueError, match="DICT_3X3"):
        board_pattern(Board("charuco", 9, 7, 30.0, (4, 3), "DICT_3X3", 20.0))


def edge_profile(psf_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the left rim of the sheet, px, and grey values across it."""
    imager = prepare(PINHOLE, Optics(psf_px=psf_px, noise=0.0, vignetting=0.0, exposure=250.0))
    pose = facing(CHESSBOARD, distance=500, turn=(0, 0, 0))
    image = render(imager, board_pattern(CHESSBOARD), pose, np.random.default_rng(0))
    rim = 319.5 + 600 * (board_pattern(CHESSBOARD).x_mm[0] - 4 * 30.0) / 500
    columns = np.arange(int(rim) - 8, int(rim) + 9)
    return columns - rim, image[240, columns].astype(float)


def test_blur_has_the_stated_width() -> None:
    at, grey = edge_profile(psf_px=1.5)
    slope = np.diff(grey)
    middle = (at[1:] + at[:-1]) / 2
    mean = (slope * middle).sum() / slope.sum()
    spread = np.sqrt((slope * (middle - mean) ** 2).sum() / slope.sum())
    # The pixel's own width and the difference of neighbours add 1/12 each.
    expected = np.sqrt(1.5**2 + 2 / 12)
    # A grey value's rounding, 0.29 steps of 125, weighs most 8 px off the edge.
    assert mean == pytest.approx(0, abs=0.05)
    assert spread == pytest.approx(expected, rel=0.05)


def test_noise_has_the_stated_size_and_differs_between_images() -> None:
    imager = prepare(PINHOLE, Optics(noise=3.0, vignetting=0.0))
    away = facing(CHESSBOARD, distance=500, turn=(0, 0, 0))
    away[0, 3] = 1e5  # out of view: only the wall is seen
    rng = np.random.default_rng(4)
    first, second = (
        render(imager, board_pattern(CHESSBOARD), away, rng).astype(float) for _ in range(2)
    )
    for image in (first, second):
        assert image.mean() == pytest.approx(SURROUNDINGS * 250, abs=0.05)
        # Rounding adds 1/12 of a step's square.
        assert image.std() == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.01)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 5 / np.sqrt(first.size)


def test_vignetting_is_the_natural_fall_off() -> None:
    imager = prepare(PINHOLE, Optics(vignetting=1.0))
    tangent = np.array([0.0, 239.5 / 600, np.hypot(319.5, 239.5) / 600])
    ratio = imager.gain[[239, 0, 0], [319, 320, 0]] / 250
    np.testing.assert_allclose(ratio, np.cos(np.arctan(tangent)) ** 4, rtol=2e-3)


def test_board_behind_the_camera_or_at_its_side_leaves_the_wall() -> None:
    imager = prepare(lens(), PLAIN)
    wall = round(SURROUNDINGS * 250)
    behind = facing(CHESSBOARD, distance=-500, turn=(0, 0, 0))
    rejected = facing(CHESSBOARD, distance=500, turn=(0, 0, 0))
    rejected[0, 3] += 2000.0
    around = facing(CHESSBOARD, distance=10, turn=(0, 1.2, 0))  # partly behind the camera
    around[0, 3] += 2000.0
    for pose in (behind, rejected, around):
        image = render(imager, board_pattern(CHESSBOARD), pose, np.random.default_rng(0))
        assert (np.abs(image.astype(int) - wall) <= 1).all()


def test_board_partly_out_of_view_is_cut_by_the_border() -> None:
    imager: Imager = prepare(PINHOLE, PLAIN)
    pose = facing(CHESSBOARD, distance=500, turn=(0, 0, 0))
    whole = render(imager, board_pattern(CHESSBOARD), pose, np.random.default_rng(0))
    pose[0, 3] += 500 * 200 / 600  # 200 px to the right
    moved = render(imager, board_pattern(CHESSBOARD), pose, np.random.default_rng(0))
    np.testing.assert_allclose(moved[:, 210:].astype(int), whole[:, 10:440].astype(int), atol=1)
