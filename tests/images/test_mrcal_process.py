"""mrcal in its own process. Evidence: simulated truth; an independent tool (OpenCV); failures made
on purpose. Needs mrcal, which a machine without it says in the first failure."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import board_scenes as scenes
import cv2
import lens_scenes
import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.core.mrcal_python import mrcal_identity
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, intrinsic_vector, normalise
from calib.images.mrcal import call as mrcal_call
from calib.images.mrcal import worker as mrcal_worker
from calib.images.mrcal.call import MrcalMissingError
from calib.images.mrcal.solves import lens_fits, solve, splined_lens

OPENCV5 = "LENSMODEL_OPENCV5"
SIGMA_PX = 0.1


@pytest.fixture(scope="module")
def exact() -> scenes.Pairs:
    return scenes.pairs(np.random.default_rng(0), 14)


def truth(exact: scenes.Pairs) -> np.ndarray:
    """Intrinsics of both cameras, then the pose of C2 from C1 (the inverse of 1T2)."""
    back = np.linalg.inv(scenes.matrix(exact.pose_12))
    pose_21 = np.concatenate([cv2.Rodrigues(back[:3, :3])[0].ravel(), back[:3, 3]])
    return np.concatenate([intrinsic_vector(scenes.C1), intrinsic_vector(scenes.C2), pose_21])


def test_pair_of_cameras_is_recovered_within_the_stated_covariance(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(1)
    runs, square = 6, 0.0
    for _ in range(runs):
        found = [scenes.noisy(rng, c, SIGMA_PX) for c in (exact.c1, exact.c2)]
        solution = solve(found, scenes.BOARD, lens_model=OPENCV5, seed=0)
        estimate = np.concatenate([solution.intrinsics.ravel(), solution.camera_from_first.ravel()])
        error = estimate - truth(exact)
        square += error @ np.linalg.solve(solution.covariance, error) / len(error)
        # sigma of 3000 residuals is good to 1.3 %; a few are rejected as outliers.
        assert solution.sigma_px == pytest.approx(SIGMA_PX, rel=0.06)
    # Chi squared with 6 x 24 degrees of freedom over that number: standard deviation 0.12.
    assert 0.7 < square / runs < 1.4


def test_agrees_with_opencv_on_the_same_corners(exact: scenes.Pairs) -> None:
    found = scenes.noisy(np.random.default_rng(2), exact.c1, SIGMA_PX)
    fit = lens_fits(solve([found], scenes.BOARD, lens_model=OPENCV5, seed=0, warp=False), [found])[
        0
    ]
    points = [scenes.BOARD.object_points().astype(np.float32)] * len(found.images)
    _, matrix, distortion, _, _, std, _, _ = cv2.calibrateCameraExtended(
        points, list(found.pixels.astype(np.float32)), found.image_size, None, None
    )
    other = np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], distortion.ravel()])
    own_std = np.sqrt(np.diag(fit.covariance))
    # The two differ by mrcal's outlier rejection, a few of 1500 coordinates, and regularisation.
    assert np.all(np.abs(intrinsic_vector(fit.camera) - other) < 0.5 * own_std)
    assert own_std == pytest.approx(std.ravel()[:9], rel=0.05)
    assert fit.rms_px == pytest.approx(SIGMA_PX, rel=0.1)
    assert fit.residuals.shape == (14, 54, 2)


def test_poses_and_residuals_are_those_of_the_boards(exact: scenes.Pairs) -> None:
    found = [exact.c1, exact.c2]
    solution = solve(found, scenes.BOARD, lens_model=OPENCV5, seed=0, warp=False)
    # Exact corners: what is left is mrcal's regularisation, far below a corner's noise.
    assert solution.poses == pytest.approx(exact.poses, rel=1e-3, abs=2e-3)
    assert np.nanmax(np.abs(solution.residuals)) < 0.01
    second = lens_fits(solution, found)[1]
    board_in_c2 = np.linalg.inv(scenes.matrix(exact.pose_12)) @ scenes.matrix(exact.poses[3])
    assert scenes.matrix(second.poses[3]) == pytest.approx(board_in_c2, rel=1e-3, abs=2e-3)


def test_bow_of_the_board_is_recovered() -> None:
    rng = np.random.default_rng(3)
    bow = (0.8, -0.4)
    scene = scenes.pairs(rng, 14, warp_mm=bow)
    found = [scenes.noisy(rng, c, SIGMA_PX) for c in (scene.c1, scene.c2)]
    solution = solve(found, scenes.BOARD, lens_model=OPENCV5, seed=0)
    # 0.1 px are 0.1 mm across at 800 mm; a bow seen at 0.4 rad, by 28 views of 54 corners:
    # 0.1 / 0.4 / sqrt(28 * 54) = 0.006 mm, five times that for what poses and lens take up.
    assert solution.board_warp_mm == pytest.approx(bow, abs=0.03)
    error = solution.camera_from_first[0] - truth(scene)[-6:]
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(solution.covariance))[-6:])


def test_incomplete_boards_and_outliers_do_no_harm(exact: scenes.Pairs) -> None:
    rng = np.random.default_rng(4)
    found = scenes.noisy(rng, exact.c1, SIGMA_PX)
    pixels = np.array(found.pixels)
    pixels[rng.random(pixels.shape[:2]) < 0.3] = np.nan
    pixels[5] = np.nan
    wrong = [(2, 11), (7, 30), (9, 53)]
    for view, corner in wrong:
        pixels[view, corner] = found.pixels[view, corner] + 4.0
    found = Corners(found.images, pixels, found.detector, found.image_size)
    solution = solve([found], scenes.BOARD, lens_model=OPENCV5, seed=0)
    assert all(solution.rejected[0, view, corner] for view, corner in wrong)
    # Beyond the three, mrcal rejects beyond about 4 sigma: 1 of 16,000 normal errors.
    assert solution.rejected.sum() <= 8
    assert np.isnan(solution.poses[5]).all()
    assert np.isnan(solution.residuals[0][np.isnan(pixels[..., 0])]).all()
    error = solution.intrinsics[0] - intrinsic_vector(scenes.C1)
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(solution.covariance)))


def test_splined_lens_sees_the_true_rays(exact: scenes.Pairs) -> None:
    found = scenes.noisy(np.random.default_rng(5), exact.c1, SIGMA_PX)
    model = splined_lens(found, focal_px=820.0)
    solution = solve([found], scenes.BOARD, lens_model=model, seed=0)
    assert solution.covariance is None
    grid = solution.grids[0]
    inner = grid.std_px < np.quantile(grid.std_px, 0.2)  # where boards were
    assert grid.std_px[inner].max() < 3 * SIGMA_PX
    rays = normalise(scenes.C1, grid.pixels[inner])
    rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    # Rotation of a splined camera means nothing by itself: align first (Kabsch).
    u, _, v = np.linalg.svd(rays.T @ grid.rays[inner])
    apart = np.linalg.norm(grid.rays[inner] @ (u @ v).T - rays, axis=-1) * scenes.C1.matrix[0, 0]
    # Few boards, so the error is one smooth field: 4 standard deviations for all of it at once.
    assert np.sqrt(np.mean(apart**2)) < 4 * np.median(grid.std_px[inner])
    assert solution.grids[0].pixels[-1, -1] == pytest.approx([1279, 959])


def test_regularisation_passes_for_no_knowledge_of_a_long_lens() -> None:
    """Lenses of 20 deg: the corners hardly tell k2 and k3, mrcal's regularisation pulls them to 0.

    With the scatter of the regularised estimate as its uncertainty, k2 stood 3.2 and 3.4 standard
    deviations off here.
    """
    lens = Camera(
        np.array([[5200.0, 0, 975], [0, 5206, 527], [0, 0, 1]]),
        np.array([-0.04, 0.2, 0, 2e-4, 0]),
        (1920, 1080),
    )
    board = Board("chessboard", 7, 5, 60.0, (3, 2))

    def place(rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(2500, 5000) * np.array([*rng.uniform((-0.15, -0.08), (0.15, 0.08)), 1])

    for seed in (0, 2):
        rng = np.random.default_rng(seed)
        poses = lens_scenes.poses(12, rng, camera=lens, board=board, place=place)
        views = np.stack([lens_scenes.seen_by(lens, pose, board) for pose in poses])
        noisy = lens_scenes.corners(views + rng.normal(0, 0.05, views.shape), lens.image_size)
        solution = solve([noisy], board, lens_model=OPENCV5, seed=0, focal_px=[5000.0])
        error = solution.intrinsics[0] - intrinsic_vector(lens)
        pulls = error / np.sqrt(np.diag(solution.covariance))
        # Of nine normal errors the largest is below 3 standard deviations in 98 of 100 cases.
        assert np.abs(pulls).max() < 3


def test_directions_left_open_are_told_from_strong_correlation() -> None:
    correlated = np.array([[1.0, 0.999999], [0.999999, 1.0]])
    units = np.diag([1e3, 1e-6])
    assert mrcal_worker.determined(units @ correlated @ units)
    assert not mrcal_worker.determined(np.ones((2, 2)))
    assert not mrcal_worker.determined(np.array([[1.0, np.nan], [np.nan, 1.0]]))
    assert not mrcal_worker.determined(np.diag([1.0, 0.0]))


def test_model_file_is_mrcals_and_runs_repeat(exact: scenes.Pairs) -> None:
    one, two = (solve([exact.c1], scenes.BOARD, lens_model=OPENCV5, seed=7) for _ in range(2))
    assert OPENCV5 in one.model_files[0]
    assert one.model_files == two.model_files
    assert one.covariance.tobytes() == two.covariance.tobytes()


def test_worker_knows_the_names_of_both_generations() -> None:
    request = {
        "indices": np.array([[0, 0]], dtype=np.int32),
        "observations": np.zeros((1, 6, 9, 3)),
        "image_sizes": np.array([[640, 480]], dtype=np.int32),
    }
    header = {"square_mm": 30.0}

    class Old:
        class cameramodel:  # noqa: N801 - mrcal's name
            pass

    class New:
        class cameramodel:  # noqa: N801 - mrcal's name
            rt_cam_ref = None

    old = mrcal_worker.Problem(Old, request, header)
    new = mrcal_worker.Problem(New, request, header)
    assert (old.cameras_key, old.frames_key) == ("extrinsics_rt_fromref", "frames_rt_toref")
    assert (new.cameras_key, new.frames_key) == ("rt_cam_ref", "rt_ref_frame")


@pytest.mark.parametrize("interpreter", ["/nowhere/python", sys.executable])
def test_missing_mrcal_is_named_with_the_remedy(
    exact: scenes.Pairs, monkeypatch: pytest.MonkeyPatch, interpreter: str
) -> None:
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, interpreter)
    with pytest.raises(MrcalMissingError, match="apt install python3-mrcal") as caught:
        solve([exact.c1], scenes.BOARD, lens_model=OPENCV5, seed=0)
    assert interpreter in str(caught.value)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("kill -SEGV $$", "SIGSEGV"),
        ("kill -KILL $$", "killed.*out of memory"),
        ("echo first >&2; echo 'no convergence' >&2; exit 1", "failed: no convergence"),
        ("exec sleep 60", "no answer within"),
    ],
)
def test_crash_failure_and_hang_become_errors(
    exact: scenes.Pairs,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    script: str,
    words: str,
) -> None:
    interpreter = tmp_path / "python"
    interpreter.write_text(f"#!/bin/sh\n{script}\n", encoding="ascii")
    interpreter.chmod(0o755)
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, str(interpreter))
    monkeypatch.setattr(mrcal_call, "TIMEOUT_S", 0.5)
    with pytest.raises(EstimationError, match=words):
        solve([exact.c1], scenes.BOARD, lens_model=OPENCV5, seed=0)


def test_worker_killed_in_mid_solve_is_named(
    exact: scenes.Pairs, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """mrcal itself, sent SIGKILL from outside once it has read its request."""
    marker = tmp_path / "pid"
    interpreter = tmp_path / "python"
    # The shell becomes the real interpreter: the process it names is the one that solves.
    real = mrcal_call.mrcal_interpreter()
    interpreter.write_text(f'#!/bin/sh\necho $$ >"{marker}"\nexec "{real}" "$@"\n', "ascii")
    interpreter.chmod(0o755)
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, str(interpreter))
    killed = []

    def kill() -> None:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            text = marker.read_text() if marker.exists() else ""
            if text.endswith("\n") and b"mrcal" in Path(f"/proc/{int(text)}/maps").read_bytes():
                os.kill(int(text), signal.SIGKILL)
                killed.append(int(text))
                return
            time.sleep(0.005)

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(EstimationError, match="mrcal was killed"):
        solve([exact.c1], scenes.BOARD, lens_model=OPENCV5, seed=0)
    killer.join()
    assert len(killed) == 1


def test_too_few_views_are_refused(exact: scenes.Pairs) -> None:
    few = Corners(
        exact.c1.images[:2], exact.c1.pixels[:2], exact.c1.detector[:2], exact.c1.image_size
    )
    with pytest.raises(EstimationError, match="2 views"):
        solve([few], scenes.BOARD, lens_model=OPENCV5, seed=0)


def test_version_is_told_as_far_as_it_is_known(exact: scenes.Pairs) -> None:
    elsewhere = SimpleNamespace(__file__="/opt/mrcal/mrcal/__init__.py")
    assert mrcal_worker.version_of(SimpleNamespace(__version__="2.5")) == "2.5"
    assert mrcal_worker.version_of(elsewhere) == "unknown"
    found = scenes.noisy(np.random.default_rng(2), exact.c1, SIGMA_PX)
    solution = solve([found], scenes.BOARD, lens_model=OPENCV5, seed=0)
    assert re.match(r"\d+\.\d+", solution.version), solution.version


@pytest.mark.parametrize(
    "script",
    [
        "exit 0",
        "printf '\\377\\376\\n'; exit 0",
        "echo no >reply.npz",
        "printf 'PK\\003\\004' >reply.npz",
    ],
)
def test_an_interpreter_that_is_none(
    script: str, exact: scenes.Pairs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bytes that are no UTF-8, no reply, or one that is no archive: a word, and no traceback."""
    interpreter = tmp_path / "python"
    interpreter.write_text(f"#!/bin/sh\n{script}\n", encoding="ascii")
    interpreter.chmod(0o755)
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, str(interpreter))
    with pytest.raises(EstimationError, match="without an answer of mrcal"):
        solve([exact.c1], scenes.BOARD, lens_model=OPENCV5, seed=0)


def test_identity_that_is_no_utf_8(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interpreter = tmp_path / "python"
    interpreter.write_text("#!/bin/sh\nprintf '\\377\\376\\n'\n", encoding="ascii")
    interpreter.chmod(0o755)
    monkeypatch.setenv(mrcal_call.INTERPRETER_VARIABLE, str(interpreter))
    assert mrcal_identity() == "\\xff\\xfe"
