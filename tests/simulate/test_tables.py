"""Evidence: simulated truth and property. Tolerances are five standard errors of the statistic."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.geometry.camera import project
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE, depth
from calib.simulate.rig import Noise, TrueRig, draw_rig
from calib.simulate.tables import (
    OUTLIER_ANGLE,
    OUTLIER_DEPTH,
    draw_targets,
    observe,
    rays_in_c2,
    row_std,
    simulate_rows,
)

SILENT = Noise(pixel_px=0.0, encoder_rad=0.0, z_mm=0.0, z_rel=0.0)


def rig_of(seed: int, model: str = "encoder", noise: Noise | None = None) -> TrueRig:
    return draw_rig(np.random.default_rng(seed), model=model, noise=noise)


@pytest.mark.parametrize("model", sorted(MODELS))
def test_true_rows_satisfy_the_model_exactly(model: str) -> None:
    rig = rig_of(1, model)
    rows = simulate_rows(
        rig, np.random.default_rng(2), count=200, depth_range_mm=rig.depth_range_mm
    )
    np.testing.assert_allclose(depth(rig.theta, rows.true_gaze), rows.z_mm, rtol=1e-10)
    np.testing.assert_allclose(rows.points_mm[:, 0] / rows.z_mm, rows.true_gaze.x1c, rtol=1e-12)


def test_targets_are_in_range_and_seen_by_both_cameras() -> None:
    for seed in range(10):
        rig = rig_of(seed)
        near, far = rig.depth_range_mm
        rng = np.random.default_rng(seed)
        points = draw_targets(rig, rng, count=200, depth_range_mm=(near, far))
        assert points.shape == (200, 3)
        assert near <= points[:, 2].min()
        assert points[:, 2].max() <= far
        rows = observe(rig, rng, points)
        for camera, rays in (
            (rig.c1, points[:, :2] / points[:, 2:]),
            (rig.c2, rows.rays_c2),
        ):
            pixels = project(camera, rays)
            assert (pixels > 0).all()
            assert (pixels < np.array(camera.image_size) - 1).all()
        assert (rows.observed.alpha2_rad > rig.yaw_range_rad[0]).all()
        assert (rows.observed.alpha2_rad < rig.yaw_range_rad[1]).all()


def test_targets_fill_the_depth_range_evenly() -> None:
    rig = rig_of(0, "base")
    near, far = rig.depth_range_mm
    count = 3000
    z = draw_targets(rig, np.random.default_rng(1), count=count, depth_range_mm=(near, far))[:, 2]
    share = (z - near) / (far - near)
    # Uniform: variance 1/12, that of its square about the middle 1/180.
    assert abs(share.mean() - 1 / 2) < 5 / np.sqrt(12 * count)
    assert abs(((share - 0.5) ** 2).mean() - 1 / 12) < 5 / np.sqrt(180 * count)


def test_a_scene_that_no_camera_sees_is_refused() -> None:
    rig = rig_of(0)
    rejected = replace(rig, yaw_range_rad=(0.1, 0.11))
    with pytest.raises(UsageError, match="seen by both cameras"):
        draw_targets(rejected, np.random.default_rng(0), count=3, depth_range_mm=rig.depth_range_mm)


def test_the_motor_stops_at_the_nearest_count() -> None:
    rig = replace(rig_of(3), noise=SILENT)
    rows = simulate_rows(
        rig, np.random.default_rng(4), count=4000, depth_range_mm=rig.depth_range_mm
    )
    counts = rows.observed.alpha2_rad / rig.resolution_rad
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-8)
    # The encoder's own errors stretch a count by about a percent.
    share = rows.true_gaze.residual / rig.resolution_rad
    stretch = 1.05
    assert np.abs(share).max() < 0.5 * stretch
    # Uniform: variance 1/12, that of its square 1/180.
    error = 5 * np.sqrt(1 / 180 / len(share))
    assert abs((share**2).mean() - 1 / 12) < error + (stretch**2 - 1) / 12
    assert abs(share.mean()) < 5 / np.sqrt(12 * len(share))


def test_without_noise_only_the_rounding_is_left() -> None:
    rig = replace(rig_of(5), noise=SILENT)
    rows = simulate_rows(rig, np.random.default_rng(6), count=50, depth_range_mm=(900.0, 2000.0))
    seen, true = rows.observed, rows.true_gaze
    np.testing.assert_array_equal(seen.x1c, true.x1c)
    np.testing.assert_array_equal(seen.alpha2_rad, true.alpha2)
    np.testing.assert_array_equal(seen.z_mm, rows.z_mm)
    np.testing.assert_array_equal(seen.gaze_residual_rad, np.zeros(50))


def test_measured_residual_is_the_angle_at_c2() -> None:
    """It differs from the turn about the axis by C2's distance from the axis over the depth."""
    rig = replace(rig_of(7), noise=SILENT)
    rows = simulate_rows(
        rig,
        np.random.default_rng(8),
        count=100,
        depth_range_mm=rig.depth_range_mm,
        residual_measured=True,
    )
    measured, turn = rows.observed.gaze_residual_rad, rows.true_gaze.residual
    lever = np.linalg.norm(rig.mount_mm) / rig.depth_range_mm[0]
    height = np.abs(rows.rays_c2[:, 1]).max() * np.abs(rig.pitch_rad)
    assert np.abs(measured - turn).max() <= 1.2 * (lever + height) * np.abs(turn).max()
    np.testing.assert_allclose(
        rays_in_c2(rig, rows.true_gaze.alpha2, rows.points_mm), rows.rays_c2, atol=1e-12
    )


