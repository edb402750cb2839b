"""Whether rows of a group err together though nothing was stated of it.

If they do, the groups' means of the residuals scatter more than the residuals within groups lead to
expect: one-way analysis of variance with random effects (Searle, Casella and McCulloch, Variance
Components, 1992). The fit has taken away part of either scatter, as many degrees of freedom as the
trace of its hat matrix in the space of the means and beside it: with these the ratio is nearly
distributed as F. Errors that all rows share, and that are stated, count in the means' covariance. A
level for each group, fitted with the parameters, would not do: within a group these would follow
the errors of the readings, as the derivatives by them contain readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from calib.core.arrays import FloatArray, IntArray
from calib.core.unit_diagonal import Spectrum
from calib.fit.information import kept
from calib.fit.noise import own_sigma
from calib.fit.robust import RobustFit
from calib.geometry.misclosure import misclosure
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations

LEAST_GROUPS = 3
"""Groups of two rows or more: two could differ for any reason."""

RARELY = 0.001
"""Probability of a warning without cause; rigs whose errors are not quite normal included, fewer
than one in 500."""


@dataclass(frozen=True)
class GroupCheck:
    """Whether rows of a group err together.

    Parameters
    ----------
    groups, rows
        Looked at: groups of two rows or more, of which no shared error is stated, and their rows.
    probability
        Of such scatter of the groups if rows are independent; 1 where it could not be tested.
    u_z_rel
        Standard deviation of a common error of a group's reference depths, relative to z, that
        would explain it.
    """

    groups: int
    rows: int
    probability: float
    u_z_rel: float

    @property
    def together(self) -> bool:
        """Whether they do."""
        return self.probability < RARELY


def check_groups(rows: Observations, fit: RobustFit) -> GroupCheck:
    """Return whether the residuals of a fit say that rows of a group err together."""
    chosen, label = _looked_at(rows, fit)
    count = int(label.max(initial=-1)) + 1
    if count < LEAST_GROUPS:
        return GroupCheck(count, len(chosen), 1.0, 0.0)
    some = rows.take(chosen)
    c = misclosure(fit.theta, some.gaze, some.z_mm, parameters=fit.structure.indices)
    weight = 1 / (own_sigma(c, some.std) * fit.noise_scale)
    own = Spectrum.of(fit.covariance - fit.by_shared @ fit.by_shared.T)
    slope = weight[:, None] * (c.by_theta @ own.root())
    shared = np.zeros((len(some), 0))
    if some.shared_names:
        moved = c.by_theta @ fit.by_shared[:, : len(some.shared_names)]
        push = np.einsum("nq,nqk->nk", c.by_observable, some.shared)
        shared = weight[:, None] * (push + moved)
    depth = weight * c.by_observable[:, OBSERVABLE.z] * some.z_mm
    return _compared(_Parts(weight * c.value, slope, shared, depth, label), fit.tails.efficiency)


def _looked_at(rows: Observations, fit: RobustFit) -> tuple[IntArray, IntArray]:
    """Return the places of rows in groups of two or more, and the group's number of each."""
    open_to = kept(rows, fit)
    if rows.has_groups:
        open_to = open_to & (rows.u_z_group_mm == 0)
    number: dict[str, int] = {}
    label = np.array([number.setdefault(g, len(number)) for g in rows.groups], dtype=np.int64)
    size = np.bincount(label[open_to], minlength=len(number))
    chosen = np.flatnonzero(open_to & (size[label] > 1))
    return chosen, np.unique(label[chosen], return_inverse=True)[1].ravel()


@dataclass(frozen=True)
class _Parts:
    """Rows in units of their noise.

    Parameters
    ----------
    residual
        Shape (n,).
    slope
        Change by one standard deviation of each of the parameters, made independent, (n, p).
    shared
        Change by one unit of each shared error, by way of the parameters too, shape (n, k).
    depth
        Change by the relative error of the depth, shape (n,).
    label
        Group of each row, from 0, shape (n,).
    """

    residual: FloatArray
    slope: FloatArray
    shared: FloatArray
    depth: FloatArray
    label: IntArray


def _compared(parts: _Parts, efficiency: float) -> GroupCheck:
    """Return the outcome; `efficiency` is that with which the fit has heard the rows."""
    n, groups = len(parts.residual), int(parts.label.max()) + 1
    means = [_level(x, parts.label) for x in (parts.residual[:, None], parts.slope, parts.shared)]
    residual, slope, shared = means
    hat = efficiency * (slope.T @ slope)
    followed = float(np.trace(hat))
    beside = efficiency * float((parts.slope**2).sum()) - followed
    between, within = groups - followed, n - groups - beside
    if between < 1 or within < 1:
        return GroupCheck(groups, n, 1.0, 0.0)
    scatter = float((residual**2).sum())
    noise = (float(parts.residual @ parts.residual) - scatter) / within
    if noise <= 0:
        return GroupCheck(groups, n, 1.0, 0.0)
    along = (shared.T @ residual)[:, 0]
    scatter -= float(along @ np.linalg.solve(noise * np.eye(len(along)) + shared.T @ shared, along))
    # What is left of a group's error once the fit has followed it.
    rest = 1 - 2 * efficiency * (slope**2).sum(axis=1)
    rest += efficiency * np.einsum("ki,ij,kj->k", slope, hat, slope)
    told = float(_level(parts.depth[:, None], parts.label)[:, 0] ** 2 @ rest)
    excess = scatter - between * noise
    return GroupCheck(
        groups=groups,
        rows=n,
        probability=float(fdtrc(between, within, scatter / between / noise)),
        u_z_rel=float(np.sqrt(excess / told)) if excess > 0 and told > 0 else 0.0,
    )


def _level(values: FloatArray, label: IntArray) -> FloatArray:
    """Return means over groups times the root of their sizes, (groups, k), of values (n, k)."""
    size = np.bincount(label)
    total = np.zeros((len(size), values.shape[1]))
    np.add.at(total, label, values)
    level: FloatArray = total / np.sqrt(size)[:, None]
    return level
