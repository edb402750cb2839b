"""Least squares with many unknowns of single views: these are eliminated (Schur's complement).

Shared unknowns x (lenses, pose of C2, board) stand in many views, own ones y_v (the board's pose)
in one. With A, B the derivatives of a view's whitened residuals r by x and y_v, the normal
equations of x alone are

    sum_v A*'A* dx = -sum_v A*'r,     A* = A - B (B'B)^-1 B'A,

of the size of x whatever the number of views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.images.bundle import DONE, MAX_STEPS, inverse
from calib.images.disagreement import view_factor

_FIRST_DAMPING = 1e-4
_MAX_DAMPING = 1e12
_POLISHING_STEPS = 4


class ViewNormals(NamedTuple):
    """Normal equations of v views with n shared and q own unknowns each.

    A'A (v, n, n), A'B (v, n, q), B'B (v, q, q), A'r (v, n), B'r (v, q), and r'r, summed.
    """

    shared: FloatArray
    mixed: FloatArray
    own: FloatArray
    shared_gradient: FloatArray
    own_gradient: FloatArray
    cost: float


class Unknowns(NamedTuple):
    """Shared unknowns, shape (n,), and those of each view, shape (v, q)."""

    shared: FloatArray
    own: FloatArray


@dataclass(frozen=True)
class Reduced:
    """The views' say on the shared unknowns at the minimum.

    Parameters
    ----------
    at
        The minimum.
    normals
        A*'A* of each view, shape (v, n, n).
    scores
        A*'r of each view, shape (v, n).
    cost
        Sum of squared whitened residuals.
    """

    at: Unknowns
    normals: FloatArray
    scores: FloatArray
    cost: float

    def spread(self) -> FloatArray:
        """Return the covariance of the shared unknowns under independent residuals, (n, n).

        Raises
        ------
        EstimationError
            If the views leave some of them open.
        """
        return inverse(self.normals.sum(axis=0))


def minimise_views(
    evaluate: Callable[[Unknowns], ViewNormals], start: Unknowns, *, done: float = DONE
) -> Reduced:
    """Minimise the sum of squares (Levenberg and Marquardt).

    Parameters
    ----------
    done
        Gain of the whitened cost at which to stop.

    Raises
    ------
    EstimationError
        If the cost is not finite at the start, or no minimum is reached in `MAX_STEPS`.
    """
    at, normals = start, evaluate(start)
    if not np.isfinite(normals.cost):
        raise EstimationError("joint solve: the start does not project into the images")
    damping = _FIRST_DAMPING
    for _ in range(MAX_STEPS):
        step, gain = _step(normals, damping)
        if gain < done and damping <= 1:
            return _polished(evaluate, at, normals)
        trial = _moved(at, step)
        found = evaluate(trial)
        if found.cost < normals.cost:
            at, normals, damping = trial, found, damping / 10
        else:
            damping *= 10
        if damping > _MAX_DAMPING:
            break
    raise EstimationError(
        f"joint solve: no minimum within {MAX_STEPS} steps, cost {normals.cost:.3g}; check that "
        "the images belong to this board and these cameras"
    )


def dispersion(reduced: Reduced, columns: IntArray, clusters: IntArray) -> float:
    """Return how much more views contradict each other than independent noise explains.

    In the shared unknowns `columns`, the others eliminated; see
    `calib.images.disagreement.view_factor`.
    """
    return view_factor(reduced.normals, reduced.scores, columns, clusters)


def _moved(at: Unknowns, step: Unknowns) -> Unknowns:
    return Unknowns(at.shared + step.shared, at.own + step.own)


def _polished(
    evaluate: Callable[[Unknowns], ViewNormals], at: Unknowns, normals: ViewNormals
) -> Reduced:
    """Return the minimum to rounding: full steps for as long as each promises less than the last.

    Equal problems in other words, such as a rig's mirror image, then have equal results.
    """
    step, gain = _step(normals, 0.0)
    for _ in range(_POLISHING_STEPS):
        trial = _moved(at, step)
        found = evaluate(trial)
        next_step, next_gain = _step(found, 0.0)
        if not 0 <= next_gain < gain:
            break
        at, normals, step, gain = trial, found, next_step, next_gain
    matrix, gradient = eliminated(normals, 0.0)
    return Reduced(at, matrix, gradient, normals.cost)


def eliminated(normals: ViewNormals, damping: float) -> tuple[FloatArray, FloatArray]:
    """Return matrices and gradients of the shared unknowns, view by view.

    Parameters
    ----------
    damping
        By which the diagonals of the views' own matrices are enlarged, in parts.
    """
    own = _damped(normals.own, damping)
    right = np.concatenate([normals.mixed.swapaxes(-1, -2), normals.own_gradient[..., None]], -1)
    solved = np.linalg.solve(own, right)
    matrix = normals.shared - normals.mixed @ solved[..., :-1]
    gradient = normals.shared_gradient - np.einsum("vnq,vq->vn", normals.mixed, solved[..., -1])
    return (matrix + matrix.swapaxes(-1, -2)) / 2, gradient


def _damped(own: FloatArray, damping: float) -> FloatArray:
    """Return matrices with their diagonals enlarged; a view that shows nothing gets ones."""
    diagonal = np.diagonal(own, axis1=-2, axis2=-1)
    extra = np.where(diagonal > 0, damping * diagonal, 1.0)
    return own + extra[..., None] * np.eye(own.shape[-1])


def _step(normals: ViewNormals, damping: float) -> tuple[Unknowns, float]:
    """Return the damped step and the gain of the cost that it promises."""
    matrices, gradients = eliminated(normals, damping)
    matrix, gradient = matrices.sum(axis=0), gradients.sum(axis=0)
    diagonal = np.diag(normals.shared.sum(axis=0))
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += np.where(diagonal > 0, damping, 1.0)
    shared = -np.linalg.solve(scaled, gradient / scale) / scale
    right = normals.own_gradient + np.einsum("vnq,n->vq", normals.mixed, shared)
    own = -np.linalg.solve(_damped(normals.own, damping), right[..., None])[..., 0]
    gain = -float(normals.shared_gradient.sum(axis=0) @ shared + np.sum(normals.own_gradient * own))
    return Unknowns(shared, own), gain
