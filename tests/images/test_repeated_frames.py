"""Pictures that nearly repeat another one. Evidence: simulated truth, errors common to a pose."""

from __future__ import annotations

from dataclasses import replace

import board_scenes as scenes
import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.geometry.board import Corners
from calib.geometry.camera import intrinsic_vector
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.covariance import view_scores
from calib.images.repeats import repeat_clusters, repeats_warning, summed

POINTS = scenes.BOARD.object_points()
POSES, FRAMES = 10, 3


def exact(rng: np.random.Generator) -> Corners:
    found: list[FloatArray] = []
    while len(found) < POSES:
        pose = scenes.board_pose(rng, scenes.BOARD, depth=(400, 900), tilt=0.6, spread=0.3)
        pixels = scenes.project(scenes.C1, POINTS @ scenes.matrix(pose)[:3, :3].T + pose[3:])
        if np.isfinite(pixels).all():
            found.append(pixels)
    return scenes.corners(scenes.C1, found)


def filmed(rng: np.random.Generator, found: Corners, frames: int) -> Corners:
    """Each pose in some frames: 0.1 px of error that the pose brings, 0.02 px of each frame."""
    common = found.pixels + rng.normal(0, 0.1, found.pixels.shape)
    pixels = np.repeat(common, frames, axis=0)
    pixels = pixels + rng.normal(0, 0.02, pixels.shape)
    names = tuple(f"{i:02d}.png" for i in range(len(pixels)))
    return replace(found, images=names, pixels=pixels, detector=("cache",) * len(names))


def solved(found: Corners, clusters: IntArray | None) -> tuple[FloatArray, FloatArray]:
    """Return fx, fy, cx, cy and their standard uncertainties."""
    fit = fit_opencv(found, scenes.BOARD, lens="plumb-bob")
    scores = view_scores(fit.camera, fit.poses, fit.residuals, POINTS)
    spread = fit.covariance * scores.dispersion(clusters)
    return intrinsic_vector(fit.camera)[:4], np.sqrt(np.diag(spread))[:4]


def test_frames_of_one_pose_are_one_cluster() -> None:
    rng = np.random.default_rng(0)
    found = filmed(rng, exact(rng), FRAMES)
    clusters = repeat_clusters(found.pixels, POINTS)
    assert clusters.tolist() == np.repeat(np.arange(POSES), FRAMES).tolist()
    warning = repeats_warning("c1", found.images, clusters)[0]
    assert "20 of 30 pictures nearly repeat another one" in warning
    assert "10 poses in all: 01.png, 02.png, 04.png" in warning
    assert summed(np.ones((30, 2)), clusters).tolist() == [[3.0, 3.0]] * POSES


def test_different_views_stay_apart_and_nothing_is_said() -> None:
    rng = np.random.default_rng(1)
    found = exact(rng)
    found.pixels[2, 5] = np.nan
    found.pixels[3] = np.nan  # no board
    clusters = repeat_clusters(found.pixels, POINTS)
    assert len(np.unique(clusters)) == POSES
    assert repeats_warning("c1", found.images, clusters) == ()


def test_more_frames_of_the_same_poses_make_nothing_more_certain() -> None:
    """Simulated truth, 20 draws: without clusters u is too small by the root of the frames."""
    rng = np.random.default_rng(2)
    scene = exact(rng)
    clusters = np.repeat(np.arange(POSES), FRAMES)
    truth = intrinsic_vector(scenes.C1)[:4]
    pulls, naive = [], []
    for _ in range(20):
        found = filmed(rng, scene, FRAMES)
        value, u = solved(found, clusters)
        pulls.append((value - truth) / u)
        naive.append((value - truth) / solved(found, None)[1])
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.3
    assert np.sqrt(np.mean(np.square(naive))) > 1.35
