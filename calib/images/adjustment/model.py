"""All pictures of the board as one least-squares problem, with derivatives.

Shared unknowns, in this order: intrinsics of C1 and of C2, each where it is not given; the bow of
the board along x and along y; the free ones of the rig (`mounting.RIG`); the errors of readings at
which several pictures were taken, in standard deviations. Own unknowns of a view: the pose of the
board, in C1, or in C2 where C2 sees it alone at no reading. The error of a reading at which one
picture was taken is eliminated in that picture; what is known beforehand is a view of its own, the
last.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera, camera_from_vector, intrinsic_vector
from calib.geometry.poses import rotation
from calib.images.adjustment.mounting import RIG, Turned, seen, seen_by_rig, seen_by_turn, turned
from calib.images.bundle import deformed, finite, project_points
from calib.images.joint.reduced import Unknowns, ViewNormals

POSE = 6
BOW = 2

CHUNK = 64
"""Pictures whose derivatives are held at once: 2,000 pictures then take no more memory than 64."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of one board, i of them, by view of the board, v of them.

    Parameters
    ----------
    names
        Of the pictures.
    kinds
        What each was taken for: "lens", "pair", "row" or "sweep".
    camera
        0 for C1, 1 for C2, shape (i,).
    view
        Which view each shows, shape (i,).
    exposure
        At which of the e readings C2 took it, shape (i,); -1 for C1, and for pictures of C2 at a
        reading that does not matter.
    pixels
        Corners found, px, shape (i, corners, 2); NaN where not.
    readings_rad
        Of the encoder, shape (e,).
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    camera: IntArray
    view: IntArray
    exposure: IntArray
    pixels: FloatArray
    readings_rad: FloatArray

    @property
    def views(self) -> int:
        """Number of views, v."""
        return int(self.view.max()) + 1

    @property
    def shared(self) -> IntArray:
        """Readings at which several pictures were taken."""
        taken = np.bincount(self.exposure[self.exposure >= 0], minlength=len(self.readings_rad))
        return np.flatnonzero(taken > 1)

    @property
    def own(self) -> BoolArray:
        """Which pictures were taken at a reading of their own, shape (i,)."""
        return (self.exposure >= 0) & ~np.isin(self.exposure, self.shared)


@dataclass(frozen=True)
class Problem:
    """The problem.

    Parameters
    ----------
    pictures
        What was observed.
    points
        Corners in the board's frame, mm, shape (corners, 3).
    cameras
        C1 and C2 to start from.
    free
        Whether the intrinsics of each are unknowns.
    names
        Free unknowns of the rig, in the order of `RIG`; the others are 0.
    prior
        Mean and standard deviation of each; an infinite one for none.
    reading_std_rad
        Standard deviation of the error of a reading, rad.
    """

    pictures: Pictures
    points: FloatArray
    cameras: tuple[Camera, Camera]
    free: tuple[bool, bool]
    names: tuple[str, ...]
    prior: tuple[tuple[float, float], ...]
    reading_std_rad: float

    @property
    def images(self) -> Pictures:
        """The pictures, as `calib.images.joint` calls them."""
        return self.pictures

    def at_lens(self, camera: int) -> IntArray:
        """Places of the intrinsics of a camera among the shared unknowns; none if it is given."""
        counts = [
            4 + len(c.distortion) if f else 0 for c, f in zip(self.cameras, self.free, strict=True)
        ]
        first = counts[0] if camera else 0
        return np.arange(first, first + counts[camera])

    @property
    def at_bow(self) -> IntArray:
        """Places of the board's bow, shape (2,)."""
        first = len(self.at_lens(0)) + len(self.at_lens(1))
        return np.arange(first, first + BOW)

    @property
    def at_rig(self) -> IntArray:
        """Places of the free unknowns of the rig."""
        first = int(self.at_bow[-1]) + 1
        return np.arange(first, first + len(self.names))

    @property
    def at_held(self) -> IntArray:
        """Places of the errors of shared readings."""
        first = int(self.at_bow[-1]) + 1 + len(self.names)
        return np.arange(first, first + len(self.pictures.shared))

    @property
    def size(self) -> int:
        """Number of shared unknowns."""
        return int(self.at_bow[-1]) + 1 + len(self.names) + len(self.pictures.shared)

    def start(self, rig: FloatArray, bow: FloatArray, poses: FloatArray) -> Unknowns:
        """Return the unknowns of the cameras given, a rig, a board and these poses, (v, 6)."""
        lenses = [intrinsic_vector(c) for c, f in zip(self.cameras, self.free, strict=True) if f]
        own = [RIG.index(name) for name in self.names]
        held = np.zeros(len(self.pictures.shared))
        return Unknowns(
            np.concatenate([*lenses, bow, rig[own], held]), np.vstack([poses, np.zeros(POSE)])
        )

    def camera_at(self, x: FloatArray, camera: int) -> Camera:
        """Return a camera with the intrinsics of shared unknowns."""
        if not self.free[camera]:
            return self.cameras[camera]
        return camera_from_vector(x[self.at_lens(camera)], self.cameras[camera].image_size)

    def board_at(self, x: FloatArray) -> FloatArray:
        """Return the board's corners, mm, shape (corners, 3)."""
        a, b = (float(v) for v in x[self.at_bow])
        return deformed(self.points, (a, b))

    def rig_at(self, x: FloatArray) -> FloatArray:
        """Return all unknowns of the rig, shape (13,)."""
        rig = np.zeros(len(RIG))
        rig[[RIG.index(name) for name in self.names]] = x[self.at_rig]
        return rig

    def held_at(self, x: FloatArray) -> FloatArray:
        """Return the errors of readings, rad, shape (e,); 0 for those of one picture."""
        errors = np.zeros(len(self.pictures.readings_rad))
        errors[self.pictures.shared] = self.reading_std_rad * x[self.at_held]
        return errors


