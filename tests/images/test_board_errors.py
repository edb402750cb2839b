"""Boards whose corners are not where they were drawn. Evidence: simulated truth, with coverage by
repetition; negative controls on corner noise alone.
"""

from __future__ import annotations

import board_scenes
import lens_scenes as scenes
import numpy as np
import pytest
import test_joint_lenses as scene_of_pairs

from calib.core.arrays import FloatArray
from calib.geometry.board import Corners
from calib.geometry.camera import intrinsic_vector, project
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.covariance import view_scores
from calib.images.intrinsics.remarks import board_warning
from calib.images.joint.solve import solve_joint

POINTS = scenes.BOARD.object_points()
PRINT_MM, SIGMA_PX = 0.1, 0.02
VIEWS = 8


def held(rng: np.random.Generator) -> list[FloatArray]:
    return scenes.poses(VIEWS, rng, place=lambda r: r.uniform([-90, -60, 500], [90, 60, 600]))


def pictured(rng: np.random.Generator, poses: list[FloatArray], print_mm: float) -> Corners:
    """Pictures of one board, corners printed beside their places in its plane."""
    points = POINTS + np.pad(rng.normal(0, print_mm, (len(POINTS), 2)), ((0, 0), (0, 1)))
    exact = [project(scenes.CAMERA, points @ p[:3, :3].T + p[:3, 3]) for p in poses]
    return scenes.corners(np.array(exact) + rng.normal(0, SIGMA_PX, (VIEWS, len(points), 2)))


@pytest.fixture(scope="module")
def draws() -> dict[float, FloatArray]:
    """Errors of fx, fy, cx, cy, their u by views alone, and with the board, (draws, 3, 4)."""
    found = {}
    for print_mm in (0.0, PRINT_MM):
        rng = np.random.default_rng(3)
        poses = held(rng)
        rows = []
        for _ in range(40):
            corners = pictured(rng, poses, print_mm)
            fit = fit_opencv(corners, scenes.BOARD, lens="plumb-bob")
            scores = view_scores(fit.camera, fit.poses, fit.residuals, POINTS)
            by_views = fit.covariance * scores.dispersion()
            both = by_views + scores.board_covariance()
            error = intrinsic_vector(fit.camera) - intrinsic_vector(scenes.CAMERA)
            rows.append([error[:4], *(np.sqrt(np.diag(c)[:4]) for c in (by_views, both))])
        found[print_mm] = np.array(rows)
    return found


def test_errors_of_the_print_count_though_no_view_contradicts_another(
    draws: dict[float, FloatArray],
) -> None:
    error, by_views, both = draws[PRINT_MM].swapaxes(0, 1)
    held_by = [np.mean(np.abs(error[:, 2:]) < 1.96 * u[:, 2:]) for u in (by_views, both)]
    assert held_by[0] < 0.8
    assert held_by[1] > 0.9
    pulls = np.sqrt(np.mean((error / both) ** 2, axis=0))
    assert np.all(pulls < 1.2), pulls


def test_corner_noise_alone_adds_hardly_anything(draws: dict[float, FloatArray]) -> None:
    _, by_views, both = draws[0.0].swapaxes(0, 1)
    assert np.mean(both / by_views) < 1.05


def test_a_print_that_is_not_true_is_told_with_its_size() -> None:
    rng = np.random.default_rng(4)
    poses = held(rng)
    words = []
    for print_mm in (0.0, PRINT_MM):
        corners = pictured(rng, poses, print_mm)
        fit = fit_opencv(corners, scenes.BOARD, lens="plumb-bob")
        words.append(board_warning("c1", fit, corners, scenes.BOARD))
    assert words[0] == ()
    said = float(words[1][0].split("corners lie ")[1].split(" mm")[0])
    assert said == pytest.approx(PRINT_MM, rel=0.2)


@pytest.mark.slow
def test_a_joint_solve_counts_the_print_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lenses and pose of C2, 10 boards: by the views alone 82 % would be inside."""
    inside, alone = [], []
    drawn = scene_of_pairs.deformed
    for seed in range(10):
        rng = np.random.default_rng(200 + seed)
        off = np.pad(rng.normal(0, PRINT_MM, (54, 2)), ((0, 0), (0, 1)))

        def printed(
            points: FloatArray, warp: tuple[float, float] | None, off: FloatArray = off
        ) -> FloatArray:
            return drawn(points, warp) + off

        with monkeypatch.context() as patch:
            for module in (scene_of_pairs, board_scenes):
                patch.setattr(module, "deformed", printed)
            scene = scene_of_pairs.Scene(6, pairs=8, lens=8, rows=0)
        joint = solve_joint(*scene_of_pairs.posed(scene, rng))
        error = (joint.reduced.at.shared - scene_of_pairs.truth())[:24]
        std = np.sqrt(np.diag(joint.covariance))[:24]
        factors = np.repeat(joint.factors, [9, 9, 6])
        by_views = np.sqrt(factors * np.diag(joint.reduced.spread())[:24])
        inside.append(np.mean(np.abs(error) < 1.96 * std))
        alone.append(np.mean(np.abs(error) < 1.96 * by_views))
    assert np.mean(inside) > 0.92
    assert np.mean(alone) < 0.9
