"""Whether a lens stayed what it was in all its images.

To the joint solve one unknown more is added in thought: a relative change of a camera's focal
length that grows with some covariate x of the views, f (1 + beta x). Its estimate follows from the
views' normal equations at the minimum (a score test, Rao 1948): with a the direction of the focal
length among the shared unknowns, N_v and s_v a view's normal matrix and gradient, C the inverse of
the sum of N_v,

    beta = -sum x s_v'a / (sum x^2 a'N_v a - b'C b),     b = sum x N_v a.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.poses import transform
from calib.images.bundle import finite
from calib.images.joint.reduced import dispersion
from calib.images.joint.solve import JointSolve

MIN_IMAGES = 4
"""Images of a kind below which it is not compared with the others."""


@dataclass(frozen=True)
class FocalChange:
    """A relative change of focal length between images of one camera.

    Parameters
    ----------
    camera
        "c1" or "c2".
    between
        What the images differ in: a kind of images ("pair", "row"), or "distance".
    change, std
        Relative change, and its standard uncertainty; over the distances that occur, from the
        farthest board to the nearest.
    """

    camera: str
    between: str
    change: float
    std: float


def focal_changes(joint: JointSolve) -> tuple[FocalChange, ...]:
    """Return the changes that the images allow to be estimated, cameras that are given left out."""
    images = joint.problem.images
    kinds = np.array(images.kinds)
    used = finite(joint.residuals).any(axis=-1)
    found = []
    for c in (0, 1):
        own = (images.camera == c) & used
        if not joint.problem.free[c] or not own.any():
            continue
        for kind in ("pair", "row"):
            chosen = own & (kinds == kind)
            others = int(own.sum() - chosen.sum())
            if min(int(chosen.sum()), others) >= MIN_IMAGES:
                found += _change(joint, c, _by_view(joint, chosen, np.ones(len(own))), kind)
        near = 1 / _distances(joint)[images.view]
        span = float(np.ptp(near[own]))
        if span > 0:
            x = (near - near[own].mean()) / span
            found += _change(joint, c, _by_view(joint, own, x), "distance")
    return tuple(found)


def _distances(joint: JointSolve) -> FloatArray:
    """Return how far the middle of the board is from its camera, mm, in each view."""
    middle = joint.problem.points.mean(axis=0, keepdims=True)
    return np.array([float(np.linalg.norm(transform(pose, middle))) for pose in joint.poses])


def _by_view(joint: JointSolve, chosen: BoolArray, x: FloatArray) -> FloatArray:
    """Return x, one an image, by view; 0 where the camera has no chosen image."""
    images = joint.problem.images
    values = np.zeros(images.views)
    values[images.view[chosen]] = x[chosen]
    return values


def _change(joint: JointSolve, camera: int, x: FloatArray, between: str) -> list[FocalChange]:
    """Return the change with covariate x of each view; none where nothing tells it."""
    reduced = joint.reduced
    direction = np.zeros(joint.problem.size)
    direction[joint.problem.at_lens(camera)[:2]] = reduced.at.shared[
        joint.problem.at_lens(camera)[:2]
    ]
    along = reduced.normals @ direction
    mixed = x @ along
    plain = float(np.sum(x**2 * (along @ direction)))
    information = plain - float(mixed @ reduced.spread() @ mixed)
    if information <= 1e-9 * plain or plain == 0:
        return []
    beta = -float(x @ (reduced.scores @ direction)) / information
    # The views contradict each other by this change, too: the factor is that which is left of it.
    moved = beta * (x[:, None] * direction - reduced.spread() @ mixed)
    scores = reduced.scores + np.einsum("vij,vj->vi", reduced.normals, moved)
    at = joint.problem.at_lens(camera)
    factor = dispersion(replace(reduced, scores=scores), at, joint.clusters)
    std = float(np.sqrt(factor / information))
    return [FocalChange(f"c{camera + 1}", between, beta, std)]
