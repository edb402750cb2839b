"""Projection and its inverse. Evidence: closed forms, central differences, round trips."""

from __future__ import annotations

import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.geometry.camera import (
    Camera,
    camera_from_vector,
    intrinsic_names,
    intrinsic_vector,
    normalise,
    normalise_jacobian,
    project,
    radius_limit,
)

SIZE = (720, 576)
MATRIX = np.array([[421.71, 0, 351.27], [0, 424.68, 285.17], [0, 0, 1]])
LENSES = {
    "none": [],
    "plumb-bob": [-0.2, 0.05, 1e-3, -2e-3],
    "xu-wang": [-0.3691, 0.2223, -0.0002, 0.0001, -0.1047],
    "rational": [0.1, -0.2, 1e-3, 1e-3, 0.05, 0.3, 0.01, 0.002],
    "thin-prism": [-0.2, 0.05, 1e-3, -2e-3, 0, 0, 0, 0, 0.01, 0.001, 0.002, 0.003],
    "tilted": [-0.2, 0.05, 1e-3, -2e-3, 0, 0, 0, 0, 0.01, 0.001, 0.002, 0.003, 0.05, -0.03],
}


def camera(lens: str) -> Camera:
    return Camera(MATRIX, np.array(LENSES[lens], dtype=float), SIZE)


def rays(count: int = 200) -> np.ndarray:
    return np.random.default_rng(1).uniform(-0.6, 0.6, (count, 2))


@pytest.mark.parametrize("lens", LENSES)
def test_normalise_inverts_project(lens: str) -> None:
    xy = rays()
    # Newton stops within 1e-10 px, which is under 1e-12 in x and y at f = 420 px.
    assert np.abs(normalise(camera(lens), project(camera(lens), xy)) - xy).max() < 1e-11


def test_projection_of_one_coefficient_by_hand() -> None:
    k1 = -0.2
    x, y = 0.3, -0.4
    factor = 1 + k1 * 0.25
    expected = [421.71 * x * factor + 351.27, 424.68 * y * factor + 285.17]
    lens = Camera(MATRIX, np.array([k1, 0, 0, 0]), SIZE)
    assert project(lens, np.array([[x, y]]))[0] == pytest.approx(expected, abs=1e-10)
    # The same ray as a point 2.5 m away.
    assert project(lens, 2500 * np.array([[x, y, 1]]))[0] == pytest.approx(expected, abs=1e-10)


def test_missing_and_hidden_points_are_nan() -> None:
    points = np.array([[0.1, 0.1, 1.0], [np.nan, 0, 1], [0.1, 0.1, -1], [0.1, 0.1, 0]])
    pixels = project(camera("xu-wang"), points)
    assert np.isfinite(pixels[0]).all()
    assert np.isnan(pixels[1:]).all()
    result = normalise_jacobian(camera("xu-wang"), pixels)
    for part in (result.xy, result.by_pixel, result.by_intrinsics):
        assert np.isfinite(part[0]).all()
        assert np.isnan(part[1:]).all()
    assert normalise(camera("xu-wang"), np.empty((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("lens", LENSES)
def test_jacobians_agree_with_central_differences(lens: str) -> None:
    model = camera(lens)
    pixels = project(model, rays(20))
    result = normalise_jacobian(model, pixels)
    step = 1e-3
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        slope = (normalise(model, pixels + shift) - normalise(model, pixels - shift)) / (2 * step)
        # Truncation is step^2 |x'''| / 6, with |x'''| about 10 / f^3; rounding 1e-13 / step.
        assert np.abs(result.by_pixel[:, :, axis] - slope).max() < 1e-9

    q = intrinsic_vector(model)
    assert result.by_intrinsics.shape == (20, 2, len(q))
    for i in range(len(q)):
        step = 1e-3 if i < 4 else 1e-5
        shift = step * np.eye(len(q))[i]
        up, down = (camera_from_vector(q + sign * shift, SIZE) for sign in (1, -1))
        slope = (normalise(up, pixels) - normalise(down, pixels)) / (2 * step)
        assert np.abs(result.by_intrinsics[:, :, i] - slope).max() < 1e-7


def test_radius_limit_of_one_coefficient() -> None:
    # d(r + k r^3)/dr = 0 at r = 1 / sqrt(-3 k); a pincushion never folds.
    assert radius_limit(Camera(MATRIX, np.array([-0.3, 0, 0, 0]), SIZE)) == pytest.approx(
        1 / np.sqrt(0.9)
    )
    assert radius_limit(Camera(MATRIX, np.array([0.3, 0, 0, 0]), SIZE)) == np.inf
    assert radius_limit(camera("none")) == np.inf
    # The pole of 1 / (1 - r^2 / 4) at r = 2.
    pole = Camera(MATRIX, np.array([0, 0, 0, 0, 0, -0.25, 0, 0]), SIZE)
    assert radius_limit(pole) == pytest.approx(2.0)


def test_pixel_beyond_the_fold_is_refused_and_named() -> None:
    with pytest.raises(EstimationError, match=r"pixel \(1350\.00, 20\.00\): .*folds back.*deg"):
        normalise(camera("xu-wang"), np.array([[300.0, 200.0], [1350.0, 20.0]]))


def test_second_branch_of_the_lens_is_not_taken() -> None:
    # k1 < 0 < k2: the distorted radius grows, falls and grows again. A pixel far out is met only
    # by the second rise, which no lens has.
    model = Camera(MATRIX, np.array([-0.5, 0.08, 0, 0]), SIZE)
    beyond = project(model, np.array([[2.6, 0.0]]))
    assert np.hypot(*((beyond - MATRIX[:2, 2]) / 421.71).T) > 0.9
    with pytest.raises(EstimationError, match="folds back"):
        normalise(model, beyond)


def test_vector_and_names_match() -> None:
    model = camera("rational")
    again = camera_from_vector(intrinsic_vector(model), SIZE)
    assert np.array_equal(again.matrix, model.matrix)
    assert np.array_equal(again.distortion, model.distortion)
    assert intrinsic_names(model)[:6] == ("fx", "fy", "cx", "cy", "k1", "k2")
    assert len(intrinsic_names(model)) == len(intrinsic_vector(model))


def test_pixels_without_a_ray_can_be_marked_instead() -> None:
    pixels = np.array([[300.0, 200.0], [1350.0, 20.0], [np.nan, 3.0]])
    xy = normalise(camera("xu-wang"), pixels, strict=False)
    assert np.array_equal(xy[0], normalise(camera("xu-wang"), pixels[:1])[0])
    assert np.isnan(xy[1:]).all()
