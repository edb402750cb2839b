"""Intrinsics of wide lenses. Evidence: simulated truth of a lens of 150 degrees; cv2.fisheye on the
same corners; repetition of the simulation; negative controls: lenses that are not wide."""

from __future__ import annotations

from dataclasses import replace

import lens_scenes as narrow
import numpy as np
import pytest
import wide_scenes as scenes

from calib.geometry.board import Corners, LensFit
from calib.geometry.camera import intrinsic_vector, normalise
from calib.images.intrinsics.backends import from_better, is_wide
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.by_views import Views, equidistant_start, fit_views
from calib.images.intrinsics.calibrate import Intrinsics, calibrate_intrinsics
from calib.images.intrinsics.gates import intrinsics_warnings
from calib.images.intrinsics.lenses import PERSPECTIVE
from calib.images.intrinsics.remarks import better, other_fits_better
from calib.images.intrinsics.validate import cross_validate
from calib.images.joint.reduced import Unknowns

POINTS = scenes.BOARD.object_points()
TRUTH = intrinsic_vector(scenes.CAMERA)
SIGMA_PX = 0.1


def own_fit(found: Corners, *, warp: bool = True) -> LensFit:
    start = equidistant_start(found, POINTS)
    return fit_views(found, POINTS, start=start, lens="equidistant", warp=warp)


@pytest.fixture(scope="module")
def found() -> Corners:
    return scenes.views(16, np.random.default_rng(73), warp_mm=(0.3, -0.2))


@pytest.fixture(scope="module")
def whole(found: Corners) -> Intrinsics:
    return calibrate_intrinsics(found, scenes.BOARD, camera="c1", seed=0)


def test_scene_reaches_the_rim(found: Corners) -> None:
    xy = normalise(scenes.CAMERA, found.pixels.reshape(-1, 2))
    assert np.degrees(np.arctan(np.hypot(*xy.T).max())) > 75


def test_lens_of_150_degrees_is_calibrated(whole: Intrinsics) -> None:
    assert all(gate.passed for gate in whole.gates), whole.gates
    assert (whole.camera.projection, whole.selected.backend) == ("equidistant", "joint")
    std = np.sqrt(np.diag(whole.covariance))
    assert (np.abs(intrinsic_vector(whole.camera) - TRUTH) < 4 * std).all()
    assert std[0] / TRUTH[0] < 0.002
    assert whole.selected.rms_px == pytest.approx(SIGMA_PX, rel=0.1)
    assert whole.selected.board_warp_mm == pytest.approx((0.3, -0.2), abs=0.1)
    assert whole.selected.rejected == 0
    assert "equidistant it is" in whole.selection
    assert "this program's own least squares" in whole.selection


def test_opencvs_fisheye_finds_the_same(whole: Intrinsics) -> None:
    checked = whole.differences[0]
    assert (checked.first, checked.second) == (
        "joint equidistant",
        "opencv equidistant on the board as solved here",
    )
    assert checked.rms_px < 1e-4
    # mrcal has no equidistant lens: a spline stands beside, which knows far less.
    assert whole.differences[1].second == "mrcal splined"
    assert whole.differences[1].rms_px < 3.0
    assert set(whole.model_files) <= set(PERSPECTIVE)


def test_a_spline_that_fits_worse_says_nothing_of_the_lens(whole: Intrinsics) -> None:
    far = replace(whole.differences[1], ratio=9.0)
    said = [
        list(
            intrinsics_warnings(
                "c1", whole.gates, dispersion=1.0, splined=far, fits_better=fits_better
            )
        )
        for fits_better in (True, False)
    ]
    assert "the lens has more shape than its model" in said[0][0]
    assert said[1] == []


def test_lens_that_rejects_the_rim_predicts_no_better(found: Corners) -> None:
    own = own_fit(found)
    inner = np.hypot(*(found.pixels - scenes.CAMERA.matrix[:2, 2]).transpose(2, 0, 1)) < 400
    kept = replace(found, pixels=np.where(inner[..., None], found.pixels, np.nan))
    few = fit_opencv(kept, scenes.BOARD, lens="plumb-bob")
    # The trap: corners of the middle alone, fitted nearly to their noise.
    assert few.rms_px < 1.2 * SIGMA_PX
    assert np.isfinite(few.residuals).sum() < 0.8 * np.isfinite(own.residuals).sum()
    fits = {"plumb-bob": few, "equidistant": own}
    result = cross_validate(found, scenes.BOARD, fits, points=dict.fromkeys(fits, POINTS))
    assert result.chosen == "equidistant"
    assert result.ratio[1] < 1.1


