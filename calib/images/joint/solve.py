"""Lenses of both cameras, pose of C2 and board deformation from all board images together.

Corners of one camera and one kind of image (of lenses, pairs, rows) have one variance, estimated
from their residuals; corners that stand out are left out, largest first, and the rest is solved
again. The covariance is that of least squares, block by block times the factor by which views
contradict each other (`calib.images.joint.reduced.dispersion`), and what changes between the
pictures may add (`calib.images.joint.allowance`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera
from calib.images.bundle import finite
from calib.images.checks import OUTLIER_SIGMAS, SIGMA_OF_MEDIAN
from calib.images.joint.allowance import breathing_covariance
from calib.images.joint.model import POSE, JointProblem, board_covariance, normals_of, residuals_of
from calib.images.joint.reduced import (
    Reduced,
    Unknowns,
    ViewNormals,
    dispersion,
    minimise_views,
)
from calib.images.joint.unknowns import ImagesOfViews
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.repeats import repeat_clusters

HUBER_SIGMAS = 3.0
"""While outliers are looked for, a corner farther off than this pulls no harder: a picture that
does not belong would bend the rest before it is known."""

PEEL_SHARE = 0.5
"""Of a view's outliers only those beyond this share of its largest residual go in one round."""

IMAGE_SHARE_MIN = 0.5
"""An image that loses more than half of its corners is left out altogether."""

VARIANCE_CHANGE = 0.02
"""Relative change of all variances below which the rounds stop: 1 % of every uncertainty."""

GROUP_MIN = 100
"""Coordinates below which a kind of image shares the variance of all: its own would be good to
10 %."""

LEAST_SIGMA_PX = 1e-6
"""Corners computed, not found, may be exact."""

_ROUNDS = 12


@dataclass(frozen=True)
class JointSolve:
    """What all images together say.

    Parameters
    ----------
    problem
        The images and the order of the shared unknowns.
    reduced
        The minimum, whitened, with the views' normal equations.
    cameras
        C1 and C2.
    pose_12
        Pose of C2 in C1, rad and mm, shape (6,).
    board_warp_mm
        Board deformation along x and y, mm.
    covariance
        Of the shared unknowns, with the factors, the board's errors and what lenses that change
        with distance may do, shape (n, n).
    allowance
        This last part of it (`calib.images.joint.allowance`), shape (n, n).
    factors
        On the variances of the intrinsics of C1, of C2 (1 where given) and of the pose of C2.
    clusters
        Cluster of each view, shape (v,): views that nearly repeat each other.
    sigma_px
        Standard deviation of a corner coordinate by camera ("c1", "c2") and kind of image.
    residuals
        Observed minus projected, px, shape (i, corners, 2); NaN where missing or rejected.
    rejected
        Corners found and left out, shape (i, corners).
    """

    problem: JointProblem
    reduced: Reduced
    cameras: tuple[Camera, Camera]
    pose_12: FloatArray
    board_warp_mm: tuple[float, float]
    covariance: FloatArray
    allowance: FloatArray
    factors: tuple[float, float, float]
    clusters: IntArray
    sigma_px: dict[str, float]
    residuals: FloatArray
    rejected: BoolArray

    @property
    def poses(self) -> FloatArray:
        """Board poses of the views, rad and mm, shape (v, 6)."""
        return self.reduced.at.own

    def full_covariance(self) -> FloatArray:
        """Return the covariance of intrinsics of C1, of C2, pose of C2; 0 for what is given."""
        counts = [4 + len(c.distortion) for c in self.cameras]
        edges = np.cumsum([0, *counts, POSE])
        solved, places = [], []
        for c in (0, 1):
            if self.problem.free[c]:
                solved.append(self.problem.at_lens(c))
                places.append(np.arange(edges[c], edges[c + 1]))
        at = np.concatenate([*solved, self.problem.at_pose])
        to = np.concatenate([*places, np.arange(edges[2], edges[3])])
        full = np.zeros((int(edges[3]), int(edges[3])))
        full[np.ix_(to, to)] = self.covariance[np.ix_(at, at)]
        return full


