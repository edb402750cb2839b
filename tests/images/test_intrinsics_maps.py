"""Maps over the imager. Evidence: closed forms, and sampling of the stated covariance."""

from __future__ import annotations

from dataclasses import replace

import cv2
import lens_scenes as scenes
import numpy as np
import pytest

from calib.geometry.board import LensFit
from calib.geometry.camera import Camera, camera_from_vector, intrinsic_vector, normalise
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.maps import (
    CELLS,
    GRID,
    LensRays,
    compare,
    map_uncertainty,
    measure_coverage,
    nodes,
    rays_of,
)


@pytest.fixture(scope="module")
def fit() -> LensFit:
    found = scenes.views(12, np.random.default_rng(0), sigma_px=0.1)
    return fit_opencv(found, scenes.BOARD, lens="plumb-bob")


@pytest.fixture(scope="module")
def seen() -> np.ndarray:
    return scenes.views(12, np.random.default_rng(0), sigma_px=0.1).pixels


def test_coverage_of_known_corners() -> None:
    # Middle of the first cell of each row, one missing corner, and the last pixel.
    u, v = 640 / CELLS[1] / 2 - 0.5, 480 / CELLS[0] / 2 - 0.5
    pixels = np.array([[u, v + 480 / CELLS[0] * i] for i in range(CELLS[0])])
    pixels = np.concatenate([pixels, [[np.nan, np.nan], [639.0, 479.0]]])
    coverage = measure_coverage(pixels, (640, 480))
    assert coverage.counts.shape == CELLS
    assert (coverage.counts[:, 0] == 1).all()
    assert coverage.counts[-1, -1] == 1
    assert coverage.counts.sum() == 7
    assert coverage.share == pytest.approx(7 / 48)
    assert coverage.reach == pytest.approx(np.hypot(319.5, 239.5) / 400)
    assert measure_coverage(np.full((3, 2), np.nan), (640, 480)).share == 0


def test_nodes_near_corners_are_covered() -> None:
    at = nodes(np.array([[0.0, 0.0], [np.nan, np.nan]]), (640, 480))
    assert at.pixels.shape == (*GRID, 2)
    assert at.pixels[-1, -1].tolist() == [639, 479]
    # Within 40 px, a twentieth of the diagonal; nodes are 42.6 and 43.5 px apart.
    assert np.argwhere(at.covered).tolist() == [[0, 0]]


def test_a_turned_camera_is_no_other_lens(fit: LensFit, seen: np.ndarray) -> None:
    at = nodes(seen, scenes.SIZE)
    turn = cv2.Rodrigues(np.array([0.01, -0.02, 0.03]))[0]
    own = rays_of(fit, at)
    difference = compare(fit, replace(own, rays=own.rays @ turn.T), at)
    assert difference.max_px < 1e-6
    assert difference.ratio < 1e-6


def test_a_longer_lens_differs_by_its_radius(fit: LensFit, seen: np.ndarray) -> None:
    """A pinhole of f + df moves a ray outwards by r df / f."""
    at = nodes(seen, scenes.SIZE)
    short, long = (
        replace(
            fit,
            camera=Camera(
                np.array([[f, 0, 319.5], [0, f, 239.5], [0, 0, 1]]), np.zeros(0), (640, 480)
            ),
            covariance=np.eye(4),
        )
        for f in (540.0, 545.4)
    )
    difference = compare(short, rays_of(long, at), at)
    outwards = at.pixels - [319.5, 239.5]
    # The covered nodes lie all around, so a rotation cannot take much of it away.
    moved = difference.difference_px[at.covered] + outwards[at.covered] * 0.01
    assert np.linalg.norm(moved - moved.mean(axis=0), axis=-1).max() < 0.5
    assert 1.0 < difference.rms_px < 3.0


def test_uncertainty_map_agrees_with_sampling(fit: LensFit, seen: np.ndarray) -> None:
    """200 lenses drawn from the covariance, each compared with the estimate like any other lens."""
    at = nodes(seen, scenes.SIZE)
    mapped = map_uncertainty(fit, at)
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(intrinsic_vector(fit.camera), fit.covariance, 200)
    spread = np.zeros((*at.covered.shape, 2, 2))
    for vector in drawn:
        camera = camera_from_vector(vector, scenes.SIZE)
        xy = normalise(camera, at.pixels.reshape(-1, 2), strict=False)
        rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        lens = LensRays("drawn", rays.reshape(*at.covered.shape, 3), mapped.std_px)
        moved = compare(fit, lens, at).difference_px
        spread += moved[..., None] * moved[..., None, :] / len(drawn)
    sampled = np.sqrt(np.linalg.eigvalsh(spread[at.covered])[:, -1])
    # A standard deviation from 200 draws is good to 5 %; the worst of 100 nodes to 20 %.
    assert sampled == pytest.approx(mapped.std_px[at.covered], rel=0.2)
