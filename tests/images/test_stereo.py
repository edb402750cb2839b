"""The stereo reference. Evidence: simulated truth, with coverage by repetition; an independent
tool (mrcal) for the covariance; properties (jacobians, half turns of boards).

Negative controls are in test_stereo_faults.py.
"""

from __future__ import annotations

from dataclasses import replace

import board_scenes as scenes
import numpy as np
import pytest
from stereo_scenes import KNOWN, LENS_COVARIANCE, SIGMA_PX, noisy

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import camera_from_vector, intrinsic_vector
from calib.geometry.poses import invert_pose, pose_matrix, pose_vector, transform
from calib.images.mrcal import call as mrcal_call
from calib.images.mrcal import solves as mrcal_process
from calib.images.pairs import start_pairs
from calib.images.stereo.by_opencv import solve_opencv
from calib.images.stereo.reference import given_reference, stereo_reference
from calib.images.stereo.solve import CameraPair, joint_covariance, solve_mrcal
from calib.images.stereo.triangulate import find_targets, position_on_board, triangulate


@pytest.fixture(scope="module")
def exact() -> scenes.Pairs:
    return scenes.pairs(np.random.default_rng(0), 14)


def drawn_lenses(rng: np.random.Generator) -> CameraPair:
    """Cameras as an intrinsics stage would find them: off the truth by their covariance."""
    std = np.sqrt(np.diag(LENS_COVARIANCE))
    one, two = (
        camera_from_vector(intrinsic_vector(c) + std * rng.normal(size=9), c.image_size)
        for c in (scenes.C1, scenes.C2)
    )
    return CameraPair((one, two), (LENS_COVARIANCE, LENS_COVARIANCE))


def true_targets(scene: scenes.Pairs, board: Board) -> FloatArray:
    target = board.object_points()[[board.target_index]]
    return np.concatenate([transform(pose, target) for pose in scene.poses])


def test_poses_invert_and_convert() -> None:
    pose = np.array([0.3, -0.5, 0.2, 10.0, -20.0, 30.0])
    covariance = np.diag([1e-3, 2e-3, 3e-3, 0.1, 0.2, 0.3]) ** 2
    back, spread = invert_pose(pose, covariance)
    assert pose_matrix(back) == pytest.approx(np.linalg.inv(pose_matrix(pose)), abs=1e-12)
    assert pose_vector(pose_matrix(pose)) == pytest.approx(pose, abs=1e-12)
    assert invert_pose(back, spread)[1] == pytest.approx(covariance, abs=1e-12)
    steps = 1e-6 * np.eye(6)
    slopes = [
        (invert_pose(pose + h, covariance)[0] - invert_pose(pose - h, covariance)[0]) / 2e-6
        for h in steps
    ]
    jacobian = np.array(slopes).T
    assert spread == pytest.approx(jacobian @ covariance @ jacobian.T, rel=1e-6, abs=1e-12)


def test_exact_corners_give_the_exact_pose(exact: scenes.Pairs) -> None:
    start = start_pairs((exact.c1, exact.c2), scenes.BOARD, cameras=KNOWN.cameras)
    solve = solve_opencv(start, scenes.BOARD, KNOWN)
    # OpenCV takes single-precision corners: 6e-5 px at 1000 px.
    assert solve.pose_12 == pytest.approx(scenes.POSE_12, rel=1e-6, abs=1e-4)
    assert solve.rms_px < 1e-4
    # Bouguet's convention, P2 = R P1 + T, is the inverse.
    point_2 = np.array([[30.0, -20.0, 700.0]])
    point_1 = transform(solve.pose_12, point_2)
    assert transform(invert_pose(solve.pose_12, np.zeros((6, 6)))[0], point_1) == pytest.approx(
        point_2, abs=1e-6
    )


