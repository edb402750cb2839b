"""The pictures so far as one least-squares problem, and what further ones would add to it.

Unknowns, derivatives and the elimination of board poses are those of the joint solve of the chain
(`calib.images.joint`); so what is predicted here is what the chain will state, as far as noise and
lens model are known. Beside the pictures stand priors, wide enough to say nothing once there are
some: they keep the first poses' choice and the solution regular.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.images.bundle import finite, inverse
from calib.images.joint.model import POSE, JointProblem, normals_of, residuals_of
from calib.images.joint.reduced import (
    Reduced,
    Unknowns,
    ViewNormals,
    dispersion,
    eliminated,
    minimise_views,
)

FIRST_SIGMA_PX: Final = 0.1
SIGMA_FREEDOM: Final = 20.0
"""Corner noise believed before residuals tell, and the degrees of freedom that this is worth."""

OWN_FACTOR_VIEWS: Final = 6
"""Fewer views hardly tell how much they contradict each other."""

DONE: Final = 1e-3
"""Gain of the cost at which to stop: steps of 3 % of a standard deviation remain. One picture alone
leaves a valley in which a minimum is not reached to rounding."""

_ROUNDS: Final = 3


@dataclass(frozen=True)
class NormalPrior:
    """A normal prior of the shared unknowns: mean, (n,), and inverse covariance, (n, n)."""

    mean: FloatArray
    precision: FloatArray


@dataclass(frozen=True)
class PictureKnowledge:
    """What the pictures so far say.

    Parameters
    ----------
    problem
        The pictures.
    at
        The minimum.
    normals
        What each view says of the shared unknowns, its pose eliminated, shape (v, n, n).
    scores
        A*'r of each view, whitened, shape (v, n).
    prior
        Of the shared unknowns.
    sigma_px
        Standard deviation of a corner coordinate.
    rms_px
        Of the residuals of each view, shape (v,).
    """

    problem: JointProblem
    at: Unknowns
    normals: FloatArray
    scores: FloatArray
    prior: NormalPrior
    sigma_px: float
    rms_px: FloatArray

    @property
    def information(self) -> FloatArray:
        """Of views and priors, shape (n, n)."""
        found: FloatArray = self.normals.sum(axis=0) + self.prior.precision
        return found

    def factor(self, columns: IntArray) -> float:
        """Return the factor on the variance of unknowns by which views contradict each other."""
        if len(self.normals) < OWN_FACTOR_VIEWS:
            return 1.0
        reduced = Reduced(self.at, self.normals, self.scores, 0.0)
        with suppress(EstimationError, np.linalg.LinAlgError):
            return max(1.0, dispersion(reduced, columns, np.arange(len(self.normals))))
        return 1.0

    def covariance(self) -> FloatArray:
        """Return the covariance of the shared unknowns, shape (n, n)."""
        return inverse(self.information)


def solve(problem: JointProblem, start: Unknowns, prior: NormalPrior) -> PictureKnowledge:
    """Return what the pictures say.

    Raises
    ------
    EstimationError
        If there is no minimum.
    """
    sigma, at = FIRST_SIGMA_PX, start
    for _ in range(_ROUNDS):
        reduced = minimise_views(_with_prior(problem, prior, sigma), _with_room(at), done=DONE)
        at = Unknowns(reduced.at.shared, reduced.at.own[:-1])
        residuals = residuals_of(problem, at)
        before, sigma = sigma, _sigma(problem, residuals)
        if abs(sigma / before - 1) < 0.05:
            break
    mean_square = np.nanmean(residuals**2, axis=(1, 2))
    return PictureKnowledge(
        problem=problem,
        at=at,
        normals=reduced.normals[:-1],
        scores=reduced.scores[:-1],
        prior=prior,
        sigma_px=sigma,
        rms_px=np.sqrt(mean_square),
    )


def nothing_known(problem: JointProblem, prior: NormalPrior) -> PictureKnowledge:
    """Return what is known without a picture; `problem` has none."""
    size = problem.size
    return PictureKnowledge(
        problem=problem,
        at=Unknowns(prior.mean, np.zeros((0, POSE))),
        normals=np.zeros((0, size, size)),
        scores=np.zeros((0, size)),
        prior=prior,
        sigma_px=FIRST_SIGMA_PX,
        rms_px=np.zeros(0),
    )


def added_by(known: PictureKnowledge, candidates: JointProblem, poses: FloatArray) -> FloatArray:
    """Return what each view would add to the information, shape (v, n, n).

    Parameters
    ----------
    candidates
        Pictures that were not taken, their corners where they would be; NaN where not seen.
    poses
        Of the board in them, shape (v, 6).
    """
    weight = np.where(finite(candidates.images.pixels), known.sigma_px**-2.0, 0.0)
    normals = normals_of(candidates, Unknowns(known.at.shared, poses), weight)
    return eliminated(normals, 0.0)[0]


def left_by(known: PictureKnowledge, added: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the mean variance of what is asked after each candidate, shape (v,).

    Parameters
    ----------
    added
        Information of the candidates, shape (v, n, n).
    asked
        Derivatives of what is asked by the shared unknowns, shape (quantities, n): the variance is
        the mean of theirs (the I-criterion of optimal design).
    """
    scale = np.sqrt(np.diag(known.information))
    outer = np.outer(scale, scale)
    spread = np.linalg.inv((known.information + added) / outer) / outer
    weight = asked.T @ asked / len(asked)
    found: FloatArray = np.einsum("ij,vji->v", weight, spread)
    return found


def _with_prior(
    problem: JointProblem, prior: NormalPrior, sigma: float
) -> Callable[[Unknowns], ViewNormals]:
    """Return the normal equations, with the priors as a last view without own unknowns."""
    weight = np.where(finite(problem.images.pixels), sigma**-2.0, 0.0)

    def evaluate(at: Unknowns) -> ViewNormals:
        views = normals_of(problem, Unknowns(at.shared, at.own[:-1]), weight)
        off = at.shared - prior.mean
        pull = prior.precision @ off
        size = problem.size
        return ViewNormals(
            shared=np.concatenate([views.shared, prior.precision[None]]),
            mixed=np.concatenate([views.mixed, np.zeros((1, size, POSE))]),
            own=np.concatenate([views.own, np.zeros((1, POSE, POSE))]),
            shared_gradient=np.concatenate([views.shared_gradient, pull[None]]),
            own_gradient=np.concatenate([views.own_gradient, np.zeros((1, POSE))]),
            cost=views.cost + float(off @ pull),
        )

    return evaluate


def _with_room(at: Unknowns) -> Unknowns:
    return Unknowns(at.shared, np.concatenate([at.own, np.zeros((1, POSE))]))


def _sigma(problem: JointProblem, residuals: FloatArray) -> float:
    """Return the standard deviation of a corner coordinate, px, by residuals and first belief."""
    squares = float(np.nansum(residuals**2))
    freedom = np.isfinite(residuals).sum() - POSE * problem.images.views - problem.size
    believed = SIGMA_FREEDOM * FIRST_SIGMA_PX**2
    return float(np.sqrt((believed + squares) / (SIGMA_FREEDOM + max(float(freedom), 0.0))))
