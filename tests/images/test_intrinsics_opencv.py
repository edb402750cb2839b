"""Intrinsics by OpenCV with rejection and covariance. Evidence: simulated truth, coverage of the
stated uncertainty, an independent computation (OpenCV's own standard deviations)."""

from __future__ import annotations

from dataclasses import replace

import cv2
import lens_scenes as scenes
import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.geometry.board import Corners, LensFit
from calib.geometry.camera import intrinsic_vector
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.covariance import view_scores

TRUTH = intrinsic_vector(scenes.CAMERA)
POINTS = scenes.BOARD.object_points()


def fit(found: Corners, lens: str = "plumb-bob") -> LensFit:
    return fit_opencv(found, scenes.BOARD, lens=lens)


def within(result: LensFit, sigmas: float = 4.0) -> bool:
    """Fx, fy, cx, cy within some of their standard deviations of the truth."""
    error = intrinsic_vector(result.camera)[:4] - TRUTH[:4]
    return bool((np.abs(error) < sigmas * np.sqrt(np.diag(result.covariance)[:4])).all())


def test_stated_uncertainty_covers_the_truth() -> None:
    """Pulls over 60 simulated calibrations; the rms of each is known to 9 %."""
    pulls, dispersion = [], []
    for seed in range(60):
        result = fit(scenes.views(12, np.random.default_rng(seed)))
        std = np.sqrt(np.diag(result.covariance))
        pulls.append((intrinsic_vector(result.camera) - TRUTH) / std)
        scores = view_scores(result.camera, result.poses, result.residuals, POINTS)
        dispersion.append(scores.dispersion())
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (rms[:4] > 0.7).all()
    assert (rms[:4] < 1.4).all()
    assert (rms > 0.65).all()
    assert (rms < 1.5).all()
    # Independent noise: views contradict each other as much as noise explains. One value scatters
    # by some 0.25, the mean of 60 by 0.03.
    assert np.mean(dispersion) == pytest.approx(1.0, abs=0.12)


def test_standard_deviations_are_opencvs_own() -> None:
    found = scenes.views(10, np.random.default_rng(3))
    result = fit(found)
    opencv = cv2.calibrateCameraExtended(
        [POINTS.astype(np.float32)] * 10,
        list(found.pixels.astype(np.float32)),
        found.image_size,
        None,
        None,
        criteria=(3, 1000, 1e-12),
    )
    assert result.rejected == 0
    # OpenCV divides by n - p as well; single precision of its input moves both by 1e-4.
    own = np.sqrt(np.diag(result.covariance))
    assert own == pytest.approx(opencv[5].ravel()[:9], rel=2e-3)
    assert intrinsic_vector(result.camera)[:4] == pytest.approx(
        [opencv[1][0, 0], opencv[1][1, 1], opencv[1][0, 2], opencv[1][1, 2]], abs=1e-3
    )
    # Per coordinate, where OpenCV's figure is per point.
    assert result.rms_px == pytest.approx(opencv[0] / np.sqrt(2), rel=1e-3)


def test_residuals_and_poses_are_those_of_the_truth() -> None:
    held = scenes.poses(8, np.random.default_rng(4))
    exact = np.array([scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD) for pose in held])
    result = fit(scenes.corners(exact))
    # Single precision of the corners given to OpenCV is 3e-5 px.
    assert result.rms_px < 1e-4
    for pose, expected in zip(result.poses, held, strict=True):
        assert cv2.Rodrigues(pose[:3])[0] == pytest.approx(expected[:3, :3], abs=1e-5)
        assert pose[3:] == pytest.approx(expected[:3, 3], abs=0.01)


def test_gross_outliers_are_rejected_and_no_more() -> None:
    rng = np.random.default_rng(0)
    found = scenes.views(20, rng)
    pixels, places = found.pixels.copy(), rng.permutation(20 * 54)[:15]
    pixels.reshape(-1, 2)[places] += rng.choice([-1, 1], (15, 2)) * rng.uniform(2, 8, (15, 2))
    result = fit(replace(found, pixels=pixels))
    gone = np.flatnonzero(np.isnan(result.residuals[..., 0]))
    assert np.array_equal(gone, np.sort(places))
    assert result.rejected == 15
    assert within(result)


def test_a_view_of_something_else_is_left_out() -> None:
    rng = np.random.default_rng(1)
    found = scenes.views(12, rng)
    pixels = found.pixels.copy()
    pixels[4] += rng.normal(0, 8, (54, 2))
    result = fit(replace(found, pixels=pixels))
    assert np.isnan(result.residuals[4]).all()
    assert np.isfinite(np.delete(result.residuals, 4, axis=0)).mean() > 0.99
    assert within(result)


def test_incomplete_views_and_views_without_a_board() -> None:
    rng = np.random.default_rng(2)
    found = scenes.views(14, rng)
    pixels = found.pixels.copy()
    pixels[rng.random((14, 54)) < 0.3] = np.nan
    pixels[3] = np.nan
    pixels[5, 7:] = np.nan  # 7 corners: too few for a pose
    result = fit(replace(found, pixels=pixels))
    assert np.isnan(result.poses[[3, 5]]).all()
    assert np.isfinite(np.delete(result.poses, [3, 5], axis=0)).all()
    assert result.rejected == 0
    assert within(result)


def test_rational_lens_recovers_the_focal_length_too() -> None:
    result = fit(scenes.views(20, np.random.default_rng(6)), "rational")
    assert result.covariance.shape == (12, 12)
    assert within(result)


def test_too_few_views_are_refused() -> None:
    with pytest.raises(EstimationError, match="2 usable views and 3 are needed"):
        fit(scenes.views(2, np.random.default_rng(0)))


def test_dispersion_shows_errors_common_to_a_view() -> None:
    """A bow of each view's own, as of a board bent in the hand, 0.4 mm: corner noise hides it."""
    rng = np.random.default_rng(7)
    held = scenes.poses(16, rng)
    bent = [
        scenes.seen_by(scenes.CAMERA, pose, scenes.BOARD, tuple(rng.normal(0, 0.4, 2)))
        for pose in held
    ]
    pixels = np.array(bent) + rng.normal(0, 0.05, (16, 54, 2))
    result = fit(scenes.corners(pixels))
    assert view_scores(result.camera, result.poses, result.residuals, POINTS).dispersion() > 2