def solve_joint(problem: JointProblem, start: Unknowns) -> JointSolve:
    """Solve, with outliers rejected and variances estimated.

    Raises
    ------
    EstimationError
        If there is no minimum, or the images leave an unknown open.
    """
    labels, groups = groups_of(problem.images)
    used = finite(problem.images.pixels)
    at, residuals = start, residuals_of(problem, start)
    sigma = robust_sigmas(residuals, used, groups)
    searching = True
    for _ in range(_ROUNDS):
        weight = weights_of(residuals, used, sigma[groups], bounded=searching)
        reduced = minimise_views(_evaluation(problem, weight), at)
        at, residuals = reduced.at, residuals_of(problem, reduced.at)
        kept = without_outliers(residuals, used, groups)
        settled = np.array_equal(kept, used)
        if settled and not searching:
            found = sigmas_of(problem.images, reduced, residuals, used, groups)
            if np.all(np.abs(found / sigma - 1) < VARIANCE_CHANGE):
                break
            sigma = found
        else:
            used, searching = kept, not settled
            sigma = robust_sigmas(residuals, used, groups)
    sigma_px = dict(zip(labels, (float(v) for v in sigma), strict=True))
    return _result(problem, reduced, residuals, used, weight, sigma_px)


def _evaluation(problem: JointProblem, weight: FloatArray) -> Callable[[Unknowns], ViewNormals]:
    return lambda at: normals_of(problem, at, weight)


def groups_of(images: ImagesOfViews) -> tuple[tuple[str, ...], IntArray]:
    """Return names of the groups, camera and kind, and that of each image, shape (i,)."""
    own = [f"c{c + 1} {kind}" for c, kind in zip(images.camera, images.kinds, strict=True)]
    names, place = np.unique(own, return_inverse=True)
    return tuple(str(name) for name in names), place


def weights_of(
    residuals: FloatArray, used: BoolArray, sigma: FloatArray, *, bounded: bool
) -> FloatArray:
    """Return the weight of each corner, 1/px^2, shape (i, corners).

    Parameters
    ----------
    sigma
        Of each image, px, shape (i,).
    bounded
        Whether a corner beyond `HUBER_SIGMAS` pulls as one there (Huber's weights).
    """
    weight: FloatArray = np.where(used, sigma[:, None] ** -2.0, 0.0)
    if bounded:
        size = np.where(used, np.linalg.norm(residuals, axis=-1), 0.0) / sigma[:, None]
        weight = weight * np.minimum(1.0, HUBER_SIGMAS / np.maximum(size, 1e-12))
    return weight


def robust_sigmas(residuals: FloatArray, used: BoolArray, groups: IntArray) -> FloatArray:
    """Return standard deviations of the groups, px, from the median of absolute residuals."""
    size = np.where(used[..., None], np.abs(residuals), np.nan)
    sigma = np.full(int(groups.max()) + 1, SIGMA_OF_MEDIAN * float(np.nanmedian(size)))
    for g in range(len(sigma)):
        own = size[groups == g]
        if np.isfinite(own).sum() >= GROUP_MIN:
            sigma[g] = SIGMA_OF_MEDIAN * float(np.nanmedian(own))
    return _rounded(np.maximum(sigma, LEAST_SIGMA_PX))


