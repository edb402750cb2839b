"""Choice of the next targets by what they would leave uncertain at asked depths.

The information of a set of rows is the sum of theirs, g g^T each, g the derivative of a row's
closure by the parameters over its standard uncertainty; with priors and the rows so far it gives
the covariance M^-1 that the set leaves. Two criteria: *G*, the greatest relative u(z) over the
asked depths, and *D*, the volume det(M^-1) (Pukelsheim, Optimal Design of Experiments, 2006). Both
are minimised greedily and then by exchange (Fedorov), until no exchange gains.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.fit.noise import CLEAN, row_noise
from calib.geometry.misclosure import depth_jacobian, misclosure
from calib.geometry.parameters import Model
from calib.geometry.plane import gaze_at
from calib.plan.field import Field
from calib.rows.observations import Observations

EXCHANGES = 10
"""Rounds through all chosen targets; the second or third finds nothing more to exchange."""

GAIN = 1e-6
"""Relative gain of a criterion below which an exchange is rounding."""

REGULAR = 1e-9
"""Share of the unit information (one `Parameter.scale` each) that keeps M regular where neither
rows nor priors say anything: u(z) is then large, as it should be, and still finite."""

ASKED_ACROSS = (-0.7, 0.0, 0.7)
"""Directions, as shares of C1's field, over which u(z) at a depth is averaged (root mean square):
depth is asked for wherever C1 sees, not on its axis alone."""


@dataclass(frozen=True)
class Knowledge:
    """What is known before the new rows.

    Parameters
    ----------
    model
        p free parameters.
    theta
        Estimate, full parameter vector, shape (COUNT,).
    information
        Of rows so far and priors, shape (p, p), per unit of the parameters.
    noise_scale
        By which a row's stated uncertainty is to be multiplied.
    """

    model: Model
    theta: FloatArray
    information: FloatArray
    noise_scale: float = 1.0


@dataclass(frozen=True)
class RowNoise:
    """Standard uncertainties of a row to come: x1c, y1c, alpha2 and residual as in `OBSERVABLE`.

    Parameters
    ----------
    reading
        Shape (4,).
    z_mm, z_rel, z_square
        Of the reference depth z: absolute, as a share of z, and of z², 1/mm.
    """

    reading: FloatArray
    z_mm: float
    z_rel: float
    z_square: float = 0.0

    def of_depth(self, z: FloatArray) -> FloatArray:
        """Return the standard uncertainty of reference depths, mm, same shape."""
        u: FloatArray = np.hypot(np.hypot(self.z_mm, self.z_rel * z), self.z_square * z**2)
        return u


def rows_at(knowledge: Knowledge, points: FloatArray, noise: RowNoise) -> Observations:
    """Return the rows, without errors, that targets `points`, mm, shape (m, 3), would give."""
    gaze = gaze_at(knowledge.theta, points)
    z = points[:, 2]
    std = np.column_stack([np.tile(noise.reading, (len(z), 1)), noise.of_depth(z)])
    names = tuple(f"candidate {i + 1}" for i in range(len(z)))
    return Observations(
        ids=names,
        groups=names,
        x1c=gaze.x1c,
        y1c=gaze.y1c,
        alpha2_rad=gaze.alpha2,
        gaze_residual_rad=gaze.residual,
        z_mm=z,
        std=std,
    )


def row_vectors(knowledge: Knowledge, rows: Observations) -> FloatArray:
    """Return g of each row, shape (m, p): its information is g g^T."""
    slope = misclosure(knowledge.theta, rows.gaze, rows.z_mm).by_theta
    sigma = row_noise(knowledge.theta, rows).sigma * knowledge.noise_scale
    weight = np.sqrt(CLEAN.efficiency) / sigma
    vectors: FloatArray = slope[:, list(knowledge.model.indices)] * weight[:, None]
    return vectors


def depth_vectors(knowledge: Knowledge, field: Field, depths_mm: FloatArray) -> FloatArray:
    """Return d(z)/d(parameters) / z, shape (depths, directions, p).

    At each depth in those of the directions `ASKED_ACROSS` at which both cameras see the target;
    zero, and so left out of the mean, in the others.
    """
    p = len(knowledge.model.free)
    found = np.zeros((len(depths_mm), len(ASKED_ACROSS), p))
    for i, z in enumerate(depths_mm):
        x = field.across(np.array(ASKED_ACROSS))
        points = z * np.column_stack([x, np.full_like(x, field.level), np.ones_like(x)])
        seen = field.holds(knowledge.theta, points)
        if not seen.any():
            continue
        jacobian = depth_jacobian(knowledge.theta, gaze_at(knowledge.theta, points[seen]))
        slope = jacobian.by_theta[:, list(knowledge.model.indices)] / jacobian.z[:, None]
        # Scaled so that the sum over all directions is the mean over the seen ones.
        found[i, seen] = slope / np.sqrt(seen.sum())
    return found


def relative_variance(covariance: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the relative variance of depth, shape (depths,), that a covariance (p, p) leaves."""
    variance: FloatArray = np.einsum("kdi,ij,kdj->k", asked, covariance, asked)
    return variance