def test_narrow_lens_is_not_tried_even_with_a_spoilt_picture() -> None:
    rng = np.random.default_rng(0)
    pixels = narrow.views(12, rng).pixels
    pixels[4] += rng.normal(0, 8, (54, 2))
    corners = narrow.corners(pixels)
    flat = {"plumb-bob": fit_opencv(corners, narrow.BOARD, lens="plumb-bob")}
    assert flat["plumb-bob"].rejected >= 40
    assert not is_wide(flat, corners)
    assert is_wide({}, corners)


def test_derivatives_agree_with_differences(found: Corners) -> None:
    fit = own_fit(found)
    used = np.isfinite(found.pixels).all(axis=-1)
    problem = Views(fit.camera, POINTS, found.pixels, used, warp=True)
    assert fit.board_warp_mm is not None
    x = np.concatenate([intrinsic_vector(fit.camera), fit.board_warp_mm])
    normals = problem.normals_at(Unknowns(x, fit.poses))
    gradient = normals.shared_gradient.sum(axis=0)
    scale = np.sqrt(np.diag(normals.shared.sum(axis=0)))
    # At the minimum the gradient vanishes; a little beside it does not.
    assert np.abs(gradient / scale).max() < 1e-3
    x = x + 3 / scale
    gradient = problem.normals_at(Unknowns(x, fit.poses)).shared_gradient.sum(axis=0)

    def cost(at: np.ndarray) -> float:
        return float(np.nansum(problem.residuals_at(Unknowns(at, fit.poses)) ** 2)) / 2

    for k in range(len(x)):
        step = 1e-3 / scale[k] * np.eye(len(x))[k]
        slope = (cost(x + step) - cost(x - step)) / (2 * step[k])
        assert slope / scale[k] == pytest.approx(gradient[k] / scale[k], rel=1e-5, abs=1e-5)


def test_outliers_are_rejected(found: Corners) -> None:
    pixels = found.pixels.copy()
    pixels[2, 7] += [9.0, -6.0]
    pixels[5, 20] += [0.0, 3.0]
    fit = own_fit(replace(found, pixels=pixels))
    assert np.isnan(fit.residuals[2, 7]).all()
    assert np.isnan(fit.residuals[5, 20]).all()
    assert fit.rejected == 2
    assert fit.rms_px == pytest.approx(SIGMA_PX, rel=0.1)


def test_a_fit_worse_than_anothers_starts_from_its_minimum() -> None:
    corners = narrow.views(10, np.random.default_rng(3))
    points = dict.fromkeys(PERSPECTIVE, narrow.BOARD.object_points())
    good = fit_opencv(corners, narrow.BOARD, lens="plumb-bob")
    stuck = replace(good, rms_px=3 * good.rms_px, camera=narrow.CAMERA)
    others = {"plumb-bob": good}
    again = from_better(corners, narrow.BOARD, {"plumb-bob": stuck}, others, points)
    assert again["plumb-bob"].rms_px == pytest.approx(good.rms_px, rel=1e-6)
    # One that failed altogether starts there, too; one that is as good does not.
    assert set(from_better(corners, narrow.BOARD, {}, others, points)) == {"plumb-bob"}
    assert from_better(corners, narrow.BOARD, {"plumb-bob": good}, others, points) == {}


def test_better_fits_are_never_passed_over_in_silence() -> None:
    corners = narrow.views(10, np.random.default_rng(3))
    good = fit_opencv(corners, narrow.BOARD, lens="plumb-bob")
    bad = replace(good, residuals=1.5 * good.residuals, rms_px=1.5 * good.rms_px, backend="mrcal")
    assert better(good, bad) == (good, "")
    chosen, said = better(bad, good)
    assert chosen is good
    assert "mrcal ended at" in said
    assert other_fits_better(good, [bad, good]) == ()
    told = other_fits_better(bad, [good])
    assert len(told) == 1
    assert f"opencv plumb-bob {good.rms_px:.3f} px" in told[0]
    # A fit of fewer corners is no rival by its rms.
    few = good.residuals.copy()
    few[:, :5] = np.nan
    assert other_fits_better(bad, [replace(good, residuals=few)]) == ()


@pytest.mark.slow
def test_intervals_of_a_wide_lens_hold_over_repetitions() -> None:
    """Of 100 simulations: pulls of unit size and 95 % intervals of intrinsics that hold."""
    rng = np.random.default_rng(1)
    pulls = []
    for _ in range(100):
        fit = own_fit(scenes.views(16, rng))
        error = intrinsic_vector(fit.camera) - TRUTH
        pulls.append(error / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    # One standard deviation of an rms of 100 is 0.07, of a share of 95 % 2.2 %.
    assert (np.abs(rms - 1) < 0.25).all(), rms
    inside = (np.abs(pulls) < 1.96).mean(axis=0)
    assert (inside > 0.88).all(), inside