def sigmas_of(
    images: ImagesOfViews,
    reduced: Reduced,
    residuals: FloatArray,
    used: BoolArray,
    groups: IntArray,
) -> FloatArray:
    """Return standard deviations of the groups, px: squares over redundancy.

    Variance components (Foerstner 1979): a view uses up its own six unknowns and, of the shared
    ones, tr(C N_v), C being their covariance and N_v its normal matrix; its images share this by
    their coordinates.
    """
    view = images.view
    taken = POSE + np.einsum("ij,vji->v", reduced.spread(), reduced.normals)
    count = 2.0 * used.sum(axis=-1)
    whole = np.bincount(view, count, minlength=images.views)[view]
    redundancy = count - np.where(count > 0, taken[view] * count / np.maximum(whole, 1.0), 0.0)
    square = np.where(used[..., None], residuals, 0.0) ** 2
    square_sum = square.sum(axis=(1, 2))
    sigma = np.full(
        int(groups.max()) + 1, np.sqrt(square_sum.sum() / max(float(redundancy.sum()), 1.0))
    )
    for g in range(len(sigma)):
        own = float(redundancy[groups == g].sum())
        if own >= GROUP_MIN:
            sigma[g] = np.sqrt(square_sum[groups == g].sum() / own)
    return _rounded(np.maximum(sigma, LEAST_SIGMA_PX))


def _rounded(sigma: FloatArray) -> FloatArray:
    """Return standard deviations to three digits: equal problems then have equal weights."""
    return np.array([float(f"{value:.2e}") for value in sigma])


def without_outliers(residuals: FloatArray, used: BoolArray, groups: IntArray) -> BoolArray:
    """Return which corners, shape (i, corners), to use next."""
    size = np.where(used, np.abs(residuals).max(axis=-1), 0.0)
    limit = OUTLIER_SIGMAS * robust_sigmas(residuals, used, groups)[groups][:, None]
    kept: BoolArray = used & (
        size <= np.maximum(limit, PEEL_SHARE * size.max(axis=-1, keepdims=True))
    )
    whole = finite(residuals).sum(axis=-1)
    kept[kept.sum(axis=-1) < np.maximum(MIN_CORNERS, IMAGE_SHARE_MIN * whole)] = False
    return kept


def clusters_of(images: ImagesOfViews, points: FloatArray) -> IntArray:
    """Return the cluster of each view, shape (v,): views that repeat each other in a camera."""
    leader = np.arange(images.views)
    for c in (0, 1):
        own = np.flatnonzero(images.camera == c)
        clusters = repeat_clusters(images.pixels[own], points)
        for k in np.unique(clusters):
            members = leader[images.view[own[clusters == k]]]
            leader[np.isin(leader, members)] = members.min()
    found: IntArray = np.unique(leader, return_inverse=True)[1].astype(np.int64)
    return found


def _result(
    problem: JointProblem,
    reduced: Reduced,
    residuals: FloatArray,
    used: BoolArray,
    weight: FloatArray,
    sigma_px: dict[str, float],
) -> JointSolve:
    x, spread = reduced.at.shared, reduced.spread()
    blocks = (problem.at_lens(0), problem.at_lens(1), problem.at_pose)
    clusters = clusters_of(problem.images, problem.points)
    factors = tuple(dispersion(reduced, b, clusters) if len(b) else 1.0 for b in blocks)
    scale = np.ones(problem.size)
    for block, factor in zip(blocks, factors, strict=True):
        scale[block] = np.sqrt(factor)
    covariance = spread * np.outer(scale, scale) + board_covariance(problem, reduced.at, weight)
    images_used: BoolArray = np.asarray(used.any(axis=-1))
    allowance = breathing_covariance(problem, reduced, images_used, max(factors))
    warp_x, warp_y = (float(v) for v in x[problem.at_warp])
    return JointSolve(
        problem=problem,
        reduced=reduced,
        cameras=(problem.camera_at(x, 0), problem.camera_at(x, 1)),
        pose_12=x[problem.at_pose],
        board_warp_mm=(warp_x, warp_y),
        covariance=covariance + allowance,
        allowance=allowance,
        factors=(factors[0], factors[1], factors[2]),
        clusters=clusters,
        sigma_px={name: float(s) for name, s in sigma_px.items()},
        residuals=np.where(used[..., None], residuals, np.nan),
        rejected=finite(problem.images.pixels) & ~used,
    )
