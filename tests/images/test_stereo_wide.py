"""The pose of C2 where a camera is a wide lens. Evidence: simulated truth; independent tools that
see the same rays (mrcal as stereographic cameras, cv2.fisheye)."""

from __future__ import annotations

import board_scenes as scenes
import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.geometry.camera import Camera, project
from calib.images.joint.gather import gather
from calib.images.joint.model import normals_of, residuals_of
from calib.images.joint.reduced import Unknowns
from calib.images.pairs import single_view_pose, start_pairs
from calib.images.stereo.backends import nothing_besides
from calib.images.stereo.by_opencv import solve_opencv
from calib.images.stereo.reference import StereoReference, stereo_reference
from calib.images.stereo.solve import CameraPair
from calib.images.stereo.wide import as_stereographic

WIDE = Camera(
    np.array([[400.0, 0, 640], [0, 401, 480], [0, 0, 1]]),
    np.array([-0.02, 0.004, -0.002, 3e-4]),
    (1280, 960),
    "equidistant",
)
PAIRS = 12


def solved(cameras: tuple[Camera, Camera]) -> tuple[StereoReference, np.ndarray]:
    rng = np.random.default_rng(0)
    pairs = scenes.pairs(rng, PAIRS, cameras=cameras)
    found = scenes.noisy(rng, pairs.c1, 0.1), scenes.noisy(rng, pairs.c2, 0.1)
    known = [np.zeros((4 + len(c.distortion),) * 2) for c in cameras]
    rig = CameraPair(cameras, (known[0], known[1]))
    stems = tuple(f"{i:02d}" for i in range(PAIRS))
    return stereo_reference(found, scenes.BOARD, rig, stems=stems, seed=0), pairs.pose_12


@pytest.mark.parametrize(
    ("c2", "backends"),
    [(scenes.C2, ["joint", "mrcal"]), (WIDE, ["joint", "mrcal", "opencv"])],
    ids=["beside a pinhole", "both"],
)
def test_pose_with_a_wide_lens(c2: Camera, backends: list[str]) -> None:
    found, truth = solved((WIDE, c2))
    assert all(gate.passed for gate in found.gates), found.gates
    std = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.pose_12 - truth) < 4 * std).all()
    assert std[3] < 0.1
    assert [solve.backend for solve in found.solves] == backends
    for other in found.solves[1:]:
        # Other solvers on the same corners: far nearer to ours than all are to the truth.
        assert (np.abs(other.pose_12 - found.pose_12) < 0.2 * std).all(), other.backend
    told = next(gate.detail for gate in found.gates if gate.name == "stereo-backends")
    assert ("no check by OpenCV" in told) == ("opencv" not in backends)


def test_opencv_says_what_it_cannot_do() -> None:
    rng = np.random.default_rng(1)
    pairs = scenes.pairs(rng, 5, cameras=(WIDE, scenes.C2))
    rig = CameraPair((WIDE, scenes.C2), (np.zeros((8, 8)), np.zeros((9, 9))))
    start = start_pairs((pairs.c1, pairs.c2), scenes.BOARD, cameras=rig.cameras)
    with pytest.raises(EstimationError, match="a pinhole and a fisheye together"):
        solve_opencv(start, scenes.BOARD, rig)


def test_stereographic_picture_by_hand() -> None:
    angle = np.deg2rad([0.0, 30.0, 75.0])
    rays = np.stack([np.zeros(3), np.sin(angle), np.cos(angle)], axis=-1)
    seen = as_stereographic(WIDE, project(WIDE, rays))
    np.testing.assert_allclose(seen[:, 1], 480 + 401 * 2 * np.tan(angle / 2), atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_pose_of_a_board_at_the_rim(seed: int) -> None:
    rng = np.random.default_rng(seed)
    away = np.deg2rad(rng.uniform(55, 70))
    turn = scenes.board_pose(rng, scenes.BOARD, depth=(1, 2), tilt=0.4, spread=0.0)[:3]
    about = rng.uniform(0, 2 * np.pi)
    pose = np.array([*turn, np.cos(about), np.sin(about), 1 / np.tan(away)])
    pose[3:] *= 500 / np.linalg.norm(pose[3:])
    points = scenes.BOARD.object_points() - scenes.BOARD.object_points().mean(axis=0)
    moved = points @ scenes.matrix(pose)[:3, :3].T + pose[3:]
    found, rms = single_view_pose(WIDE, points=points, pixels=project(WIDE, moved))
    np.testing.assert_allclose(found, pose, atol=1e-6)
    assert rms < 1e-8


def test_derivatives_of_the_joint_solve_agree_with_differences() -> None:
    """The gradient that the solve follows is that of its cost, lenses free."""
    rng = np.random.default_rng(2)
    cameras = (WIDE, scenes.C2)
    pairs = scenes.pairs(rng, 4, cameras=cameras)
    found = scenes.noisy(rng, pairs.c1, 0.3), scenes.noisy(rng, pairs.c2, 0.3)
    start = start_pairs(found, scenes.BOARD, cameras=cameras)
    problem, at = gather(
        start, found, nothing_besides(found), scenes.BOARD, cameras=cameras, free=(True, True)
    )
    weight = np.ones(problem.images.pixels.shape[:2])
    normals = normals_of(problem, at, weight)

    def cost(x: np.ndarray) -> float:
        return float(np.nansum(residuals_of(problem, Unknowns(x, at.own)) ** 2)) / 2

    gradient = normals.shared_gradient.sum(axis=0)
    scale = np.sqrt(np.diag(normals.shared.sum(axis=0)))
    for k in range(problem.size):
        step = 1e-4 / scale[k] * np.eye(problem.size)[k]
        slope = (cost(at.shared + step) - cost(at.shared - step)) / (2 * step[k])
        assert slope / scale[k] == pytest.approx(gradient[k] / scale[k], rel=1e-5, abs=1e-4)