class Readings(NamedTuple):
    """Errors of readings of one picture each, in standard deviations, r of them.

    Parameters
    ----------
    image
        The pictures, shape (r,).
    value
        Shape (r,).
    conditional
        Their variance where all else is known, shape (r,).
    by_shared, by_own
        Their derivatives by the shared unknowns, (r, n), and the pose, (r, 6).
    """

    image: IntArray
    value: FloatArray
    conditional: FloatArray
    by_shared: FloatArray
    by_own: FloatArray


class Evaluation(NamedTuple):
    """The problem at some unknowns.

    Parameters
    ----------
    normals
        Normal equations of the views and, last, of what is known beforehand.
    residuals
        Observed minus projected, px, shape (i, corners, 2); NaN where not found.
    readings
        Errors of readings.
    """

    normals: ViewNormals
    residuals: FloatArray
    readings: Readings


class _Chunk(NamedTuple):
    """Some pictures of one camera, all or none of them taken at readings."""

    images: IntArray
    camera: int
    turning: bool


class _State(NamedTuple):
    """Unknowns as pictures need them."""

    cameras: tuple[Camera, Camera]
    board: FloatArray
    bow: FloatArray
    turns: FloatArray
    slopes: FloatArray
    shifts: FloatArray
    rig: FloatArray
    errors: FloatArray


def evaluate(problem: Problem, at: Unknowns, weight: FloatArray) -> Evaluation:
    """Return the problem at unknowns.

    Parameters
    ----------
    weight
        Of each corner, 1/px^2, shape (i, corners); 0 leaves it out.
    """
    pictures, n = problem.pictures, problem.size
    count = pictures.views + 1
    sums = ViewNormals(
        np.zeros((count, n, n)),
        np.zeros((count, n, POSE)),
        np.zeros((count, POSE, POSE)),
        np.zeros((count, n)),
        np.zeros((count, POSE)),
        0.0,
    )
    state, cost = _state(problem, at), 0.0
    residuals = np.full(pictures.pixels.shape, np.nan)
    readings: list[Readings] = []
    for chunk in _chunks(pictures):
        cost += _add_pictures(problem, state, chunk, weight, sums, residuals, readings)
    cost += _add_known(problem, at, sums)
    return Evaluation(sums._replace(cost=cost), residuals, _joined(readings, n))


def _chunks(pictures: Pictures) -> Iterator[_Chunk]:
    for camera in (0, 1):
        for turning in (False, True):
            own = (pictures.camera == camera) & ((pictures.exposure >= 0) == turning)
            images = np.flatnonzero(own)
            for first in range(0, len(images), CHUNK):
                yield _Chunk(images[first : first + CHUNK], camera, turning)


