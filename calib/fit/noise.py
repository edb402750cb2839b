"""The noise of a row: effective variance, Student-t tails, one scale for all rows.

A row's closure F (see `calib.geometry.plane.closure`) has, to first order, the variance of the
errors in x1c, y1c, alpha2, gaze residual and z carried through it (effective variance; Orear 1982,
doi 10.1119/1.12972). F / sigma then has unit spread if the stated uncertainties are right. Its
density is Student's t with `DOF` degrees of freedom and scale ``s * CORE``: s is the noise scale,
by which the stated uncertainties are wrong.

Why t and not normal: one row in ten may be a gross error (a corner mistaken, a reading from the
wrong pose) and must not move the result. Five degrees of freedom keep 92 % of the normal
estimator's efficiency on clean rows and a scale that holds out against up to one sixth of outliers;
four keep 89 %, eight hold out against one ninth only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import norm

from calib.arrays import BoolArray, FloatArray
from calib.geometry.plane import OBSERVABLE, closure
from calib.observations import Observations

DOF = 5.0
"""Degrees of freedom of the rows' Student-t density."""

CORE = 0.8566209142462032
"""Scale of the t density that a unit normal sample takes: E[(DOF + 1) x² / (DOF c² + x²)] = 1.

With it the noise scale of clean rows comes out as 1.
"""

EFFICIENCY = 0.9188551355057069
"""Asymptotic efficiency of the t estimator on normal rows, (E psi')² / E psi², at `CORE`."""

OUTLIER_FAMILY_RISK = 0.01
"""Chance that a clean table has any row named an outlier, if its noise is normal."""

OUTLIER_FLOOR = 3.5
"""No row nearer than this many standard deviations is named, however few the rows."""

_LOG_NORM = float(
    gammaln((DOF + 1) / 2) - gammaln(DOF / 2) - 0.5 * np.log(DOF * np.pi) - np.log(CORE)
)

SPARE_FREEDOM = 6.0
"""Degrees of freedom that must be left to the noise scale before outliers are set aside: with fewer
a tight but wrong fit of some rows could turn the honest others out."""

KEPT_SHARE = 2 / 3
"""Least share of rows that is kept: of 14 rows, one in ten an outlier, fewer are left one time in
a hundred; where more disagree, who is the outlier is no longer plain."""


@dataclass(frozen=True)
class RowNoise:
    """How uncertain the closure of each row is as stated.

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
    slope = closure(theta, rows.gaze, rows.z_mm, parameters=()).by_observable
    sigma = np.sqrt(((slope * rows.std) ** 2).sum(axis=1))
    return RowNoise(sigma, np.abs(slope[:, OBSERVABLE.alpha2]))


def log_density(standardised: FloatArray, log_scale: FloatArray | float) -> FloatArray:
    """Return the log density of F / sigma, same shape, for noise scales exp(`log_scale`)."""
    square = (standardised / CORE) ** 2 * np.exp(-2 * np.asarray(log_scale))
    density: FloatArray = _LOG_NORM - log_scale - (DOF + 1) / 2 * np.log1p(square / DOF)
    return density


def weight(standardised: FloatArray, scale: float) -> FloatArray:
    """Return the weight that the t density leaves a row, 1 + 1 / DOF at zero, falling to 0."""
    square = (standardised / (CORE * scale)) ** 2
    result: FloatArray = (DOF + 1) / (DOF + square)
    return result


def is_outlier(standardised: FloatArray, scale: float) -> BoolArray:
    """Return which rows disagree with the others, shape (n,)."""
    limit = max(OUTLIER_FLOOR, float(norm.isf(OUTLIER_FAMILY_RISK / 2 / len(standardised))))
    outlier: BoolArray = np.abs(standardised) > limit * scale
    return outlier


def set_aside(standardised: FloatArray, scale: float, *, parameters: float) -> BoolArray:
    """Return which rows are left out of noise scale and posterior, shape (n,).

    The t density keeps outliers from moving the estimate, but each still tells it that the noise is
    large: with one row in ten the scale comes out half as large again, and with it every interval.
    Rows named as outliers are therefore set aside where enough others remain.

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
