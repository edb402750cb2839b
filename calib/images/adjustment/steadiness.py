"""Whether C1 kept its place while the gaze rows were taken, and what it may have done unseen.

A slow turn of C1 against the rig (a loose screw, a cable that pulls) moves C2 and its axis in C1's
frame a little farther from row to row. Pictures of a board by both cameras show it, as
`calib.images.joint.changes` shows a change of a lens. A turn about C1's y axis looks like errors of
readings that grow from row to row, and makes the scatter of readings large in which it then hides:
their trend is tested by itself. Shifts of C1 are not looked for: a depth shows them no larger than
they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.images.adjustment.mounting import RIG, rig_by_turn_of_c1
from calib.images.adjustment.problem import AdjustmentProblem
from calib.images.bundle import finite
from calib.images.joint.allowance import allowed
from calib.images.joint.changes import MIN_IMAGES, Solved, estimate
from calib.images.joint.drifts import CHANCE, chi2_limit
from calib.images.joint.reduced import Reduced

TURN_STD_RAD = 1e-4
"""Standard deviation beforehand of a turn of C1 about each of its axes from the first row to the
last: a tenth of what a row's gaze is good to, and what a gate lets pass."""


@dataclass(frozen=True)
class TurnOfC1:
    """How far C1 turned from the first gaze row to the last, by an even drift.

    Parameters
    ----------
    turn_rad, std
        Rotation vector and standard uncertainties, shape (3,) each.
    chi2, limit
        Of three degrees of freedom, and what is exceeded in 1 of 1,000 runs by chance.
    trend_rad, trend_probability
        By how much more the last reading errs than the first, and how probable as much is by
        chance.
    """

    turn_rad: FloatArray
    std: FloatArray
    chi2: float
    limit: float
    trend_rad: float
    trend_probability: float

    @property
    def found(self) -> bool:
        """Whether C1 turned, by more than matters."""
        turned = self.chi2 > self.limit and float(np.linalg.norm(self.turn_rad)) > TURN_STD_RAD
        return turned or (self.trend_probability < CHANCE and abs(self.trend_rad) > TURN_STD_RAD)


def turn_of_c1(
    found: Solved, problem: AdjustmentProblem, rig: FloatArray, errors: FloatArray
) -> TurnOfC1 | None:
    """Return the drift; None where too few rows have pictures of both cameras.

    Parameters
    ----------
    rig
        Values of `RIG`, shape (13,).
    errors
        Of all readings, rad, shape (e,).
    """
    used: BoolArray = np.asarray(finite(found.residuals).any(axis=-1))
    if len(_rows(problem, used)) < 2 * MIN_IMAGES:
        return None
    told = estimate(found, _ways(problem, found.reduced, rig, used), [problem.at_rig] * 3)
    if told is None:
        return None
    exposure = problem.pictures.exposure[_rows(problem, used)]
    trend, probability = _trend(errors[exposure], problem.pictures.readings_rad[exposure])
    placed = np.unique(problem.pictures.view[(problem.pictures.exposure >= 0) & used])
    return TurnOfC1(
        turn_rad=told.beta,
        std=told.std,
        chi2=told.squares / float(told.factors[0]),
        limit=chi2_limit(3, found.clusters[placed]),
        trend_rad=trend,
        trend_probability=probability,
    )


def _trend(errors: FloatArray, readings: FloatArray) -> tuple[float, float]:
    """Return the change from first to last along the order of rows, and its probability by chance.

    Beside what may follow the reading itself, an error of the encoder that the model has not: a
    parabola in it. Student's t of the regression.

    Parameters
    ----------
    errors, readings
        In the order of the rows, rad, shape (n,).
    """
    count = len(errors)
    order, scaled = np.linspace(-0.5, 0.5, count), readings - readings.mean()
    scaled = scaled / np.ptp(scaled)
    others = np.stack([np.ones(count), scaled, scaled**2], axis=1)
    basis = np.linalg.qr(others)[0]
    own = order - basis @ (basis.T @ order)
    square, freedom = float(own @ own), count - 4
    slope = float(own @ errors) / square
    left = errors - basis @ (basis.T @ errors) - slope * own
    std = np.sqrt(float(left @ left) / freedom / square)
    return slope, float(2 * student.sf(abs(slope) / max(std, 1e-300), freedom))


def turn_covariance(
    problem: AdjustmentProblem, reduced: Reduced, used: BoolArray, factor: float
) -> FloatArray:
    """Return what a drift of C1 in the course of the rows adds, shape (n, n).

    The estimate stands for C1 half way; that it is as before the first row or as after the last
    when something is measured is counted too.

    Parameters
    ----------
    used
        Which pictures count, shape (i,).
    factor
        Variance as the views show it over that of independent residuals.
    """
    if not len(_rows(problem, used)):
        return np.zeros((problem.size, problem.size))
    rig = problem.rig_at(reduced.at.shared)
    ways = _ways(problem, reduced, rig, used)
    found = allowed(reduced, ways, np.full(3, TURN_STD_RAD), factor)
    ends = np.zeros((problem.size, 3))
    ends[problem.at_rig] = _turning(problem, rig) / 2
    added: FloatArray = found.covariance() + ends @ found.mean_square @ ends.T
    return added


def _turning(problem: AdjustmentProblem, rig: FloatArray) -> FloatArray:
    """Return how a turn of C1 moves the free unknowns of the rig, shape (free, 3)."""
    moved: FloatArray = rig_by_turn_of_c1(rig)[[RIG.index(name) for name in problem.names]]
    return moved


def _rows(problem: AdjustmentProblem, used: BoolArray) -> IntArray:
    """Return C2's pictures of rows of which C1 has one too, in the order of the rows."""
    pictures = problem.pictures
    both = np.isin(pictures.view, pictures.view[(pictures.camera == 0) & used])
    return np.flatnonzero(
        (np.array(pictures.kinds) == "row") & (pictures.exposure >= 0) & used & both
    )


def _ways(
    problem: AdjustmentProblem, reduced: Reduced, rig: FloatArray, used: BoolArray
) -> FloatArray:
    """Return how a turn moves the shared unknowns of each view, shape (3, v + 1, n)."""
    pictures = problem.pictures
    rows = pictures.view[_rows(problem, used)]
    pairs = (np.array(pictures.kinds) == "pair") & (pictures.exposure >= 0)
    share = np.zeros(len(reduced.scores))
    share[pictures.view[pairs]] = -0.5
    share[rows] = np.linspace(-0.5, 0.5, len(rows))
    way = np.zeros((3, *reduced.scores.shape))
    way[:, :, problem.at_rig] = share[:, None] * _turning(problem, rig).T[:, None]
    return way