def _state(problem: Problem, at: Unknowns) -> _State:
    x, poses = at.shared, at.own[:-1]
    turns, slopes = np.empty((len(poses), 3, 3)), np.empty((len(poses), 3, 3, 3))
    for v, pose in enumerate(poses):
        turns[v], slope = cv2.Rodrigues(pose[:3])
        slopes[v] = slope.reshape(3, 3, 3)
    flat = problem.points * np.array([1.0, 1.0, 0.0])
    bow = np.stack([deformed(flat, b)[:, 2] for b in ((1.0, 0.0), (0.0, 1.0))], axis=-1)
    return _State(
        cameras=(problem.camera_at(x, 0), problem.camera_at(x, 1)),
        board=problem.board_at(x),
        bow=bow,
        turns=turns,
        slopes=slopes,
        shifts=poses[:, 3:],
        rig=problem.rig_at(x),
        errors=problem.held_at(x),
    )


def _placed(state: _State, views: IntArray) -> FloatArray:
    """Return the board in the frames of views, mm, shape (m, corners, 3)."""
    placed: FloatArray = (
        state.board @ state.turns[views].swapaxes(-1, -2) + state.shifts[views][:, None]
    )
    return placed


def _add_pictures(
    problem: Problem,
    state: _State,
    chunk: _Chunk,
    weight: FloatArray,
    sums: ViewNormals,
    residuals: FloatArray,
    readings: list[Readings],
) -> float:
    """Add the equations of some pictures to those of their views; return their cost."""
    pictures, images = problem.pictures, chunk.images
    views = pictures.view[images]
    placed = _placed(state, views)
    observed = pictures.pixels[images]
    used = (weight[images] > 0) & finite(observed)
    root = np.sqrt(np.where(used, weight[images], 0.0))[..., None]
    by_own = np.zeros((*placed.shape, POSE))
    by_own[..., :3] = np.einsum("vjab,nb->vnaj", state.slopes[views], state.board)
    by_own[..., 3:] = np.eye(3)
    by_bow = state.turns[views][:, None, :, 2, None] * state.bow[None, :, None, :]
    by_shared = [by_bow]
    columns = [problem.at_bow]
    alone = pictures.own[images] if chunk.turning else np.zeros(len(images), dtype=np.bool_)
    error = np.zeros(len(images))
    by_turn = None
    if chunk.turning:
        exposure = pictures.exposure[images]
        stated = pictures.readings_rad[exposure]
        held = state.errors[exposure]
        c2 = turned(state.rig, stated, held)
        error = _reading_errors(problem, state, c2, placed, observed, root, alone)
        c2 = turned(state.rig, stated, held + problem.reading_std_rad * error)
        by_turn = problem.reading_std_rad * seen_by_turn(c2, placed)
        own = [RIG.index(name) for name in problem.names]
        shared = exposure[:, None] == pictures.shared[None, :]
        by_shared = [
            c2.back[:, None] @ by_bow,
            seen_by_rig(c2, placed)[..., own],
            by_turn[..., None] * shared[:, None, None, :],
        ]
        columns += [problem.at_rig, problem.at_held]
        by_own = c2.back[:, None] @ by_own
        placed = seen(c2, placed)
    view = project_points(state.cameras[chunk.camera], placed.reshape(-1, 3))
    shape = (*placed.shape[:2], 2)
    residuals[images] = observed - view.pixels.reshape(shape)
    by_point = view.by_point.reshape(*shape, 3) * root[..., None]
    off = np.where(used[..., None], -residuals[images], 0.0) * root
    parts = [by_point @ np.concatenate([*by_shared, by_own], axis=-1), off[..., None]]
    if problem.free[chunk.camera]:
        parts.insert(0, view.by_intrinsics.reshape(*shape, -1) * root[..., None])
        columns.insert(0, problem.at_lens(chunk.camera))
    place = np.concatenate(columns)
    rows = np.concatenate(parts, axis=-1).reshape(len(images), -1, len(place) + POSE + 1)
    total = rows.swapaxes(-1, -2) @ rows
    if by_turn is not None and alone.any():
        own_turn = (by_point @ by_turn[..., None]).reshape(len(images), -1, 1) * alone[:, None, None]
        mixed = (rows.swapaxes(-1, -2) @ own_turn)[..., 0]
        mixed[:, -1] += error
        total[:, -1, -1] += error**2
        information = 1 + (own_turn[..., 0] ** 2).sum(axis=1)
        total -= mixed[:, :, None] * mixed[:, None, :] / information[:, None, None]
        by = np.zeros((len(images), problem.size))
        by[:, place] = -mixed[:, : len(place)] / information[:, None]
        pose = -mixed[:, len(place) : -1] / information[:, None]
        readings.append(
            Readings(images[alone], error[alone], 1 / information[alone], by[alone], pose[alone])
        )
    _scatter(sums, views, place, total)
    return float(total[:, -1, -1].sum())


