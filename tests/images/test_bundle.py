"""Bundle adjustment's parts. Evidence: properties, and simulated truth for the dispersion."""

from __future__ import annotations

import board_scenes as scenes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.core.errors import EstimationError
from calib.geometry.camera import Camera, project_points
from calib.images.bundle import Block, deformed, dispersion, inverse, minimise, proven

POINTS = np.array([[30.0, -40.0, 500.0], [-200.0, 100.0, 900.0], [5.0, 8.0, 300.0]])


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_projection_derivatives_agree_with_differences(count: int) -> None:
    rng = np.random.default_rng(count)
    lens = 0.01 * rng.normal(size=count)
    camera = Camera(scenes.C1.matrix, lens, (1280, 960))
    found = project_points(camera, POINTS)
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        slope = (
            project_points(camera, POINTS + step).pixels
            - project_points(camera, POINTS - step).pixels
        ) / 2e-4
        assert slope == pytest.approx(found.by_point[..., k], abs=1e-6)
    assert found.by_intrinsics.shape == (3, 2, 4 + count)
    for k in range(count):
        step = 1e-6 * np.eye(count)[k]
        up, down = (
            project_points(Camera(camera.matrix, lens + s * step, (1280, 960)), POINTS).pixels
            for s in (1, -1)
        )
        assert (up - down) / 2e-6 == pytest.approx(found.by_intrinsics[..., 4 + k], abs=1e-4)
    assert project_points(camera, POINTS[:0]).by_intrinsics.shape == (0, 2, 4 + count)


def test_bow_is_a_parabola_that_leaves_the_outer_corners() -> None:
    points = scenes.BOARD.object_points()
    grid = deformed(points, (0.8, -0.4)).reshape(6, 9, 3)
    assert grid[[0, 0, -1, -1], [0, -1, 0, -1], 2] == pytest.approx(0)
    assert grid[0, 4, 2] == pytest.approx(0.8)
    assert grid[:, 0, 2].min() == pytest.approx(-0.4 * 4 * 0.4 * 0.6)
    assert deformed(points, None) is points


def test_minimum_of_a_curved_valley_is_found() -> None:
    # Rosenbrock's function as residuals: minimum 0 at (1, 1).
    def evaluate(x: np.ndarray) -> list[Block]:
        residuals = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
        jacobian = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
        return [Block(residuals, jacobian, np.arange(2))]

    assert minimise(evaluate, np.array([-1.2, 1.0])).x == pytest.approx([1, 1], abs=1e-6)


def test_no_minimum_is_an_error() -> None:
    def runs_off(x: np.ndarray) -> list[Block]:
        return [Block(np.exp(-x), -np.exp(-x)[:, None], np.arange(1))]

    def not_finite(x: np.ndarray) -> list[Block]:
        return [Block(x * np.nan, np.eye(1), np.arange(1))]

    with pytest.raises(EstimationError, match="does not project"):
        minimise(not_finite, np.zeros(1))
    far = minimise(runs_off, np.zeros(1)).x  # the cost falls for ever, but below DONE
    assert far[0] > 9


def test_singular_normal_matrix_is_an_error() -> None:
    with pytest.raises(EstimationError, match="leave some unknown open"):
        inverse(np.ones((2, 2)))
    with pytest.raises(EstimationError, match="does not show in any image"):
        inverse(np.diag([1.0, 0.0]))
    scaled = np.diag([1e-12, 1e12])
    assert inverse(scaled) @ scaled == pytest.approx(np.eye(2))


@pytest.mark.parametrize(("common", "expected"), [(0.0, 1.1), (0.5, 5.0)])
def test_dispersion_is_the_variance_that_clusters_show(common: float, expected: float) -> None:
    """A mean over clusters of 16: a common error of 0.5 makes its variance 1 + 16 / 4 = 5 times."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        noise = rng.normal(size=(20, 16)) + common * rng.normal(size=(20, 1))
        noise -= noise.mean()
        ones = np.ones((16, 1))
        clusters = [[Block(row, ones, np.arange(1))] for row in noise]
        found.append(dispersion(clusters, np.eye(1) / noise.size, np.arange(1)))
    # Chi squared with 19 degrees of freedom over that number. On independent noise what is below 1
    # is raised by a standard error, which makes the mean 1.1. 200 repetitions: standard deviation
    # 0.02 of the expected.
    assert np.mean(found) == pytest.approx(expected, rel=0.08)


def test_dispersion_below_one_where_errors_within_a_cluster_cancel() -> None:
    """Of 16 corners each carries half the negative error of its neighbour."""
    rng = np.random.default_rng(2)
    found = []
    for _ in range(100):
        noise = rng.normal(size=(60, 16))
        noise -= 0.5 * np.roll(noise, 1, axis=1)
        noise -= noise.mean()
        noise /= noise.std()
        clusters = [[Block(row, np.ones((16, 1)), np.arange(1))] for row in noise]
        found.append(dispersion(clusters, np.eye(1) / noise.size, np.arange(1)))
    # The sum of a row has variance (1 - 0.5)^2 of 1 + 0.5^2: 0.2; and one standard error, 18 %.
    assert np.mean(found) == pytest.approx(0.2 * 1.18, rel=0.08)


@given(st.floats(0, 10), st.floats(1, 1e4))
def test_proven_factor_is_between_the_ratio_and_one(ratio: float, freedom: float) -> None:
    factor = proven(ratio, freedom=freedom)
    assert min(ratio, 1.0) <= factor <= max(ratio, 1.0)
    assert proven(ratio, freedom=4 * freedom) <= factor
