"""Whether the lenses stayed what they were in all their images.

To the joint solve unknowns are added in thought: a relative change of a camera's focal length that
grows with some covariate x of the views, f (1 + beta x): for each camera alone, and for both. Pairs
tie the cameras, so that two lenses that change alike look like two that do not, unless both may.
Estimates follow from the views' normal equations at the minimum (a score test, Rao 1948):
with a_k the direction of the focal length of camera k among the shared unknowns, N_v and s_v a
view's normal matrix and gradient, C the inverse of the sum of N_v,

    beta = -M^-1 g,    g_k = sum x_k s_v'a_k,
    M_kl = sum x_k x_l a_k'N_v a_l - b_k'C b_l,    b_k = sum x_k N_v a_k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera
from calib.images.bundle import finite
from calib.images.joint.allowance import along, board_distances
from calib.images.joint.reduced import Reduced, dispersion
from calib.images.joint.unknowns import LensesAndBoard

MIN_IMAGES = 4
"""Images of a kind below which it is not compared with the others."""

BOTH_GAIN = 10.8
"""Gain of chi squared above which both lenses change: 1 in 1,000 by chance."""

TOLD_LEAST = 1e-9
"""Share of the information that other unknowns leave, below which a change is not told."""


class Solved(Protocol):
    """A solve of many pictures at its minimum: that of lenses and pairs, or the adjustment."""

    @property
    def problem(self) -> LensesAndBoard:
        """Images and unknowns."""

    @property
    def reduced(self) -> Reduced:
        """The views' say."""

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """C1 and C2."""

    @property
    def residuals(self) -> FloatArray:
        """Observed minus projected, px, shape (i, corners, 2); NaN where missing or rejected."""

    @property
    def clusters(self) -> IntArray:
        """Cluster of each view that `reduced` has."""


@dataclass(frozen=True)
class FocalChange:
    """A relative change of focal length between images of one camera.

    Parameters
    ----------
    camera
        "c1" or "c2".
    between
        What the images differ in: a kind of images ("pair", "row"), or "distance".
    together
        Whether that of the other camera was estimated with it, as one alone does not explain it.
    change, std
        Relative change, and its standard uncertainty; over the distances that occur, from the
        farthest board to the nearest.
    """

    camera: str
    between: str
    change: float
    std: float
    together: bool = False


def focal_changes(joint: Solved) -> tuple[FocalChange, ...]:
    """Return the changes that the images allow to be estimated, cameras that are given left out."""
    images = joint.problem.pictured
    kinds = np.array(images.kinds)
    used = finite(joint.residuals).any(axis=-1)
    owned = {c: (images.camera == c) & used for c in (0, 1) if joint.problem.free[c]}
    found: list[FocalChange] = []
    for kind in ("pair", "row"):
        told = {}
        for c, own in owned.items():
            chosen = own & (kinds == kind)
            others = int(own.sum() - chosen.sum())
            if min(int(chosen.sum()), others) >= MIN_IMAGES:
                told[c] = _by_view(joint, chosen, np.ones(len(own)))
        found += _changes(joint, told, kind)
    near = 1 / board_distances(joint.problem, joint.reduced.at.own[: images.views])[images.view]
    spans = {c: float(np.ptp(near[own])) if own.any() else 0.0 for c, own in owned.items()}
    told = {
        c: _by_view(joint, owned[c], (near - near[owned[c]].mean()) / span)
        for c, span in spans.items()
        if span > 0
    }
    found += _changes(joint, told, "distance")
    return tuple(sorted(found, key=lambda change: change.camera))


def _by_view(joint: Solved, chosen: BoolArray, x: FloatArray) -> FloatArray:
    """Return x, one an image, by view; 0 where the camera has no chosen image."""
    images = joint.problem.pictured
    values = np.zeros(len(joint.reduced.scores))
    values[images.view[chosen]] = x[chosen]
    return values


def _changes(joint: Solved, told: dict[int, FloatArray], between: str) -> list[FocalChange]:
    """Return the change of each camera with its covariate by view; none that nothing tells.

    That of each alone, unless both together explain the images better beyond doubt.
    """
    alone = {c: _estimate(joint, {c: x}) for c, x in told.items()}
    single = {c: found for c, found in alone.items() if found is not None}
    both = _estimate(joint, told) if len(single) > 1 else None
    if both is not None:
        gain = both.squares / both.factors.max() - max(
            float(one.squares / one.factors[0]) for one in single.values()
        )
        if gain > BOTH_GAIN:
            return [
                FocalChange(f"c{c + 1}", between, float(b), float(u), together=True)
                for c, b, u in zip(told, both.beta, both.std, strict=True)
            ]
    return [
        FocalChange(f"c{c + 1}", between, float(one.beta[0]), float(one.std[0]))
        for c, one in single.items()
    ]


def _estimate(joint: Solved, told: dict[int, FloatArray]) -> ChangeEstimate | None:
    """Return the changes of focal length of the cameras together; None where they stay open."""
    at = [joint.problem.at_lens(c) for c in told]
    way = np.zeros((len(told), *joint.reduced.scores.shape))
    for k, x in enumerate(told.values()):
        way[k][:, at[k][:2]] = x[:, None] * joint.reduced.at.shared[at[k][:2]]
    return estimate(joint, way, at)


class ChangeEstimate(NamedTuple):
    """Changes along k ways, their u with dispersion, the factors, and chi squared without."""

    beta: FloatArray
    std: FloatArray
    factors: FloatArray
    squares: float


def estimate(joint: Solved, way: FloatArray, at: list[IntArray]) -> ChangeEstimate | None:
    """Return the changes along ways together; None where something leaves them open.

    Parameters
    ----------
    way
        How the shared unknowns of each view change with 1 along each way, shape (k, v, n).
    at
        Places of the unknowns in which the views' disagreement counts, of each way.
    """
    reduced, spread = joint.reduced, joint.reduced.spread()
    told = along(reduced, way, spread)
    scale = np.sqrt(np.diag(told.plain))
    if not np.all(scale > 0):
        return None
    if np.linalg.eigvalsh(told.information / np.outer(scale, scale))[0] <= TOLD_LEAST:
        return None
    variance = np.linalg.inv(told.information)
    beta = -variance @ told.gradient
    # The views contradict each other by these changes, too: the factor is that of what is left.
    moved = np.einsum("k,kvi->vi", beta, way) - spread @ (beta @ told.mixed)
    scores = reduced.scores + np.einsum("vij,vj->vi", reduced.normals, moved)
    left = replace(reduced, scores=scores)
    factors = np.array([dispersion(left, own, joint.clusters) for own in at])
    std = np.sqrt(factors * np.diag(variance))
    return ChangeEstimate(beta, std, factors, float(beta @ told.information @ beta))