@pytest.mark.parametrize("measured", [False, True])
def test_errors_have_the_stated_spread(measured: bool) -> None:
    noise = Noise(pixel_px=0.2, encoder_rad=1e-4, z_mm=0.5, z_rel=0.001)
    rig = replace(rig_of(9), noise=noise)
    count = 4000
    rows = simulate_rows(
        rig,
        np.random.default_rng(10),
        count=count,
        depth_range_mm=rig.depth_range_mm,
        residual_measured=measured,
    )
    seen, true = rows.observed, rows.true_gaze
    errors = np.column_stack(
        [
            seen.x1c - true.x1c,
            seen.y1c - true.y1c,
            seen.alpha2_rad - true.alpha2,
            seen.gaze_residual_rad - np.arctan(rows.rays_c2[:, 0]),
            seen.z_mm - rows.z_mm,
        ]
    )
    # What the rows state, except that the reading's uncertainty holds the rounding as well, which
    # stands in the residual here.
    std = seen.std.copy()
    std[:, OBSERVABLE.alpha2] = noise.encoder_rad
    if not measured:
        errors[:, OBSERVABLE.residual] = 0
        std[:, OBSERVABLE.residual] = 1
    pulls = errors / std
    expected = np.array([1, 1, 1, float(measured), 1])
    np.testing.assert_allclose((pulls**2).mean(axis=0), expected, atol=5 * np.sqrt(2 / count))
    np.testing.assert_allclose(pulls.mean(axis=0), 0, atol=5 / np.sqrt(count))


def test_stated_uncertainty_of_the_reading() -> None:
    rig = replace(rig_of(11), resolution_rad=1e-3, noise=Noise(encoder_rad=2e-4))
    z = np.array([1000.0])
    free = row_std(rig, z, residual_measured=False)[0, OBSERVABLE.alpha2]
    known = row_std(rig, z, residual_measured=True)[0, OBSERVABLE.alpha2]
    assert free == pytest.approx(np.sqrt(1e-6 / 12 + 4e-8))
    assert known == pytest.approx(2e-4)


def test_shared_errors_have_the_covariance_of_their_loadings() -> None:
    noise = Noise(pixel_px=0.0, z_rel=0.0, shared_focal=1e-3, shared_centre=5e-4, shared_z_rel=2e-3)
    rig = replace(rig_of(12), noise=noise)
    rng = np.random.default_rng(13)
    points = draw_targets(rig, rng, count=3, depth_range_mm=rig.depth_range_mm)
    draws = 3000
    errors = np.empty((draws, 9))
    for k in range(draws):
        seen = observe(rig, rng, points).observed
        true = points[:, :2] / points[:, 2:]
        errors[k] = np.concatenate(
            [seen.x1c - true[:, 0], seen.y1c - true[:, 1], seen.z_mm - points[:, 2]]
        )
    chosen = [OBSERVABLE.x1c, OBSERVABLE.y1c, OBSERVABLE.z]
    loads = seen.shared[:, chosen].transpose(1, 0, 2).reshape(9, -1)
    expected = loads @ loads.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # The standard error of a covariance is at most sqrt(2 / n) of the product of deviations.
    np.testing.assert_allclose(
        np.cov(errors.T) / scale, expected / scale, atol=5 * np.sqrt(2 / draws)
    )
    assert len(seen.shared_names) == 4


def test_outliers_are_as_many_and_as_large_as_asked_and_touch_nothing_else() -> None:
    rig = rig_of(14)
    count, share = 2000, 0.1
    points = draw_targets(
        rig, np.random.default_rng(15), count=count, depth_range_mm=rig.depth_range_mm
    )
    clean = observe(rig, np.random.default_rng(16), points)
    spoilt = observe(rig, np.random.default_rng(16), points, outlier_share=share)
    hit = spoilt.outliers
    assert abs(hit.mean() - share) < 5 * np.sqrt(share * (1 - share) / count)
    assert not clean.outliers.any()

    def changes(name: str) -> np.ndarray:
        return np.asarray(getattr(spoilt.observed, name) - getattr(clean.observed, name))

    shift, turn = np.abs(changes("x1c")), np.abs(changes("alpha2_rad"))
    factor = np.abs(np.log(spoilt.observed.z_mm / clean.observed.z_mm))
    touched = np.column_stack([shift > 0, turn > 0, factor > 1e-12])
    np.testing.assert_array_equal(touched.sum(axis=1), hit.astype(int))
    np.testing.assert_array_equal(changes("y1c"), np.zeros(count))
    for size, (low, high) in (
        (shift, OUTLIER_ANGLE),
        (turn, OUTLIER_ANGLE),
        (factor, OUTLIER_DEPTH),
    ):
        large = size[size > 1e-12]
        slack = rig.resolution_rad
        assert low - slack <= large.min()
        assert large.max() <= high + slack


def test_the_same_seed_gives_the_same_rows() -> None:
    rig = rig_of(17)
    first, second = (
        simulate_rows(rig, np.random.default_rng(18), count=9, depth_range_mm=(900.0, 2000.0))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.observed.x1c, second.observed.x1c)
    np.testing.assert_array_equal(first.observed.z_mm, second.observed.z_mm)


def test_tables_are_simulated_without_opencv_and_scipy() -> None:
    """A study's workers start often; these two imports cost half a second."""
    code = (
        "import sys, numpy as np\n"
        "from calib.simulate.rig import draw_rig\n"
        "from calib.simulate.tables import simulate_rows\n"
        "rng = np.random.default_rng(0)\n"
        "rig = draw_rig(rng, model='encoder')\n"
        "simulate_rows(rig, rng, count=6, depth_range_mm=rig.depth_range_mm,\n"
        "              residual_measured=True, outlier_share=0.5)\n"
        "assert not {'cv2', 'scipy', 'matplotlib', 'h5py'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
