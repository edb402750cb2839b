"""Whether cameras and rig stayed what they were: the crop of the pictures, the pose of C2 in C1.

As `calib.images.joint.changes`, with other unknowns added in thought: a shift of the principal
point in the pictures of one kind, and a pose of C2 that moves evenly over the pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from calib.core.arrays import FloatArray, IntArray
from calib.images.bundle import finite
from calib.images.joint.changes import MIN_IMAGES, Solved, estimate
from calib.images.joint.model import POSE
from calib.images.joint.solve import JointSolve

CHANCE = 1e-3
"""Share of runs that a limit fails by chance."""


@dataclass(frozen=True)
class CentreShift:
    """A shift of the principal point in pictures of one kind against the others.

    Parameters
    ----------
    camera, kind
        "c1" or "c2"; "pair" or "row".
    shift_px, std_px
        Along u and v, shape (2,), and standard uncertainties.
    chi2, limit
        Of two degrees of freedom, and what is exceeded in 1 of 1,000 runs by chance.
    focal_px
        Of the camera.
    """

    camera: str
    kind: str
    shift_px: FloatArray
    std_px: FloatArray
    chi2: float
    limit: float
    focal_px: float


@dataclass(frozen=True)
class PoseDrift:
    """How far the pose of C2 in C1 moved from the first pair to the last, by an even drift.

    Parameters
    ----------
    turn_rad, shift_mm
        Rotation and translation, shape (3,) each.
    std
        Standard uncertainties of the six.
    chi2, limit
        Of six degrees of freedom, and what is exceeded in 1 of 1,000 runs by chance.
    """

    turn_rad: FloatArray
    shift_mm: FloatArray
    std: FloatArray
    chi2: float
    limit: float


def centre_shifts(joint: Solved) -> tuple[CentreShift, ...]:
    """Return the shifts that the images tell of, cameras that are given left out."""
    images = joint.problem.pictured
    kinds = np.array(images.kinds)
    used = finite(joint.residuals).any(axis=-1)
    found = []
    for c in (0, 1):
        own = (images.camera == c) & used
        for kind in ("pair", "row"):
            chosen = own & (kinds == kind)
            fewest = min(int(chosen.sum()), int(own.sum() - chosen.sum()))
            if not joint.problem.free[c] or fewest < MIN_IMAGES:
                continue
            at = joint.problem.at_lens(c)
            way = np.zeros((2, *joint.reduced.scores.shape))
            for k in (0, 1):
                way[k, images.view[chosen], at[2 + k]] = 1.0
            told = estimate(joint, way, [at, at])
            if told is not None:
                found.append(
                    CentreShift(
                        camera=f"c{c + 1}",
                        kind=kind,
                        shift_px=told.beta,
                        std_px=told.std,
                        chi2=told.squares / float(told.factors[0]),
                        limit=chi2_limit(2, joint.clusters[images.view[own]]),
                        focal_px=float(joint.cameras[c].matrix[0, 0]),
                    )
                )
    return tuple(found)


def pose_drift(joint: JointSolve) -> PoseDrift | None:
    """Return the drift over the pairs in their order; None where they are too few to tell."""
    images, at = joint.problem.images, joint.problem.at_pose
    used = finite(joint.residuals).any(axis=-1)
    views = np.unique(images.view[images.in_pair & used])
    if len(views) < 2 * MIN_IMAGES:
        return None
    way = np.zeros((POSE, images.views, joint.problem.size))
    order = np.linspace(-0.5, 0.5, len(views))
    for k in range(POSE):
        way[k, views, at[k]] = order
    told = estimate(joint, way, [at] * POSE)
    if told is None:
        return None
    return PoseDrift(
        turn_rad=told.beta[:3],
        shift_mm=told.beta[3:],
        std=told.std,
        chi2=told.squares / float(told.factors[0]),
        limit=chi2_limit(POSE, joint.clusters[views]),
    )


def chi2_limit(count: int, clusters: IntArray) -> float:
    """Return the limit of chi squared of `count` unknowns, its factor from so few clusters (F)."""
    freedom = max(len(np.unique(clusters)) - 1 - count, 1)
    return float(count * fisher.isf(CHANCE, count, freedom))
