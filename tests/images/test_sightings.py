"""How well corners are found in the images of rows. Evidence: simulated truth; properties."""

from __future__ import annotations

import board_scenes as scenes
import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.dataset.tables import GazeTable
from calib.geometry.board import Corners
from calib.rows.common_errors import CommonErrors
from calib.rows.from_images import LEAST_PX, CornerNoise, observe_images
from calib.rows.from_table import U_PIXEL, CameraSet, ImageObservations

INTRINSICS_PX = 0.02
ROWS_PX = 0.08


def table(images: tuple[str, ...]) -> GazeTable:
    n = len(images)
    nothing: FloatArray = np.full(n, np.nan)
    return GazeTable(
        file="gaze.csv",
        line=tuple(range(2, n + 2)),
        ids=images,
        groups=images,
        x1c=nothing,
        y1c=nothing,
        u1_px=nothing,
        v1_px=nothing,
        image_c1=images,
        alpha2_rad=np.full(n, 1.5),
        u2_px=nothing,
        image_c2=images,
        z_mm=np.full(n, 1000.0),
        u_z_mm=np.full(n, 1.0),
        stereo=(None,) * n,
        references={},
        depth_row=(None,) * n,
    )


def seen(
    c1: Corners, c2: Corners, cameras: CameraSet, stated: float | None = INTRINSICS_PX
) -> ImageObservations:
    return observe_images(
        table(c1.images),
        scenes.BOARD,
        c1,
        c2,
        None,
        CommonErrors(),
        CornerNoise(stated, stated),
        cameras,
    )


@pytest.fixture(scope="module")
def exact() -> scenes.Pairs:
    return scenes.pairs(np.random.default_rng(0), 14)


def test_images_of_rows_tell_their_own_noise(exact: scenes.Pairs) -> None:
    """Far targets have small squares: their corners are found less well than the lens' boards."""
    rng = np.random.default_rng(1)
    far = scenes.noisy(rng, exact.c2, ROWS_PX)
    found = seen(exact.c1, far, CameraSet(scenes.C1, scenes.C2))
    # 14 images of 54 corners: the median image's noise is good to 2 %, five times is enough.
    assert found.u_c2_px == pytest.approx(ROWS_PX, rel=0.1)
    assert found.u_c1_px == INTRINSICS_PX


def test_one_misread_board_does_not_decide_the_noise(exact: scenes.Pairs) -> None:
    far = scenes.noisy(np.random.default_rng(2), exact.c2, ROWS_PX)
    far.pixels[3, ::2] += 4.0
    found = seen(exact.c1, far, CameraSet(scenes.C1, scenes.C2))
    assert found.u_c2_px == pytest.approx(ROWS_PX, rel=0.1)


def test_without_a_lens_the_stated_noise_holds(exact: scenes.Pairs) -> None:
    far = scenes.noisy(np.random.default_rng(3), exact.c2, ROWS_PX)
    assert seen(exact.c1, far, CameraSet()).u_c2_px == INTRINSICS_PX


def test_with_a_given_lens_the_images_of_rows_alone_tell_it(exact: scenes.Pairs) -> None:
    far = scenes.noisy(np.random.default_rng(4), exact.c2, ROWS_PX)
    found = seen(exact.c1, far, CameraSet(scenes.C1, scenes.C2), None)
    assert found.u_c2_px == pytest.approx(ROWS_PX, rel=0.1)
    assert found.u_c1_px == LEAST_PX
    assert seen(exact.c1, far, CameraSet(), None).u_c2_px == U_PIXEL