def _reading_errors(
    problem: Problem,
    state: _State,
    c2: Turned,
    placed: FloatArray,
    observed: FloatArray,
    root: FloatArray,
    alone: BoolArray,
) -> FloatArray:
    """Return the most probable errors of readings of one picture, in standard deviations, (m,)."""
    if not alone.any():
        return np.zeros(len(alone))
    view = project_points(state.cameras[1], seen(c2, placed).reshape(-1, 3))
    off = np.where(root > 0, view.pixels.reshape(observed.shape) - observed, 0.0) * root
    turn = problem.reading_std_rad * seen_by_turn(c2, placed)
    by = (view.by_point.reshape(*observed.shape, 3) @ turn[..., None])[..., 0] * root
    error = -(by * off).sum(axis=(1, 2)) / (1 + (by**2).sum(axis=(1, 2)))
    return np.where(alone, error, 0.0)


def _scatter(sums: ViewNormals, views: IntArray, place: IntArray, total: FloatArray) -> None:
    """Add the equations of pictures, shape (m, c, c), to those of their views."""
    k = len(place)
    own = slice(k, k + POSE)
    at = views[:, None, None]
    np.add.at(sums.shared, (at, place[:, None], place), total[:, :k, :k])
    np.add.at(sums.mixed, (at, place[:, None], np.arange(POSE)), total[:, :k, own])
    np.add.at(sums.own, views, total[:, own, own])
    np.add.at(sums.shared_gradient, (views[:, None], place), total[:, :k, -1])
    np.add.at(sums.own_gradient, views, total[:, own, -1])


def _add_known(problem: Problem, at: Unknowns, sums: ViewNormals) -> float:
    """Add what is known of rig and shared readings beforehand, as the last view."""
    mean, std = np.array(problem.prior).reshape(-1, 2).T
    held = len(problem.at_held)
    mean = np.concatenate([mean, np.zeros(held)])
    weight = np.concatenate([1 / std**2, np.ones(held)])
    place = np.concatenate([problem.at_rig, problem.at_held])
    off = at.shared[place] - mean
    sums.shared[-1, place, place] += weight
    sums.shared_gradient[-1, place] += weight * off
    return float(weight @ off**2)


def _joined(readings: list[Readings], n: int) -> Readings:
    if not readings:
        none = np.zeros(0)
        return Readings(none.astype(np.int64), none, none, np.zeros((0, n)), np.zeros((0, POSE)))
    return Readings(*(np.concatenate(parts) for parts in zip(*readings, strict=True)))


def camera_poses(problem: Problem, at: Unknowns, errors: FloatArray) -> FloatArray:
    """Return board poses of pictures, rad and mm, in the camera that took each, shape (i, 6).

    Parameters
    ----------
    errors
        Of all readings, rad, shape (e,).
    """
    pictures = problem.pictures
    poses = at.own[pictures.view].copy()
    rig = problem.rig_at(at.shared)
    for i in np.flatnonzero(pictures.exposure >= 0):
        e = pictures.exposure[i]
        c2 = turned(rig, pictures.readings_rad[[e]], errors[[e]])
        turn = c2.back[0] @ rotation(poses[i, :3])
        poses[i, 3:] = seen(c2, poses[i, None, None, 3:])[0, 0]
        poses[i, :3] = cv2.Rodrigues(turn)[0].ravel()
    return poses
