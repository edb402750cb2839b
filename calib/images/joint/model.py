"""Board images of two cameras as one least-squares problem, with derivatives.

Shared unknowns, in this order: intrinsics of C1 and of C2, each where it is not given; the pose of
C2 in C1; the board deformation along x and along y. Own unknowns of a view: the pose of the board,
in C1 where C1 sees it or both do, in C2 where C2 sees it alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera, project_points
from calib.geometry.poses import rotation
from calib.images.board_errors import BoardSums, Equations
from calib.images.bundle import deformed
from calib.images.joint.reduced import Unknowns, ViewNormals
from calib.images.joint.unknowns import LensesAndBoard

POSE = 6
WARP = 2


@dataclass(frozen=True)
class BoardImages:
    """Images of one board, i of them, by view of the board, v of them.

    Parameters
    ----------
    names
        Of the images.
    kinds
        What each was taken for: "lens", "pair" or "row".
    camera
        0 for C1, 1 for C2, shape (i,).
    view
        Which view each shows, shape (i,).
    in_pair
        Whether C1 sees the view too, so that the pose of C2 shows in it, shape (i,); C2 only.
    pixels
        Corners found, px, shape (i, corners, 2); NaN where not.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    camera: IntArray
    view: IntArray
    in_pair: BoolArray
    pixels: FloatArray

    @property
    def views(self) -> int:
        """Number of views, v."""
        return int(self.view.max()) + 1


@dataclass(frozen=True)
class JointProblem(LensesAndBoard):
    """The problem: images, the board as drawn, cameras to start from, and which are given.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    cameras
        C1 and C2 to start from.
    free
        Whether the intrinsics of each are unknowns.
    """

    images: BoardImages
    points: FloatArray
    cameras: tuple[Camera, Camera]
    free: tuple[bool, bool]

    @property
    def pictured(self) -> BoardImages:
        """The images."""
        return self.images

    @property
    def at_pose(self) -> IntArray:
        """Places of the pose of C2 in C1, shape (6,)."""
        first = self.after_lenses
        return np.arange(first, first + POSE)

    @property
    def at_warp(self) -> IntArray:
        """Places of the board's warp, shape (2,)."""
        first = int(self.at_pose[-1]) + 1
        return np.arange(first, first + WARP)

    @property
    def size(self) -> int:
        """Number of shared unknowns."""
        return int(self.at_warp[-1]) + 1

    def start(self, pose_12: FloatArray, poses: FloatArray) -> Unknowns:
        """Return the unknowns of the cameras given, a flat board and these poses."""
        return Unknowns(np.concatenate([*self.lenses, pose_12, np.zeros(WARP)]), poses)


def residuals_of(problem: JointProblem, at: Unknowns) -> FloatArray:
    """Return observed minus projected, px, shape (i, corners, 2); NaN where not found."""
    seen = _in_cameras(problem, at)
    residuals = problem.images.pixels.copy()
    for c in (0, 1):
        own = problem.images.camera == c
        if not own.any():
            continue
        camera = problem.camera_at(at.shared, c)
        residuals[own] -= project_points(camera, seen[own].reshape(-1, 3)).pixels.reshape(
            int(own.sum()), -1, 2
        )
    return residuals


def normals_of(problem: JointProblem, at: Unknowns, weight: FloatArray) -> ViewNormals:
    """Return the normal equations of the views.

    Parameters
    ----------
    weight
        Of each corner, 1/px^2, shape (i, corners); 0 leaves it out.
    """
    images, n = problem.images, problem.size
    sums = ViewNormals(
        np.zeros((images.views, n, n)),
        np.zeros((images.views, n, POSE)),
        np.zeros((images.views, POSE, POSE)),
        np.zeros((images.views, n)),
        np.zeros((images.views, POSE)),
        0.0,
    )
    cost = 0.0
    for found in _equations(problem, at, weight):
        _add(sums, found)
        cost += float(np.sum(found.off**2))
    return sums._replace(cost=cost)


def board_covariance(problem: JointProblem, at: Unknowns, weight: FloatArray) -> FloatArray:
    """Return what errors of the board add to the covariance of the shared unknowns, (n, n).

    At the minimum; `weight` as in `normals_of`. See `calib.images.board_errors`.
    """
    sums = BoardSums(problem.images.views, len(problem.points), problem.size)
    for found in _equations(problem, at, weight):
        sums.add(found)
    return sums.covariance(problem.points)


