"""Pairs that cannot be used. Evidence: negative controls, each recognised and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import board_scenes as scenes
import numpy as np
import pytest
from stereo_scenes import KNOWN, LENS_COVARIANCE, noisy

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Corners
from calib.geometry.poses import rotation
from calib.images.pairs import start_pairs
from calib.images.stereo.reference import given_reference, stereo_reference
from calib.images.stereo.solve import CameraPair


@pytest.fixture(scope="module")
def exact() -> scenes.Pairs:
    return scenes.pairs(np.random.default_rng(0), 14)


def test_swapped_cameras_are_named(exact: scenes.Pairs) -> None:
    swapped = CameraPair(KNOWN.cameras[::-1], KNOWN.covariances)
    with pytest.raises(EstimationError, match="C1 and C2 are swapped"):
        stereo_reference((exact.c2, exact.c1), scenes.BOARD, swapped, stems=exact.c1.images, seed=0)


@pytest.mark.parametrize(("stands", "stated"), [("right", "left"), ("left", "right")])
def test_a_rig_on_the_other_side_is_told_and_how_to_state_it(stands: str, stated: str) -> None:
    pose = scenes.matrix(scenes.POSE_12)
    if stands == "left":
        flip = np.diag([-1.0, 1, 1, 1])
        pose = flip @ pose @ flip
    none = Corners((), np.empty((0, 54, 2)), (), (1280, 960))
    rig = replace(KNOWN, is_left=stated == "left")
    with pytest.raises(EstimationError, match=f"on its {stands}") as caught:
        given_reference((none, none), scenes.BOARD, rig, stems=(), transform_12=pose)
    assert f'write c2 = "{stands}" in [rig]' in str(caught.value)
    assert "C1 and C2 are swapped" in str(caught.value)
    rig = replace(KNOWN, is_left=stands == "left")
    found = given_reference((none, none), scenes.BOARD, rig, stems=(), transform_12=pose)
    assert (found.transform_12[0, 3] < 0) == (stands == "left")


@pytest.mark.parametrize("roll_deg", [90, 180, -90])
def test_a_camera_mounted_on_its_side_or_upside_down_is_named(roll_deg: int) -> None:
    mounted = scenes.matrix(scenes.POSE_12)
    mounted[:3, :3] @= rotation(np.array([0, 0, np.deg2rad(roll_deg)]))
    none = Corners((), np.empty((0, 54, 2)), (), (1280, 960))
    with pytest.raises(EstimationError, match=r"turned by -?\d+ deg against C1's") as caught:
        given_reference((none, none), scenes.BOARD, KNOWN, stems=(), transform_12=mounted)
    found = int(str(caught.value).split("turned by ")[1].split(" deg")[0])
    # The pose has a roll of its own, 0.015 rad.
    assert (found - roll_deg + 180) % 360 - 180 == pytest.approx(0, abs=2)


def test_upside_down_pictures_of_c2_are_named_by_the_pairs(exact: scenes.Pairs) -> None:
    width, height = exact.c2.image_size
    upside = replace(exact.c2, pixels=np.array([width - 1, height - 1]) - exact.c2.pixels)
    matrix = scenes.C2.matrix.copy()
    matrix[:2, 2] = np.array([width - 1, height - 1]) - matrix[:2, 2]
    distortion = scenes.C2.distortion * [1, 1, -1, -1, 1]
    rig = CameraPair(
        (scenes.C1, replace(scenes.C2, matrix=matrix, distortion=distortion)), KNOWN.covariances
    )
    with pytest.raises(EstimationError, match=r"turned by (-?179|180) deg against C1's"):
        stereo_reference((exact.c1, upside), scenes.BOARD, rig, stems=exact.c1.images, seed=0)


def upside_down(views: FloatArray) -> None:
    views[1, 5] = np.array([1279, 959]) - views[1, 5]


def exchanged(views: FloatArray) -> None:
    views[1, [5, 7]] = views[1, [7, 5]]


def cameras_swapped(views: FloatArray) -> None:
    views[:, 5] = views[::-1, 5].copy()


def bumped(views: FloatArray) -> None:
    views[1, 5] += [3, 0]


@pytest.mark.parametrize("fault", [upside_down, exchanged, cameras_swapped, bumped])
def test_a_pair_that_does_not_belong_is_named_and_left_out(
    exact: scenes.Pairs, fault: Callable[[FloatArray], None]
) -> None:
    pair = noisy(np.random.default_rng(1), exact)
    views = np.stack([c.pixels for c in pair])
    fault(views)
    one, two = (replace(c, pixels=v) for c, v in zip(pair, views, strict=True))
    reference = stereo_reference((one, two), scenes.BOARD, KNOWN, stems=one.images, seed=0)
    odd = {"05.png", "07.png"} if fault is exchanged else {"05.png"}
    assert set(one.images) - set(reference.stems) == odd
    assert set(reference.targets.stems) == set(reference.stems)
    failed = {gate.name: gate.detail for gate in reference.gates if not gate.passed}
    assert list(failed) == ["stereo-pairs"]
    assert ", ".join(sorted(odd)) in failed["stereo-pairs"]
    error = reference.pose_12 - scenes.POSE_12
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(reference.covariance)))


def test_pictures_numbered_off_by_one_are_told_from_swapped_cameras(exact: scenes.Pairs) -> None:
    shifted = replace(exact.c2, pixels=np.roll(exact.c2.pixels, 1, axis=0))
    with pytest.raises(EstimationError, match="the pairs fit no single pose of C2"):
        stereo_reference((exact.c1, shifted), scenes.BOARD, KNOWN, stems=exact.c1.images, seed=0)


@pytest.mark.parametrize("size", [(6, 9), (27, 2)])
def test_miscounted_board_is_named(exact: scenes.Pairs, size: tuple[int, int]) -> None:
    wrong = replace(scenes.BOARD, columns=size[0], rows=size[1], target=(0, 0))
    with pytest.raises(EstimationError, match="check \\[board\\] columns and rows"):
        stereo_reference((exact.c1, exact.c2), wrong, KNOWN, stems=exact.c1.images, seed=0)


def test_pairs_that_do_not_belong_together_fail_the_fit(exact: scenes.Pairs) -> None:
    shuffled = replace(exact.c2, pixels=np.roll(exact.c2.pixels, 1, axis=0))
    try:
        reference = stereo_reference(
            (exact.c1, shuffled), scenes.BOARD, KNOWN, stems=exact.c1.images, seed=0
        )
    except EstimationError:
        return
    failed = [g.name for g in reference.gates if not g.passed]
    assert "stereo-fit" in failed


def test_refocused_lens_is_named(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(8)
    longer = scenes.C2.matrix * np.array([[1.03, 1, 1], [1, 1.03, 1], [1, 1, 1]])
    small = LENS_COVARIANCE / 9
    rig = CameraPair((scenes.C1, replace(scenes.C2, matrix=longer)), (small, small))
    reference = stereo_reference(
        noisy(rng, exact), scenes.BOARD, rig, stems=exact.c1.images, seed=0
    )
    failed = {g.name: g.detail for g in reference.gates if not g.passed}
    assert "refocused" in failed["stereo-intrinsics"]


def test_wrong_given_baseline_contradicts_the_board(exact: scenes.Pairs) -> None:
    wrong = np.array(scenes.POSE_12)
    wrong[3:] *= 1.1
    small = CameraPair(KNOWN.cameras, (LENS_COVARIANCE, LENS_COVARIANCE))
    reference = given_reference(
        (exact.c1, exact.c2),
        scenes.BOARD,
        small,
        stems=exact.c1.images,
        transform_12=scenes.matrix(wrong),
    )
    failed = [g.name for g in reference.gates if not g.passed]
    assert "stereo-board-pose" in failed


def test_too_few_pairs_are_refused(exact: scenes.Pairs) -> None:
    def few(found: Corners) -> Corners:
        return Corners(found.images[:2], found.pixels[:2], found.detector[:2], found.image_size)

    with pytest.raises(EstimationError, match="2 pairs show the board"):
        start_pairs((few(exact.c1), few(exact.c2)), scenes.BOARD, cameras=KNOWN.cameras)
