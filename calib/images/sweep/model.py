"""What C2 sees of a board at rest while it turns about its yaw axis.

The axis stands still in C2's own frame: a unit vector d, near +Y (down), and its foot f, the point
of the axis nearest to C2's centre (f . d = 0). Turned by phi from the reading of 90 degrees, C2
sees a point of the world turned back,

    P(phi) = R(-phi d) (P(0) - f) + f.

phi counts from -X towards +Z, as the encoder does: at 90 degrees C2 looks along Z, and 90 degrees
later along X. With Y down that is a right-handed turn about +Y.

The true turn is that of `calib.geometry.plane.gaze_angle`: the reading about 90 degrees, the
encoder's terms, and an error of each reading (its quantisation, mostly). A constant zero error
cannot be told from a turn of the boards and is left to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.geometry.camera import Camera, intrinsic_vector, project_points, with_intrinsics
from calib.geometry.parameters import ENCODER_CENTRE_RAD, PARAMETERS, EncoderTerm, Parameter
from calib.geometry.poses import rotated_by_vector, rotation, transform, transformed_by_pose
from calib.images.bundle import Block, finite

ENCODER: tuple[tuple[Parameter, EncoderTerm], ...] = tuple(
    (parameter, parameter.effect)
    for parameter in PARAMETERS
    if isinstance(parameter.effect, EncoderTerm) and parameter.name != "delta2_rad"
)
"""Errors of the encoder that a sweep can show, in the order of the unknowns."""

AXIS = 4
"""Unknowns of the axis: d_x, d_z (rad) and f_x, f_z (mm); d_y and f_y follow from them."""


@dataclass(frozen=True)
class SweepProblem:
    """A sweep as a least-squares problem.

    The unknowns are, in this order: the axis (`AXIS`); the encoder's terms (`ENCODER`); the errors
    of C2's intrinsics, in standard deviations along the columns of `intrinsics_root`; the pose of
    the board in C2 at 90 degrees, for each placement; the error of each reading, in standard
    deviations.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    pixels
        Corners found, px, shape (n, corners, 2); NaN where not.
    readings_rad
        Of the encoder, shape (n,).
    placement
        Which placement of the board each image shows, 0 to m - 1, shape (n,).
    camera
        C2 as the intrinsics stage found it.
    intrinsics_root
        A with A A' the covariance of C2's intrinsics, shape (p, r); r = 0 if nothing is stated.
    turn_std_rad
        Standard deviation of the error of a reading, rad.
    sigma_px
        Standard deviation of a corner coordinate, px.
    foot_std_mm
        Of the normal prior of f_x and f_z about 0.
    encoder_prior
        (mean, standard deviation) of each encoder term; an infinite one for no prior.
    """

    points: FloatArray
    pixels: FloatArray
    readings_rad: FloatArray
    placement: IntArray
    camera: Camera
    intrinsics_root: FloatArray
    turn_std_rad: float
    sigma_px: float
    foot_std_mm: float
    encoder_prior: tuple[tuple[float, float], ...]

    @property
    def placements(self) -> int:
        """Number of placements, m."""
        return int(self.placement.max()) + 1

    @property
    def at_intrinsics(self) -> IntArray:
        """Places of the errors of the intrinsics among the unknowns, shape (r,)."""
        return np.arange(self.intrinsics_root.shape[1], dtype=np.int64) + AXIS + len(ENCODER)

    def at_pose(self, placement: int) -> IntArray:
        """Places of a board pose among the unknowns, shape (6,)."""
        first = AXIS + len(ENCODER) + self.intrinsics_root.shape[1] + 6 * placement
        return np.arange(first, first + 6)

    @property
    def at_turns(self) -> IntArray:
        """Places of the errors of the readings among the unknowns, shape (n,); none if exact."""
        first = int(self.at_pose(self.placements)[0])
        return np.arange(first, first + (len(self.readings_rad) if self.turn_std_rad > 0 else 0))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.at_pose(self.placements)[0]) + len(self.at_turns)

    def flipped(self) -> SweepProblem:
        """Return the problem with the encoder counting the other way round."""
        return replace(self, readings_rad=2 * ENCODER_CENTRE_RAD - self.readings_rad)

    def camera_at(self, x: FloatArray) -> Camera:
        """Return C2 with the errors of its intrinsics put in."""
        intrinsics = intrinsic_vector(self.camera) + self.intrinsics_root @ x[self.at_intrinsics]
        return with_intrinsics(self.camera, intrinsics)

    def turns(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return true turns from 90 degrees, rad, shape (n,), and their derivative by `ENCODER`."""
        basis = np.stack([term.basis(self.readings_rad) for _, term in ENCODER], axis=-1)
        turns = self.readings_rad - ENCODER_CENTRE_RAD + basis @ x[AXIS : AXIS + len(ENCODER)]
        if len(self.at_turns):
            turns = turns + self.turn_std_rad * x[self.at_turns]
        return turns, basis