def _equations(problem: JointProblem, at: Unknowns, weight: FloatArray) -> Iterator[Equations]:
    """Yield the whitened equations of the images, camera by camera; residuals are minus r."""
    images = problem.images
    by_shared, by_own = _point_derivatives(problem, at)
    by_place = _turns(problem, at)
    seen = _in_cameras(problem, at)
    for c in (0, 1):
        own = np.flatnonzero(images.camera == c)
        if not len(own):
            continue
        view = project_points(problem.camera_at(at.shared, c), seen[own].reshape(-1, 3))
        shape = (len(own), -1, 2)
        used = weight[own] > 0
        off = np.where(used[..., None], view.pixels.reshape(shape) - images.pixels[own], 0.0)
        root = np.sqrt(np.where(used, weight[own], 0.0))[..., None]
        by_point = view.by_point.reshape(*off.shape, 3) * root[..., None]
        shared = by_point @ by_shared[own]
        if problem.free[c]:
            lens = view.by_intrinsics.reshape(*off.shape, -1) * root[..., None]
            shared[..., problem.at_lens(c)] = lens
        yield Equations(
            images.view[own],
            off * root,
            shared,
            by_point @ by_own[own],
            by_point @ by_place[own][:, None],
        )


def _add(sums: ViewNormals, found: Equations) -> None:
    """Add the equations of images to those of their views."""
    rows = found.off.shape[1] * found.off.shape[2]
    r = found.off.reshape(len(found.off), rows, 1)
    a, b = (v.reshape(len(r), rows, -1) for v in (found.by_shared, found.by_pose))
    at, bt = a.swapaxes(-1, -2), b.swapaxes(-1, -2)
    np.add.at(sums.shared, found.view, at @ a)
    np.add.at(sums.mixed, found.view, at @ b)
    np.add.at(sums.own, found.view, bt @ b)
    np.add.at(sums.shared_gradient, found.view, (at @ r)[..., 0])
    np.add.at(sums.own_gradient, found.view, (bt @ r)[..., 0])


def _turns(problem: JointProblem, at: Unknowns) -> FloatArray:
    """Return the rotation camera from board of each image, shape (i, 3, 3)."""
    turns = np.stack([rotation(pose[:3]) for pose in at.own])[problem.images.view]
    pair = problem.images.in_pair
    turns[pair] = rotation(-at.shared[problem.at_pose][:3]) @ turns[pair]
    return turns


def _in_cameras(problem: JointProblem, at: Unknowns) -> FloatArray:
    """Return the board's corners in the frame of each image's camera, mm, (i, corners, 3)."""
    images, board = problem.images, problem.board_at(at.shared)
    turns = np.stack([rotation(pose[:3]) for pose in at.own])
    placed = (board @ turns.swapaxes(-1, -2) + at.own[:, None, 3:])[images.view]
    pose_12 = at.shared[problem.at_pose]
    back = rotation(-pose_12[:3])
    pair = images.in_pair
    placed[pair] = (placed[pair] - pose_12[3:]) @ back.T
    return placed


def _point_derivatives(problem: JointProblem, at: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Return d(corner in the camera)/d(shared), (i, corners, 3, n), and /d(own), (..., 3, 6).

    The columns of the intrinsics are 0.
    """
    images, board = problem.images, problem.board_at(at.shared)
    turns, slopes = zip(*(_turn(pose[:3]) for pose in at.own), strict=True)
    turn = np.stack(turns)
    by_own = np.zeros((images.views, len(board), 3, POSE))
    by_own[..., :3] = np.einsum("vjab,nb->vnaj", np.stack(slopes), board)
    by_own[..., 3:] = np.eye(3)
    flat = problem.points * np.array([1.0, 1.0, 0.0])
    warp = np.stack([deformed(flat, b)[:, 2] for b in ((1.0, 0.0), (0.0, 1.0))], axis=-1)
    by_warp = turn[:, None, :, 2, None] * warp[None, :, None, :]
    by_own, by_warp = by_own[images.view], by_warp[images.view]
    by_shared = np.zeros((len(images.view), len(board), 3, problem.size))
    pose_12, pair = at.shared[problem.at_pose], images.in_pair
    back, slope = _turn(-pose_12[:3])
    placed = (board @ turn.swapaxes(-1, -2) + at.own[:, None, 3:])[images.view[pair]]
    arm = placed - pose_12[3:]
    pose = problem.at_pose
    by_turn, by_shift = np.zeros((*by_shared.shape[:3], 3)), np.zeros((*by_shared.shape[:3], 3))
    by_turn[pair] = -np.einsum("jab,vnb->vnaj", slope, arm)
    by_shift[pair] = -back
    by_shared[..., pose[:3]], by_shared[..., pose[3:]] = by_turn, by_shift
    by_own[pair] = back @ by_own[pair]
    by_warp[pair] = back @ by_warp[pair]
    by_shared[..., problem.at_warp] = by_warp
    return by_shared, by_own


def _turn(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return R(r) and its derivative by r, shape (3, 3, 3), the component of r first."""
    turn, slope = cv2.Rodrigues(np.asarray(vector, dtype=np.float64))
    return turn, slope.reshape(3, 3, 3)
