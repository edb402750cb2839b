"""The normal equations of the adjustment, view by view, with analytic derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera, intrinsic_vector, project_points
from calib.geometry.poses import rotation
from calib.images.adjustment.mounting import RIG, Turned, seen, seen_by_rig, seen_by_turn, turned
from calib.images.adjustment.problem import POSE, AdjustmentProblem, BoardPictures
from calib.images.board_errors import BoardSums, Equations
from calib.images.bundle import deformed, finite
from calib.images.joint.reduced import Unknowns, ViewNormals

CHUNK = 64
"""Pictures whose derivatives are held at once: 2,000 pictures then take no more memory than 64."""


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
    warp: FloatArray
    turns: FloatArray
    slopes: FloatArray
    shifts: FloatArray
    rig: FloatArray
    errors: FloatArray


def evaluate(problem: AdjustmentProblem, at: Unknowns, weight: FloatArray) -> Evaluation:
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
        found = _equations(problem, state, chunk, weight)
        residuals[chunk.images] = found.residuals
        cost += _add_pictures(problem, chunk, found, sums, readings)
    cost += _add_known(problem, at, sums)
    return Evaluation(sums._replace(cost=cost), residuals, _joined(readings, n))


def board_covariance(
    problem: AdjustmentProblem, at: Unknowns, weight: FloatArray, known: FloatArray
) -> FloatArray:
    """Return what errors of the board add to the covariance of the shared unknowns, (n, n).

    At the minimum; `weight` as in `evaluate`, `known` the information beforehand, (n, n). See
    `calib.images.board_errors`. Of a picture with a reading of its own, what the error of the
    reading imitates is taken out of the derivatives by all other unknowns.
    """
    pictures = problem.pictures
    sums = BoardSums(pictures.views, len(problem.points), problem.size)
    state = _state(problem, at)
    for chunk in _chunks(pictures):
        found = _equations(problem, state, chunk, weight)
        rows = found.rows.copy()
        by = found.by_reading
        size = (by**2).sum(axis=1, keepdims=True)
        rows[..., -1:] -= by * found.errors[:, None, None]
        part = (1 - 1 / np.sqrt(1 + size)) / np.where(size > 0, size, 1.0)
        rows -= part * by * (by.swapaxes(-1, -2) @ rows)
        shape = (len(rows), -1, 2)
        by_shared = np.zeros((*rows.shape[:2], problem.size))
        by_shared[..., found.place] = rows[..., : len(found.place)]
        sums.add(
            Equations(
                pictures.view[chunk.images],
                rows[..., -1].reshape(shape),
                by_shared.reshape(*found.by_place.shape[:3], problem.size),
                rows[..., len(found.place) : -1].reshape(*found.by_place.shape[:3], POSE),
                found.by_place,
            )
        )
    sums.add_known(known)
    return sums.covariance(problem.points)


def _chunks(pictures: BoardPictures) -> Iterator[_Chunk]:
    for camera in (0, 1):
        for turning in (False, True):
            own = (pictures.camera == camera) & ((pictures.exposure >= 0) == turning)
            images = np.flatnonzero(own)
            for first in range(0, len(images), CHUNK):
                yield _Chunk(images[first : first + CHUNK], camera, turning)


def _state(problem: AdjustmentProblem, at: Unknowns) -> _State:
    x, poses = at.shared, at.own[:-1]
    turns, slopes = np.empty((len(poses), 3, 3)), np.empty((len(poses), 3, 3, 3))
    for v, pose in enumerate(poses):
        turns[v], slope = cv2.Rodrigues(pose[:3])
        slopes[v] = slope.reshape(3, 3, 3)
    flat = problem.points * np.array([1.0, 1.0, 0.0])
    warp = np.stack([deformed(flat, b)[:, 2] for b in ((1.0, 0.0), (0.0, 1.0))], axis=-1)
    return _State(
        cameras=(problem.camera_at(x, 0), problem.camera_at(x, 1)),
        board=problem.board_at(x),
        warp=warp,
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


class _Equations(NamedTuple):
    """Whitened equations of m pictures, 0 where a corner is not used.

    Parameters
    ----------
    place
        Places of the k shared unknowns that they show.
    rows
        Derivatives by these and by the pose, and minus the residual, (m, 2 corners, k + 7).
    by_place
        Derivatives by a corner's place on the board, 1/mm, (m, corners, 2, 3).
    by_reading
        Derivative by the error of the picture's own reading, (m, 2 corners, 1); 0 without.
    errors
        That error, in standard deviations, shape (m,).
    alone
        Whether it has one, shape (m,).
    residuals
        Observed minus projected, px, shape (m, corners, 2).
    """

    place: IntArray
    rows: FloatArray
    by_place: FloatArray
    by_reading: FloatArray
    errors: FloatArray
    alone: BoolArray
    residuals: FloatArray


def _equations(
    problem: AdjustmentProblem, state: _State, chunk: _Chunk, weight: FloatArray
) -> _Equations:
    """Return the equations of some pictures."""
    pictures, images = problem.pictures, chunk.images
    views = pictures.view[images]
    placed, turn = _placed(state, views), state.turns[views]
    observed = pictures.pixels[images]
    used = (weight[images] > 0) & finite(observed)
    root = np.sqrt(np.where(used, weight[images], 0.0))[..., None]
    by_own = np.zeros((*placed.shape, POSE))
    by_own[..., :3] = np.einsum("vjab,nb->vnaj", state.slopes[views], state.board)
    by_own[..., 3:] = np.eye(3)
    alone, errors = np.zeros(len(images), dtype=np.bool_), np.zeros(len(images))
    by_turn = np.zeros((*placed.shape, 1))
    by_rig: list[FloatArray] = []
    columns = [problem.at_warp]
    if chunk.turning:
        exposure, alone = pictures.exposure[images], pictures.own[images]
        stated, held = pictures.readings_rad[exposure], state.errors[exposure]
        c2 = turned(state.rig, stated, held)
        errors = _reading_errors(problem, state, c2, placed, observed, root, alone)
        c2 = turned(state.rig, stated, held + problem.reading_std_rad * errors)
        by_turn = problem.reading_std_rad * seen_by_turn(c2, placed)[..., None]
        shared = exposure[:, None] == pictures.shared[None, :]
        own = [RIG.index(name) for name in problem.names]
        by_rig = [seen_by_rig(c2, placed)[..., own], by_turn * shared[:, None, None, :]]
        columns += [problem.at_rig, problem.at_held]
        by_own, turn = c2.back[:, None] @ by_own, c2.back @ turn
        placed = seen(c2, placed)
    by_warp = turn[:, None, :, 2, None] * state.warp[None, :, None, :]
    view = project_points(state.cameras[chunk.camera], placed.reshape(-1, 3))
    shape = observed.shape
    residuals = observed - view.pixels.reshape(shape)
    by_point = view.by_point.reshape(*shape, 3) * root[..., None]
    off = np.where(used[..., None], -residuals, 0.0) * root
    parts = [by_point @ np.concatenate([by_warp, *by_rig, by_own], axis=-1), off[..., None]]
    if problem.free[chunk.camera]:
        parts.insert(0, view.by_intrinsics.reshape(*shape, -1) * root[..., None])
        columns.insert(0, problem.at_lens(chunk.camera))
    place = np.concatenate(columns)
    return _Equations(
        place=place,
        rows=np.concatenate(parts, axis=-1).reshape(len(images), -1, len(place) + POSE + 1),
        by_place=by_point @ turn[:, None],
        by_reading=(by_point @ by_turn).reshape(len(images), -1, 1) * alone[:, None, None],
        errors=errors,
        alone=alone,
        residuals=residuals,
    )


def _add_pictures(
    problem: AdjustmentProblem,
    chunk: _Chunk,
    found: _Equations,
    sums: ViewNormals,
    readings: list[Readings],
) -> float:
    """Add the equations of some pictures to those of their views; return their cost."""
    rows, place, alone = found.rows, found.place, found.alone
    total = rows.swapaxes(-1, -2) @ rows
    if alone.any():
        mixed = (rows.swapaxes(-1, -2) @ found.by_reading)[..., 0]
        mixed[:, -1] += found.errors
        total[:, -1, -1] += found.errors**2
        information = 1 + (found.by_reading[..., 0] ** 2).sum(axis=1)
        total -= mixed[:, :, None] * mixed[:, None, :] / information[:, None, None]
        by = np.zeros((len(rows), problem.size))
        by[:, place] = -mixed[:, : len(place)] / information[:, None]
        pose = -mixed[:, len(place) : -1] / information[:, None]
        readings.append(
            Readings(
                chunk.images[alone],
                found.errors[alone],
                1 / information[alone],
                by[alone],
                pose[alone],
            )
        )
    _scatter(sums, problem.pictures.view[chunk.images], place, total)
    return float(total[:, -1, -1].sum())


def _reading_errors(
    problem: AdjustmentProblem,
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


def _add_known(problem: AdjustmentProblem, at: Unknowns, sums: ViewNormals) -> float:
    """Add what is known of rig, readings and lenses beforehand, as the last view."""
    mean, std = np.array(problem.prior).reshape(-1, 2).T
    held = len(problem.at_held)
    mean = np.concatenate([mean, np.zeros(held)])
    weight = np.concatenate([1 / std**2, np.ones(held)])
    place = np.concatenate([problem.at_rig, problem.at_held])
    off = at.shared[place] - mean
    sums.shared[-1, place, place] += weight
    sums.shared_gradient[-1, place] += weight * off
    cost = float(weight @ off**2)
    for c in (0, 1):
        lens = problem.at_lens(c)
        if len(lens):
            off = at.shared[lens] - intrinsic_vector(problem.cameras[c])
            pull = problem.lens_information[c] @ off
            sums.shared[-1][np.ix_(lens, lens)] += problem.lens_information[c]
            sums.shared_gradient[-1, lens] += pull
            cost += float(off @ pull)
    return cost


def _joined(readings: list[Readings], n: int) -> Readings:
    if not readings:
        none = np.zeros(0)
        return Readings(none.astype(np.int64), none, none, np.zeros((0, n)), np.zeros((0, POSE)))
    return Readings(*(np.concatenate(parts) for parts in zip(*readings, strict=True)))


def camera_poses(problem: AdjustmentProblem, at: Unknowns, errors: FloatArray) -> FloatArray:
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
