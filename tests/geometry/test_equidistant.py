"""The equidistant lens. Evidence: cv2.fisheye, closed forms, central differences, round trips."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.geometry.camera import (
    Camera,
    intrinsic_names,
    intrinsic_vector,
    normalise,
    normalise_jacobian,
    project,
    project_points,
    radius_limit,
    with_intrinsics,
)
from calib.geometry.mirror import mirror_camera

SIZE = (1280, 960)
MATRIX = np.array([[400.0, 0, 650.0], [0, 402.0, 470.0], [0, 0, 1]])
LENS = Camera(MATRIX, np.array([-0.02, 0.004, -0.002, 3e-4]), SIZE, "equidistant")
WIDE_DEG = 85.0


def points(count: int = 60, *, within_deg: float = WIDE_DEG) -> np.ndarray:
    """Return points all over a field of twice `within_deg`, one on the axis, mm, shape (n, 3)."""
    rng = np.random.default_rng(3)
    angle = np.deg2rad(rng.uniform(0, within_deg, count))
    about = rng.uniform(0, 2 * np.pi, count)
    angle[0] = 0.0
    unit = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])
    return rng.uniform(200, 2000, (count, 1)) * unit.T


def test_projects_as_opencvs_fisheye() -> None:
    found, still = points(), np.zeros(3)
    theirs = cv2.fisheye.projectPoints(found[None], still, still, MATRIX, LENS.distortion)[0][0]
    np.testing.assert_allclose(project(LENS, found), theirs, atol=1e-9)


def test_without_coefficients_the_image_height_is_the_angle() -> None:
    ideal = replace(LENS, distortion=np.zeros(4))
    angle = np.deg2rad([10.0, 45.0, 80.0])
    rays = np.stack([np.zeros(3), np.sin(angle), np.cos(angle)], axis=-1)
    np.testing.assert_allclose(project(ideal, rays)[:, 1], 402 * angle + 470, atol=1e-10)


def test_undistortion_inverts_projection() -> None:
    rays = points()
    xy = normalise(LENS, project(LENS, rays))
    np.testing.assert_allclose(xy, rays[:, :2] / rays[:, 2:], rtol=1e-10, atol=1e-12)


def test_derivatives_agree_with_differences() -> None:
    rays = points() / 500
    found = project_points(LENS, rays)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        up, down = (project_points(LENS, rays + s * step).pixels for s in (1, -1))
        np.testing.assert_allclose((up - down) / 2e-6, found.by_point[..., k], atol=2e-6)
    q = intrinsic_vector(LENS)
    assert intrinsic_names(LENS) == ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    for i, step in enumerate(1e-5 * np.eye(8)):
        up, down = (project_points(with_intrinsics(LENS, q + s * step), rays) for s in (1, -1))
        slope = (up.pixels - down.pixels) / 2e-5
        np.testing.assert_allclose(slope, found.by_intrinsics[..., i], atol=1e-6)


def test_derivatives_of_undistortion_agree_with_differences() -> None:
    pixels = project(LENS, points(within_deg=75.0))
    found = normalise_jacobian(LENS, pixels)
    for axis in range(2):
        shift = 1e-3 * np.eye(2)[axis]
        slope = (normalise(LENS, pixels + shift) - normalise(LENS, pixels - shift)) / 2e-3
        np.testing.assert_allclose(slope, found.by_pixel[..., axis], atol=1e-8)
    q = intrinsic_vector(LENS)
    for i in range(8):
        step = (1e-3 if i < 4 else 1e-6) * np.eye(8)[i]
        up, down = (normalise(with_intrinsics(LENS, q + s * step), pixels) for s in (1, -1))
        slope = (up - down) / (2 * step[i])
        np.testing.assert_allclose(slope, found.by_intrinsics[..., i], rtol=1e-5, atol=1e-6)


def test_field_ends_where_the_image_height_ceases_to_grow() -> None:
    # d(t + k t^3)/dt = 0 at t = 1 / sqrt(-3 k): 60 deg.
    end = np.deg2rad(60.0)
    folded = replace(LENS, distortion=np.array([-1 / (3 * end**2), 0, 0, 0]))
    assert radius_limit(folded) == pytest.approx(np.tan(end))
    edge = 402 * (end * (1 - 1 / 3))
    inside, outside = np.array([[650.0, 470 + edge - 0.5]]), np.array([[650.0, 470 + edge + 0.5]])
    assert np.degrees(np.arctan(normalise(folded, inside)[0, 1])) == pytest.approx(60, abs=3)
    with pytest.raises(EstimationError, match=r"folds back 60\.0 deg off the axis"):
        normalise(folded, outside)
    assert np.isnan(normalise(folded, outside, strict=False)).all()
    # The second branch, beyond the fold, is never taken.
    beyond = project(folded, np.array([[0.0, np.tan(np.deg2rad(75.0)), 1.0]]))
    assert normalise(folded, beyond)[0, 1] < np.tan(end)


def test_ninety_degrees_and_more_have_no_ray() -> None:
    assert radius_limit(LENS) == np.inf
    half_turn = np.array([[650.0, 470.0 + 402 * 1.7]])
    with pytest.raises(EstimationError, match="90 deg or more off the axis"):
        normalise(replace(LENS, distortion=np.zeros(4)), half_turn)


def test_mirrored_lens_sees_the_mirrored_scene() -> None:
    rays = points()
    there = project(mirror_camera(LENS), rays * [-1, 1, 1])
    here = project(LENS, rays)
    np.testing.assert_allclose(there, np.stack([1279 - here[:, 0], here[:, 1]], -1), atol=1e-9)