@dataclass(frozen=True)
class Axis:
    """The yaw axis in C2's frame.

    Parameters
    ----------
    direction
        Unit vector, shape (3,).
    foot
        Point of the axis nearest to C2's centre, mm, shape (3,).
    direction_by, foot_by
        Their derivatives by the unknowns d_x, d_z, f_x, f_z, shape (3, 4).
    """

    direction: FloatArray
    foot: FloatArray
    direction_by: FloatArray
    foot_by: FloatArray


def axis_of(x: FloatArray) -> Axis:
    """Return the axis of the unknowns d_x, d_z, f_x, f_z, which lead `x`."""
    dx, dz, fx, fz = x[:AXIS]
    dy = np.sqrt(max(1 - dx**2 - dz**2, 1e-6))  # an axis near Y; the bound keeps wild steps finite
    fy = -(fx * dx + fz * dz) / dy
    dy_by = np.array([-dx / dy, -dz / dy, 0.0, 0.0])
    fy_by = (-np.array([fx, fz, dx, dz]) - fy * dy_by) / dy
    unit = np.eye(4)
    return Axis(
        np.array([dx, dy, dz]),
        np.array([fx, fy, fz]),
        np.stack([unit[0], dy_by, unit[1]]),
        np.stack([unit[2], fy_by, unit[3]]),
    )


class _State(NamedTuple):
    """Unknowns in the form in which images need them."""

    x: FloatArray
    axis: Axis
    camera: Camera
    turns: FloatArray
    basis: FloatArray


def _state(problem: SweepProblem, x: FloatArray) -> _State:
    return _State(x, axis_of(x), problem.camera_at(x), *problem.turns(x))


def residuals_of(problem: SweepProblem, x: FloatArray) -> FloatArray:
    """Return observed minus projected, px, shape (n, corners, 2); NaN where not found."""
    state = _state(problem, x)
    axis = state.axis
    residuals = np.array(problem.pixels)
    for i, turn in enumerate(state.turns):
        rest = transform(x[problem.at_pose(int(problem.placement[i]))], problem.points)
        seen = (rest - axis.foot) @ rotation(-turn * axis.direction).T + axis.foot
        residuals[i] -= project_points(state.camera, seen).pixels
    return residuals


def blocks_of(problem: SweepProblem, x: FloatArray) -> list[Block]:
    """Return the whitened residuals, priors included, with their jacobians."""
    state = _state(problem, x)
    images = [_image_block(problem, state, i) for i in range(len(problem.readings_rad))]
    return [*_prior_blocks(problem, x), *images]


def image_clusters(problem: SweepProblem, x: FloatArray) -> list[tuple[Block, ...]]:
    """Return the blocks of each image, with what is known of its own reading."""
    state = _state(problem, x)
    clusters: list[tuple[Block, ...]] = []
    for i in range(len(problem.readings_rad)):
        own = problem.at_turns[i : i + 1]
        clusters.append((_image_block(problem, state, i), Block(x[own], np.eye(len(own)), own)))
    return clusters


def _image_block(problem: SweepProblem, state: _State, i: int) -> Block:
    """Return the block of one image."""
    axis, turn = state.axis, state.turns[i]
    at_pose = problem.at_pose(int(problem.placement[i]))
    pose = state.x[at_pose]
    vector = -turn * axis.direction
    back = rotation(vector)
    arm = transform(pose, problem.points) - axis.foot
    by_vector = rotated_by_vector(vector, arm)
    by_turn = -(by_vector @ axis.direction)[..., None]
    view = project_points(state.camera, arm @ back.T + axis.foot)
    by_point = view.by_point
    parts = [
        by_point @ (-turn * by_vector @ axis.direction_by + (np.eye(3) - back) @ axis.foot_by),
        by_point @ by_turn * state.basis[i],
        view.by_intrinsics @ problem.intrinsics_root,
        by_point @ (back @ transformed_by_pose(pose, problem.points)),
    ]
    columns = [np.arange(AXIS + len(ENCODER)), problem.at_intrinsics, at_pose]
    if len(problem.at_turns):
        parts.append(problem.turn_std_rad * by_point @ by_turn)
        columns.append(problem.at_turns[i : i + 1])
    jacobian = np.concatenate(parts, axis=-1) / problem.sigma_px
    used = finite(problem.pixels[i])
    residuals = (view.pixels - problem.pixels[i])[used] / problem.sigma_px
    return Block(
        residuals.ravel(),
        jacobian[used].reshape(residuals.size, jacobian.shape[-1]),
        np.concatenate(columns),
    )


def _prior_blocks(problem: SweepProblem, x: FloatArray) -> list[Block]:
    """Return what is known beforehand: foot, intrinsics, encoder terms, readings."""
    whitened = np.concatenate([problem.at_intrinsics, problem.at_turns])
    mean, std = np.array(problem.encoder_prior).T
    known = np.flatnonzero(np.isfinite(std))
    encoder = AXIS + known
    foot = np.array([2, 3])
    return [
        Block(x[foot] / problem.foot_std_mm, np.eye(2) / problem.foot_std_mm, foot),
        Block(x[whitened], np.eye(len(whitened)), whitened),
        Block((x[encoder] - mean[known]) / std[known], np.diag(1 / std[known]), encoder),
    ]