Criterion = Callable[[FloatArray, FloatArray], FloatArray]
"""Maps a covariance, (p, p), and row vectors, (m, p), to the value after each row, (m,)."""


def g_criterion(asked: FloatArray) -> Criterion:
    """Return the criterion: greatest relative variance over the asked depths, after each row."""

    def value(covariance: FloatArray, rows: FloatArray) -> FloatArray:
        carried = rows @ covariance
        gain = 1 + (carried * rows).sum(axis=1)
        # Sherman and Morrison: (M + g g^T)^-1 = C - C g g^T C / (1 + g^T C g).
        drop = np.einsum("kdi,mi->kdm", asked, carried) ** 2
        after = relative_variance(covariance, asked)[:, None] - drop.sum(axis=1) / gain
        greatest: FloatArray = after.max(axis=0)
        return greatest

    return value


def d_criterion(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return 1 / det(M) after each row, relative to that before."""
    gain: FloatArray = 1 / (1 + np.einsum("mi,ij,mj->m", rows, covariance, rows))
    return gain


def choose(
    information: FloatArray, candidates: FloatArray, criterion: Criterion, *, count: int
) -> IntArray:
    """Return the places of the chosen candidates, shape (count,), each as often as it is chosen.

    Ordered by what each adds to those before it: the first gains most.

    Parameters
    ----------
    information
        Before, shape (p, p), regular.
    candidates
        Row vectors, shape (m, p).
    """
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(_best(information, candidates, chosen, criterion)[0])
    for _ in range(EXCHANGES):
        exchanged = False
        for i in range(count):
            others = chosen[:i] + chosen[i + 1 :]
            place, value = _best(information, candidates, others, criterion)
            now = _value(information, candidates, others, chosen[i], criterion)
            if value < now * (1 - GAIN):
                chosen[i], exchanged = place, True
        if not exchanged:
            break
    return _ranked(information, candidates, chosen, criterion)


def _covariance(information: FloatArray, rows: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(information + rows.T @ rows), dtype=np.float64)


def _best(
    information: FloatArray, candidates: FloatArray, chosen: list[int], criterion: Criterion
) -> tuple[int, float]:
    """Return the candidate that gains most beside those chosen, and the value with it."""
    values = criterion(_covariance(information, candidates[chosen]), candidates)
    place = int(np.argmin(values))
    return place, float(values[place])


def _value(
    information: FloatArray,
    candidates: FloatArray,
    others: list[int],
    own: int,
    criterion: Criterion,
) -> float:
    covariance = _covariance(information, candidates[others])
    return float(criterion(covariance, candidates[own : own + 1])[0])


def _ranked(
    information: FloatArray, candidates: FloatArray, chosen: list[int], criterion: Criterion
) -> IntArray:
    """Return the chosen ones so that each gains most after those before it."""
    left, order = list(chosen), list[int]()
    while left:
        covariance = _covariance(information, candidates[order])
        order.append(left.pop(int(np.argmin(criterion(covariance, candidates[left])))))
    return np.array(order, dtype=np.int64)
