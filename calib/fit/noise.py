"""The noise of a row: effective variance, Student-t tails, one scale for all rows.

A row's misclosure F (see `calib.geometry.misclosure`) has, to first order, the variance of the
errors in x1c, y1c, alpha2, gaze residual and z carried through it (effective variance; Orear 1982,
doi 10.1119/1.12972). F / sigma then has unit spread if the stated uncertainties are right. Its
density is Student's t with scale ``s * core``: s is the noise scale, by which the stated
uncertainties are wrong.

Why t and not normal: one row in ten may be a gross error (a corner mistaken, a reading from the
wrong pose) and must not move the result. `ROBUST` tails find such rows. Once they are rejected
the rest is nearly normal, and `CLEAN` tails take it for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.misclosure import Misclosure, misclosure
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations


@dataclass(frozen=True)
class Tails:
    """The tails of the rows' Student-t density.

    Parameters
    ----------
    dof
        Degrees of freedom.
    core
        Scale of the t density that a unit normal sample takes, so that the noise scale of clean
        rows comes out as 1: E[(dof + 1) x² / (dof core² + x²)] = 1.
    efficiency
        Asymptotic efficiency of the estimator on normal rows, (E psi')² / E psi², at `core`.
    """

    dof: float
    core: float
    efficiency: float


ROBUST = Tails(5.0, 0.8566209142462032, 0.9188551355057069)
"""Holds out against up to one sixth of outliers; four degrees of freedom keep an efficiency of
0.89, eight hold out against one ninth only."""

CLEAN = Tails(15.0, 0.9419429283342325, 0.9837111726229334)
"""For rows none of which is named an outlier, or whose outliers are rejected: keeps nearly all of
a normal likelihood's efficiency, and still leaves a row four standard deviations off half of its
weight only."""

OUTLIER_FAMILY_RISK = 0.01
"""Chance that a clean table has any row named an outlier, if its noise is normal."""

OUTLIER_FLOOR = 3.5
"""No row nearer than this many standard deviations is named, however few the rows."""

SPARE_FREEDOM = 6.0
"""Degrees of freedom that must be left to the noise scale before outliers are rejected: with fewer
a tight but wrong fit of some rows could turn the honest others out."""

KEPT_SHARE = 2 / 3
"""Least share of rows that is kept: of 14 rows, one in ten an outlier, fewer are left one time in
a hundred; where more disagree, who is the outlier is no longer plain."""


LOG_SCALE_LIMIT = 100.0
"""Noise scales beyond exp of this are taken as this, so that their squares do not overflow; the
prior has ruled them out long before."""


@dataclass(frozen=True)
class RowNoise:
    """How uncertain the misclosure of each row is as stated.

    Parameters
    ----------
    sigma
        Standard uncertainty of F, shape (n,).
    per_angle
        |dF / d(alpha2)|, shape (n,): sigma / per_angle is the row's noise as an angle, rad.
    """

    sigma: FloatArray
    per_angle: FloatArray


def row_noise(theta: FloatArray, rows: Observations) -> RowNoise:
    """Return the noise of rows at parameters `theta`, shape (COUNT,)."""
    c = misclosure(theta, rows.gaze, rows.z_mm, parameters=())
    return RowNoise(own_sigma(c, rows.std), np.abs(c.by_observable[:, OBSERVABLE.alpha2]))


def own_sigma(c: Misclosure, std: FloatArray) -> FloatArray:
    """Return the standard uncertainties of closures, shape (n,), from those of `Observations`."""
    # One quantity after the other: summing five numbers a row takes four times as long.
    carried = np.multiply(c.by_observable.T, std.T, order="C")
    sigma: FloatArray = np.sqrt((carried**2).sum(axis=0))
    return sigma


def log_density(
    standardised: FloatArray, log_scale: FloatArray | float, tails: Tails = ROBUST
) -> FloatArray:
    """Return the log density of F / sigma, same shape, for noise scales exp(`log_scale`)."""
    half = (tails.dof + 1) / 2
    norm = gammaln(half) - gammaln(tails.dof / 2) - 0.5 * np.log(tails.dof * np.pi)
    shrunk = np.exp(-2 * np.clip(log_scale, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT))
    square = (standardised / tails.core) ** 2 * shrunk
    density: FloatArray = (
        norm - np.log(tails.core) - log_scale - half * np.log1p(square / tails.dof)
    )
    return density


def weight(standardised: FloatArray, scale: float, tails: Tails) -> FloatArray:
    """Return the weight that the t density leaves a row, 1 + 1 / dof at zero, falling to 0."""
    square = (standardised / (tails.core * scale)) ** 2
    result: FloatArray = (tails.dof + 1) / (tails.dof + square)
    return result


def is_outlier(standardised: FloatArray, scale: float) -> BoolArray:
    """Return which rows disagree with the others, shape (n,)."""
    outlier: BoolArray = np.abs(standardised) > outlier_limit(len(standardised)) * scale
    return outlier


def outlier_limit(rows: int) -> float:
    """Return how many standard deviations make an outlier of a row, one of so many."""
    return max(OUTLIER_FLOOR, -float(ndtri(OUTLIER_FAMILY_RISK / 2 / rows)))


def reject_outliers(standardised: FloatArray, scale: float, *, parameters: float) -> BoolArray:
    """Return which rows are left out of noise scale and posterior, shape (n,).

    The t density keeps outliers from moving the estimate, but each still tells it that the noise is
    large: with one row in ten the scale comes out half as large again, and with it every interval.
    Rows named as outliers are therefore rejected where enough others remain.

    Parameters
    ----------
    parameters
        Effective number of parameters that the rows decide.
    """
    outlier = is_outlier(standardised, scale)
    kept = len(outlier) - int(outlier.sum())
    if kept - parameters < SPARE_FREEDOM or kept < KEPT_SHARE * len(outlier):
        return np.zeros(len(outlier), dtype=np.bool_)
    return outlier
