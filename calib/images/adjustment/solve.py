"""Solves the adjustment: variances from residuals, outliers left out, models held side by side.

The robust scheme is that of `calib.images.joint.solve`. The variance of the errors of readings is a
component of its own: a motor that rests on whole counts errs by much less than a count. The
covariance is that of least squares, block by block (each lens, the rig) times the factor by which
views contradict each other (`calib.images.joint.reduced.dispersion`), what errors of the board
add, which all views have alike (`calib.images.board_errors`), and what changes of lenses and rig
between the pictures may add (`calib.images.joint.allowance`, `calib.images.adjustment.steadiness`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera
from calib.images.adjustment.model import Evaluation, board_covariance, evaluate
from calib.images.adjustment.problem import AdjustmentProblem
from calib.images.adjustment.steadiness import turn_covariance
from calib.images.bundle import finite, proven
from calib.images.joint.allowance import breathing_covariance
from calib.images.joint.reduced import Reduced, Unknowns, ViewNormals, dispersion, minimise_views
from calib.images.joint.solve import (
    VARIANCE_CHANGE,
    clusters_of,
    groups_of,
    robust_sigmas,
    sigmas_of,
    weights_of,
    without_outliers,
)

SMALLEST_STEP = 0.1
"""Least part of the stated uncertainty of a reading that is believed of its errors."""

LEAST_READING_STD_RAD = 1e-7
"""Standard deviation of a reading where none is stated: 0.1 mm at 1 km."""

_ROUNDS = 12


@dataclass(frozen=True)
class AdjustmentSolution:
    """A solved adjustment.

    Parameters
    ----------
    problem
        With the standard deviation of readings that the pictures show.
    reduced
        The minimum, with the normal equations of the views and of what is known beforehand.
    weight
        Of each corner, 1/px^2, shape (i, corners); 0 where missing or rejected.
    covariance
        Of the shared unknowns, with all that the docstring of this module names, shape (n, n).
    allowance
        What changes between the pictures add to it, shape (n, n).
    factors
        On the variances of the intrinsics of C1, of C2 (1 where given) and of the rig.
    clusters
        Cluster of each view and of what is known beforehand, shape (v + 1,).
    sigma_px
        Standard deviation of a corner coordinate by camera and kind of picture.
    residuals
        Observed minus projected, px, shape (i, corners, 2); NaN where missing or rejected.
    rejected
        Corners found and left out, shape (i, corners).
    reading_errors_rad
        Of each reading, shape (e,).
    """

    problem: AdjustmentProblem
    reduced: Reduced
    weight: FloatArray
    covariance: FloatArray
    allowance: FloatArray
    factors: tuple[float, float, float]
    clusters: IntArray
    sigma_px: dict[str, float]
    residuals: FloatArray
    rejected: BoolArray
    reading_errors_rad: FloatArray

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        """C1 and C2."""
        x = self.reduced.at.shared
        return self.problem.camera_at(x, 0), self.problem.camera_at(x, 1)

    @property
    def rig(self) -> FloatArray:
        """Values of `RIG`, shape (13,)."""
        return self.problem.rig_at(self.reduced.at.shared)

    @property
    def board_warp_mm(self) -> tuple[float, float]:
        """Board deformation along x and y, mm."""
        a, b = (float(v) for v in self.reduced.at.shared[self.problem.at_warp])
        return a, b


def solve(problem: AdjustmentProblem, start: Unknowns) -> AdjustmentSolution:
    """Solve, with outliers rejected and variances estimated.

    Raises
    ------
    EstimationError
        If there is no minimum, or the pictures leave an unknown open.
    """
    pictures = problem.pictures
    labels, groups = groups_of(pictures)
    used = finite(pictures.pixels)
    at = start
    residuals = evaluate(problem, start, np.where(used, 1.0, 0.0)).residuals
    sigma = robust_sigmas(residuals, used, groups)
    searching = True
    for _ in range(_ROUNDS):
        weight = weights_of(residuals, used, sigma[groups], bounded=searching)
        reduced = minimise_views(_normals(problem, weight), at)
        at = reduced.at
        found = evaluate(problem, at, weight)
        residuals = found.residuals
        kept = without_outliers(residuals, used, groups)
        settled = np.array_equal(kept, used)
        if not settled or searching:
            used, searching = kept, not settled
            sigma = robust_sigmas(residuals, used, groups)
            continue
        now = sigmas_of(pictures, reduced, residuals, used, groups)
        factor = _reading_factor(problem, reduced, found)
        near = np.all(np.abs(now / sigma - 1) < VARIANCE_CHANGE)
        if near and abs(factor - 1) < VARIANCE_CHANGE:
            break
        sigma = now
        problem, at = _rescaled(problem, at, factor)
    spread = dict(zip(labels, (float(s) for s in sigma), strict=True))
    return _solution(problem, reduced, weight, spread)


def hold(solution: AdjustmentSolution, names: tuple[str, ...]) -> AdjustmentSolution:
    """Return the solution with only these unknowns of the rig free, the others 0.

    Weights and variances are those of `solution`.

    Raises
    ------
    EstimationError
        If there is no minimum.
    """
    full = solution.problem
    kept = [full.names.index(name) for name in names]
    problem = replace(full, names=names, prior=tuple(full.prior[k] for k in kept))
    x = solution.reduced.at.shared
    shared = np.concatenate(
        [x[: full.at_rig[0]], x[full.at_rig[kept]], x[full.at_held]],
    )
    start = Unknowns(shared, solution.reduced.at.own)
    reduced = minimise_views(_normals(problem, solution.weight), start)
    return _solution(problem, reduced, solution.weight, solution.sigma_px)


def _normals(problem: AdjustmentProblem, weight: FloatArray) -> Callable[[Unknowns], ViewNormals]:
    return lambda at: evaluate(problem, at, weight).normals


def _rescaled(
    problem: AdjustmentProblem, at: Unknowns, factor: float
) -> tuple[AdjustmentProblem, Unknowns]:
    """Return the problem with another uncertainty of readings, and the same unknowns in it."""
    std = max(problem.reading_std_rad * factor, LEAST_READING_STD_RAD)
    shared = at.shared.copy()
    shared[problem.at_held] *= problem.reading_std_rad / std
    return replace(problem, reading_std_rad=std), Unknowns(shared, at.own)


def _reading_factor(problem: AdjustmentProblem, reduced: Reduced, found: Evaluation) -> float:
    """Return the standard deviation of the readings' errors over the one assumed.

    Their variance component, as far as proven: see `calib.images.sweep.solve`.
    """
    values = np.concatenate([found.readings.value, reduced.at.shared[problem.at_held]])
    freedom = len(values) - float(reading_variances(problem, reduced, found).sum())
    if freedom < 1:
        return 1.0
    ratio = float((values**2).sum()) / freedom
    return max(SMALLEST_STEP, float(np.sqrt(proven(ratio, freedom=freedom))))


def reading_variances(
    problem: AdjustmentProblem, reduced: Reduced, found: Evaluation
) -> FloatArray:
    """Return what is uncertain of the errors of readings, over their variance as assumed.

    Those of one picture each, then the shared ones. With H the derivative of an error by shared
    unknowns x and pose y, its variance is that with all else known and H cov(x, y) H'.
    """
    spread, readings = reduced.spread(), found.readings
    views = problem.pictures.view[readings.image]
    own, mixed = found.normals.own[views], found.normals.mixed[views]
    by_own = np.linalg.solve(own, readings.by_own[..., None])[..., 0]
    by_shared = readings.by_shared - np.einsum("rnq,rq->rn", mixed, by_own)
    variance = readings.conditional + np.einsum("rq,rq->r", readings.by_own, by_own)
    variance += np.einsum("ri,ij,rj->r", by_shared, spread, by_shared)
    return np.concatenate([variance, np.diag(spread)[problem.at_held]])


def _solution(
    problem: AdjustmentProblem, reduced: Reduced, weight: FloatArray, sigma_px: dict[str, float]
) -> AdjustmentSolution:
    found = evaluate(problem, reduced.at, weight)
    pictures, x = problem.pictures, reduced.at.shared
    own = clusters_of(pictures, problem.points)
    clusters = np.append(own, own.max() + 1)
    blocks = (problem.at_lens(0), problem.at_lens(1), problem.at_rig)
    factors = tuple(dispersion(reduced, b, clusters) if len(b) else 1.0 for b in blocks)
    scale = np.ones(problem.size)
    for block, factor in zip(blocks, factors, strict=True):
        scale[block] = np.sqrt(factor)
    errors = problem.held_at(x)
    readings = found.readings
    errors[pictures.exposure[readings.image]] = problem.reading_std_rad * readings.value
    board = board_covariance(problem, reduced.at, weight, reduced.normals[-1])
    used = weight > 0
    shown: BoolArray = np.asarray(used.any(axis=-1))
    covariance = reduced.spread() * np.outer(scale, scale) + board
    allowance = breathing_covariance(problem, reduced, shown, max(factors))
    allowance += turn_covariance(problem, reduced, shown, factors[2])
    return AdjustmentSolution(
        problem=problem,
        reduced=reduced,
        weight=weight,
        covariance=covariance + allowance,
        allowance=allowance,
        factors=(factors[0], factors[1], factors[2]),
        clusters=clusters,
        sigma_px=sigma_px,
        residuals=np.where(used[..., None], found.residuals, np.nan),
        rejected=finite(pictures.pixels) & ~used,
        reading_errors_rad=errors,
    )
