"""Bundle adjustment: normal equations of blocks, and a damped Newton method.

The problem is given as blocks of whitened residuals (one image, one prior), each with the columns
of its jacobian; the normal equations are summed up block by block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.core.unit_diagonal import Spectrum

MAX_STEPS = 100
"""Newton steps, damped ones included; from a start by single views some ten suffice."""

DONE = 1e-9
"""Gain of the whitened cost at which to stop: steps of 3e-5 standard deviations remain."""

_POLISHING_STEPS = 4
_LEAST_DAMPING = 1e-12
_FIRST_DAMPING = 1e-4
_MAX_DAMPING = 1e12


class Block(NamedTuple):
    """Whitened residuals, shape (m,), their jacobian, (m, k), and its unknowns' places, (k,)."""

    residuals: FloatArray
    jacobian: FloatArray
    columns: IntArray


class Normal(NamedTuple):
    """Normal equations: matrix J'J, shape (n, n), gradient J'r, shape (n,), cost r'r."""

    matrix: FloatArray
    gradient: FloatArray
    cost: float


class Minimum(NamedTuple):
    """Where the cost is least, shape (n,), with the normal equations there."""

    x: FloatArray
    normal: Normal


def deformed(points: FloatArray, warp_mm: tuple[float, float] | None) -> FloatArray:
    """Return board points, shape (n, 3), mm, with the warp of `LensFit.board_warp_mm` put in.

    The warp is mrcal's: a parabola each along x and along y, 0 at the outer corners.
    """
    if warp_mm is None:
        return points
    shaped = points.copy()
    shaped[:, 2] += warp_shapes(points) @ np.array(warp_mm)
    return shaped


def warp_shapes(points: FloatArray) -> FloatArray:
    """Return how a warp of 1 mm along x and one along y lift board points, mm, shape (n, 2)."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    place = (points[:, :2] - low) / (high - low)
    shapes: FloatArray = 4 * place * (1 - place)
    return shapes


def sum_blocks(blocks: Sequence[Block], size: int) -> Normal:
    """Sum up the normal equations of `size` unknowns."""
    matrix, gradient, cost = np.zeros((size, size)), np.zeros(size), 0.0
    for block in blocks:
        matrix[np.ix_(block.columns, block.columns)] += block.jacobian.T @ block.jacobian
        gradient[block.columns] += block.jacobian.T @ block.residuals
        cost += float(block.residuals @ block.residuals)
    return Normal(matrix, gradient, cost)


def minimise(evaluate: Callable[[FloatArray], Sequence[Block]], start: FloatArray) -> Minimum:
    """Minimise the sum of squares of the blocks' residuals (Levenberg and Marquardt).

    Raises
    ------
    EstimationError
        If the cost is not finite at the start, or no minimum is reached in `MAX_STEPS`.
    """
    x = np.array(start, dtype=np.float64)
    normal = sum_blocks(evaluate(x), len(x))
    if not np.isfinite(normal.cost):
        raise EstimationError("bundle adjustment: the start does not project into the images")
    damping = _FIRST_DAMPING
    for _ in range(MAX_STEPS):
        step, gain = _step(normal, damping)
        if gain < DONE and damping <= 1:
            return _polished(evaluate, x, normal)
        trial = sum_blocks(evaluate(x + step), len(x))
        if trial.cost < normal.cost:
            x, normal, damping = x + step, trial, damping / 10
        else:
            damping *= 10
        if damping > _MAX_DAMPING:
            break
    raise EstimationError(
        f"bundle adjustment: no minimum within {MAX_STEPS} steps, cost {normal.cost:.3g}; "
        "check that the images belong to this board and these cameras"
    )


def _polished(
    evaluate: Callable[[FloatArray], Sequence[Block]], x: FloatArray, normal: Normal
) -> Minimum:
    """Return the minimum to rounding: full steps for as long as each promises less than the last.

    Equal problems in other words, such as a rig's mirror image, then have equal results.
    """
    step, gain = _step(normal, _LEAST_DAMPING)
    for _ in range(_POLISHING_STEPS):
        trial = sum_blocks(evaluate(x + step), len(x))
        next_step, next_gain = _step(trial, _LEAST_DAMPING)
        if not 0 <= next_gain < gain:
            break
        x, normal, step, gain = x + step, trial, next_step, next_gain
    return Minimum(x, normal)


def _step(normal: Normal, damping: float) -> tuple[FloatArray, float]:
    """Return the damped step and the gain of the cost that it promises."""
    scale = np.sqrt(np.maximum(np.diag(normal.matrix), 1e-300))
    scaled = normal.matrix / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += damping
    step = -np.linalg.solve(scaled, normal.gradient / scale) / scale
    return step, float(-normal.gradient @ step)


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix, whatever the units of its unknowns.

    Raises
    ------
    EstimationError
        If it is singular: the images leave some unknown open.
    """
    if not np.all(np.diagonal(matrix) > 0):
        raise EstimationError("bundle adjustment: an unknown does not show in any image")
    spectrum = Spectrum.of(matrix)
    if spectrum.span < len(matrix) * np.finfo(float).eps:
        raise EstimationError("bundle adjustment: the images leave some unknown open")
    return spectrum.inverse()


def dispersion(clusters: Sequence[Sequence[Block]], spread: FloatArray, columns: IntArray) -> float:
    """Return how much more clusters contradict each other than independent noise explains.

    The variance of the unknowns `columns` as the clusters show it, over that of least squares with
    independent residuals, averaged over all directions: the cluster-robust covariance of Liang and
    Zeger (1986, doi 10.1093/biomet/73.1.13), less its bias, as one number. 1 on independent noise,
    more where errors are common to an image: a detector's bias with the light, blur, a board that
    is not quite flat; less where neighbouring corners err against each other. See `proven`.

    Parameters
    ----------
    clusters
        Whitened blocks at the minimum, by image or pair.
    spread
        Inverse of the normal matrix of all unknowns, shape (n, n).
    columns
        Places of the unknowns in question.
    """
    chosen = spread[columns]
    weight = chosen.T @ inverse(chosen[:, columns]) @ chosen
    found = expected = square = 0.0
    for blocks in clusters:
        own = np.unique(np.concatenate([block.columns for block in blocks]))
        at_own = [block._replace(columns=np.searchsorted(own, block.columns)) for block in blocks]
        normal = sum_blocks(at_own, len(own))
        inside = np.ix_(own, own)
        found += float(normal.gradient @ weight[inside] @ normal.gradient)
        left = normal.matrix - normal.matrix @ spread[inside] @ normal.matrix
        share = weight[inside] @ left
        expected += float(np.trace(share))
        square += float(np.einsum("ij,ji->", share, share))
    return proven(found / expected, freedom=expected**2 / square if square > 0 else 0.0)


def proven(ratio: float, *, freedom: float) -> float:
    """Return the factor on a variance that an estimated ratio of variances bears out.

    The ratio itself where it is above 1. Below, that much is claimed only as the estimate proves:
    the ratio and one standard error of it, sqrt(2 / freedom), and never more than 1. Few clusters
    may agree by chance.

    Parameters
    ----------
    ratio
        Variance found over variance expected.
    freedom
        Degrees of freedom of the variance found; 0 or less proves nothing.
    """
    if freedom <= 0:
        return max(ratio, 1.0)
    return max(ratio, min(1.0, ratio * (1 + float(np.sqrt(2 / freedom)))))


def finite(rows: FloatArray) -> BoolArray:
    """Return where rows, shape (..., k), are free of NaN, shape (...)."""
    good: BoolArray = np.asarray(np.isfinite(rows).all(axis=-1))
    return good