def test_covariances_of_pose_and_depth_hold_over_repetitions(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(1)
    runs = 60
    truth = true_targets(exact, scenes.BOARD)
    pose_square, depth_pulls, board_pulls = 0.0, [], []
    for _ in range(runs):
        rig = drawn_lenses(rng)
        start = start_pairs(noisy(rng, exact), scenes.BOARD, cameras=rig.cameras)
        solve = solve_opencv(start, scenes.BOARD, rig)
        error = solve.pose_12 - scenes.POSE_12
        pose_square += error @ np.linalg.solve(solve.covariance, error) / 6
        targets = find_targets(
            start.pixels,
            scenes.BOARD,
            cameras=rig.cameras,
            stems=exact.c1.images,
            pose_12=solve.pose_12,
            shared_covariance=joint_covariance(rig, solve),
            sigma_px=solve.sigma_px,
            warp_mm=None,
        )
        off = targets.triangulated.position_mm - truth
        depth_pulls.append(off[:, 2] / targets.depth_std_mm)
        board_pulls.append(targets.board_sigmas)
    # Chi squared with 360 degrees of freedom over that number: standard deviation 0.075.
    assert 0.75 < pose_square / runs < 1.3
    # Depths of one run share their errors; 60 runs alone make the rms good to 0.09.
    assert 0.7 < np.sqrt(np.mean(np.square(depth_pulls))) < 1.3
    assert 0.7 < np.sqrt(np.mean(np.square(board_pulls))) < 1.3


def test_covariance_is_mrcals_own(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(2)
    start = start_pairs(noisy(rng, exact), scenes.BOARD, cameras=KNOWN.cameras)
    ours = solve_mrcal(start, scenes.BOARD, KNOWN, seed=0)
    held = mrcal_process.StartingPoint(
        np.stack([intrinsic_vector(c) for c in KNOWN.cameras]),
        invert_pose(start.pose_12, np.zeros((6, 6)))[0][None],
        start.poses,
    )
    found = [
        Corners(exact.c1.images, pixels, exact.c1.detector, (1280, 960)) for pixels in start.pixels
    ]
    theirs = mrcal_process.solve(
        found, scenes.BOARD, lens_model="LENSMODEL_OPENCV5", seed=0, held=held
    )
    assert theirs.covariance is not None
    pose, covariance = invert_pose(theirs.camera_from_first[0], theirs.covariance)
    assert ours.pose_12 == pytest.approx(pose, rel=1e-9)
    scale = np.sqrt(np.diag(covariance))
    assert ours.noise_covariance / ours.dispersion / np.outer(scale, scale) == pytest.approx(
        covariance / np.outer(scale, scale), abs=1e-6
    )
    plain = solve_opencv(start, scenes.BOARD, KNOWN)
    # Same corners, same intrinsics: apart by mrcal's few outliers and the bow only.
    assert np.all(np.abs(plain.pose_12 - ours.pose_12) < scale)


def test_pose_follows_the_intrinsics_as_stated(exact: scenes.Pairs) -> None:
    # Noise, so that a small error of the lens makes no outliers.
    found = noisy(np.random.default_rng(9), exact)
    start = start_pairs(found, scenes.BOARD, cameras=KNOWN.cameras)
    solve = solve_opencv(start, scenes.BOARD, KNOWN)
    std = 0.1 * np.sqrt(np.diag(LENS_COVARIANCE))
    for k in (0, 2, 4, 9, 11, 13):
        shift = np.zeros((2, 9))
        shift[k // 9, k % 9] = std[k % 9]
        both = []
        for sign in (1, -1):
            one, two = (
                camera_from_vector(intrinsic_vector(c) + sign * s, c.image_size)
                for c, s in zip(KNOWN.cameras, shift, strict=True)
            )
            moved = replace(KNOWN, cameras=(one, two))
            both.append(solve_opencv(start, scenes.BOARD, moved).pose_12)
        slope = (both[0] - both[1]) / 2
        stated = solve.by_intrinsics[:, k] * std[k % 9]
        # Least squares linearised without second derivatives: good to residual over curvature,
        # some per cent of the largest of its kind.
        for part in (slice(0, 3), slice(3, 6)):
            limit = 0.02 * np.abs(stated[part]).max()
            assert slope[part] == pytest.approx(stated[part], abs=limit)


def test_triangulation_jacobians_agree_with_differences(exact: scenes.Pairs) -> None:
    cameras = KNOWN.cameras
    target = scenes.BOARD.target_index
    pixels = np.stack([exact.c1.pixels[:3, target], exact.c2.pixels[:3, target]])

    def positions(vector: FloatArray) -> FloatArray:
        one, two = (camera_from_vector(v, (1280, 960)) for v in (vector[:9], vector[9:18]))
        return triangulate(
            pixels, cameras=(one, two), pose_12=vector[18:], sigma_px=SIGMA_PX
        ).position_mm

    vector = np.concatenate([*(intrinsic_vector(c) for c in cameras), scenes.POSE_12])
    found = triangulate(pixels, cameras=cameras, pose_12=scenes.POSE_12, sigma_px=SIGMA_PX)
    assert found.position_mm == pytest.approx(true_targets(exact, scenes.BOARD)[:3], abs=1e-6)
    assert found.miss_px.max() < 1e-8
    step = 1e-5
    for k in range(len(vector)):
        up, down = (positions(vector + s * step * np.eye(24)[k]) for s in (1, -1))
        assert (up - down) / (2 * step) == pytest.approx(
            found.by_shared[:, :, k], rel=1e-5, abs=1e-4
        )


def test_board_pose_jacobian_agrees_with_differences(exact: scenes.Pairs) -> None:
    vector = intrinsic_vector(scenes.C1)

    def positions(intrinsics: FloatArray) -> FloatArray:
        camera = camera_from_vector(intrinsics, (1280, 960))
        return position_on_board(
            exact.c1.pixels[:2],
            scenes.BOARD,
            cameras=(camera, scenes.C2),
            sigma_px=SIGMA_PX,
            warp_mm=None,
        ).position_mm

    found = position_on_board(
        exact.c1.pixels[:2], scenes.BOARD, cameras=KNOWN.cameras, sigma_px=SIGMA_PX, warp_mm=None
    )
    for k in (0, 1, 2, 3, 4):
        step = 0.1 * np.sqrt(LENS_COVARIANCE[k, k]) * np.eye(9)[k]
        slope = (positions(vector + step) - positions(vector - step)) / 2
        stated = found.by_shared[:, :, k] * step[k]
        assert slope == pytest.approx(stated, rel=0.02, abs=0.02 * np.abs(stated).max())


def test_reference_reports_both_backends(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(3)
    rig = drawn_lenses(rng)
    reference = stereo_reference(
        noisy(rng, exact), scenes.BOARD, rig, stems=exact.c1.images, seed=0
    )
    assert reference.source == "joint"
    assert [(s.backend, s.intrinsics) for s in reference.solves] == [
        ("joint", "held"),
        ("mrcal", "held"),
        ("opencv", "held"),
    ]
    assert [g.name for g in reference.gates if not g.passed] == []
    assert reference.stems == exact.c1.images
    assert reference.turned == ()
    assert reference.transform_12 == pytest.approx(pose_matrix(reference.pose_12))
    apart = reference.baseline_mm - np.linalg.norm(scenes.POSE_12[3:])
    assert abs(apart) < 4 * reference.baseline_std_mm
    targets = reference.targets
    assert targets.shared_covariance.shape == (24, 24)
    assert targets.shared_names[9:12] == ("c2.fx", "c2.fy", "c2.cx")
    assert (
        np.linalg.eigvalsh(
            targets.shared_covariance / np.outer(*2 * [np.sqrt(np.diag(targets.shared_covariance))])
        )[0]
        > -1e-9
    )


def test_bowed_board_is_named_as_the_reason() -> None:
    rng = np.random.default_rng(4)
    scene = scenes.pairs(rng, 14, warp_mm=(1.5, -1.0))
    reference = stereo_reference(
        noisy(rng, scene), scenes.BOARD, KNOWN, stems=scene.c1.images, seed=0
    )
    agreement = next(g for g in reference.gates if g.name == "stereo-backends")
    assert "deformed by 1.49 mm along x and -1.01 mm along y" in agreement.detail
    error = reference.pose_12 - scenes.POSE_12
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(reference.covariance)))
    assert reference.rms_px == pytest.approx(SIGMA_PX, rel=0.05)
    assert reference.solves[2].rms_px > 2 * SIGMA_PX


def test_a_flat_board_has_no_bow_of_minus_nought() -> None:
    rng = np.random.default_rng(1)
    scene = scenes.pairs(rng, 14)
    found = [scenes.noisy(rng, corners, 0.002) for corners in (scene.c1, scene.c2)]
    reference = stereo_reference(
        (found[0], found[1]), scenes.BOARD, KNOWN, stems=scene.c1.images, seed=0
    )
    warp = reference.solves[0].board_warp_mm
    assert warp is not None
    assert -0.005 < min(warp) < 0
    agreement = next(g for g in reference.gates if g.name == "stereo-backends")
    assert "deformed by 0.00 mm along x and 0.00 mm along y" in agreement.detail


def test_pairs_read_from_either_end_are_put_right() -> None:
    rng = np.random.default_rng(5)
    board = replace(scenes.BOARD, columns=8)
    scene = scenes.pairs(rng, 11, board=board)
    c1, c2 = noisy(rng, scene)
    for view in (2, 7):
        c2.pixels[view] = c2.pixels[view, ::-1]
    start = start_pairs((c1, c2), board, cameras=KNOWN.cameras)
    assert np.flatnonzero(start.turned).tolist() == [2, 7]
    solve = solve_opencv(start, board, KNOWN)
    error = solve.pose_12 - scenes.POSE_12
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(solve.covariance)))
    # Most of C2's boards read from the other end: the upright rig is still found.
    c2.pixels[:9] = c2.pixels[:9, ::-1]
    again = start_pairs((c1, c2), board, cameras=KNOWN.cameras)
    assert solve_opencv(again, board, KNOWN).pose_12 == pytest.approx(solve.pose_12, rel=1e-4)


def test_outliers_are_left_out(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(6)
    c1, c2 = noisy(rng, exact)
    c2.pixels[3, 7] += 5.0
    c1.pixels[8, 50] -= 3.0
    c1.pixels[5, 10:40] = np.nan
    start = start_pairs((c1, c2), scenes.BOARD, cameras=KNOWN.cameras)
    solve = solve_opencv(start, scenes.BOARD, KNOWN)
    assert np.isnan(solve.residuals[:, 3, 7]).all()
    assert np.isnan(solve.residuals[:, 8, 50]).all()
    # Both corners of a pair go; beyond the two, 5 sigma leaves out 1 of 10^6.
    assert solve.rejected == 4
    error = solve.pose_12 - scenes.POSE_12
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(solve.covariance)))


def test_without_mrcal_opencv_goes_on_and_says_so(
    exact: scenes.Pairs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, "/nowhere/python")
    found = noisy(np.random.default_rng(7), exact)
    reference = stereo_reference(found, scenes.BOARD, KNOWN, stems=exact.c1.images, seed=0)
    assert reference.source == "joint"
    assert [s.backend for s in reference.solves] == ["joint", "opencv"]
    agreement = next(g for g in reference.gates if g.name == "stereo-backends")
    assert agreement.passed
    assert "apt install python3-mrcal" in agreement.detail
    error = reference.pose_12 - scenes.POSE_12
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(reference.covariance)))


def test_given_transform_yields_targets(exact: scenes.Pairs) -> None:
    rig = CameraPair(KNOWN.cameras, (LENS_COVARIANCE, LENS_COVARIANCE))
    reference = given_reference(
        (exact.c1, exact.c2),
        scenes.BOARD,
        rig,
        stems=exact.c1.images,
        transform_12=scenes.matrix(scenes.POSE_12),
    )
    assert reference.source == "given"
    assert reference.baseline_std_mm == 0
    truth = true_targets(exact, scenes.BOARD)
    assert reference.targets.triangulated.position_mm == pytest.approx(truth, abs=1e-5)
    assert reference.targets.depth_std_mm.min() > 0
    none = Corners((), np.empty((0, 54, 2)), (), (1280, 960))
    bare = given_reference(
        (none, none), scenes.BOARD, rig, stems=(), transform_12=scenes.matrix(scenes.POSE_12)
    )
    assert len(bare.targets.stems) == 0
