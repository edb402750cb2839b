"""When a rig is due for its next calibration.

ILAC-G24:2022 / OIML D 10, method 2 (control chart) where there are calibrations enough: drift as a
random walk whose rate has a prior and is integrated over; the date is that at which the chance of
having left the tolerance reaches `RISK`. With fewer, method 1 (staircase), which never extends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, ndtr

from calib.core.arrays import FloatArray

RISK = 0.05
"""Chance of being out of tolerance at the due date."""

LONGEST = 1.5
"""Cap, in last intervals: a longer one would be extrapolation that no calibration has checked."""

FEWEST = 3
"""Calibrations for the random walk: with two the prior alone would decide."""

STAIRCASE_STEP = 0.5
"""Factor of the interval after a calibration found out of tolerance."""

RATE_PRIOR = np.log(0.1), 1.5
"""Mean and standard deviation of the log variance of drift over one typical interval, in u^2: a
rig whose drift between calibrations is a third of their uncertainty, within a factor 4.5 (95 % a
factor 19 in standard deviation)."""

JUMPS = 0.05
"""Chance of a jump in a typical interval: a knock, a slipped coupling."""

JUMP_STD = 4.0
"""Standard deviation of a jump, in u: it is to be larger than chance, or it would not be one."""

_RATES = np.linspace(-12.0, 6.0, 181)
_HORIZONS = 400


@dataclass(frozen=True)
class Due:
    """The next calibration.

    Parameters
    ----------
    interval
        Time from the last calibration, days.
    method
        Of ILAC-G24 / OIML D 10, by name.
    risk
        Chance of being out of tolerance then; None where the method gives none.
    capped
        Whether the cap decided.
    """

    interval: float
    method: str
    risk: float | None
    capped: bool


RANDOM_WALK = (
    "method 2 (control chart): drift as a random walk with a prior on its rate, rare jumps"
)
STAIRCASE = "method 1 (staircase)"


def next_due(days: FloatArray, values: FloatArray, std: FloatArray, *, tolerance: float) -> Due:
    """Return the next calibration of a rig that is adjusted to each calibration's estimate.

    Parameters
    ----------
    days
        Times of the calibrations since the last repair, strictly increasing, shape (n,), n >= 2.
    values, std
        Of the quantity with a tolerance, and its standard uncertainties, shape (n,).
    tolerance
        Largest tolerated departure from the state estimated at the last calibration, in the unit
        of the values.

    Raises
    ------
    ValueError
        If there are fewer than two calibrations, or their times do not increase.
    """
    if len(days) < 2 or np.any(np.diff(days) <= 0):
        raise ValueError("give two calibrations or more, their times increasing")
    last = float(days[-1] - days[-2])
    if len(days) < FEWEST:
        kept = abs(values[-1] - values[-2]) <= tolerance
        return Due(last if kept else STAIRCASE_STEP * last, STAIRCASE, None, capped=False)
    log_weight, mean, variance, rate = _filtered(days, values, std)
    weight = np.exp(log_weight - logsumexp(log_weight))
    centre = float(weight @ mean)
    horizon = np.linspace(0.0, LONGEST * last, _HORIZONS + 1)
    drifted = variance[:, None] + rate[:, None] * horizon
    away = (mean - centre)[:, None]
    jumped = _chance_of_jump(horizon, days)
    outside = (1 - jumped) * (weight @ _outside(tolerance, away, drifted))
    jump = (JUMP_STD * float(np.median(std))) ** 2
    outside += jumped * (weight @ _outside(tolerance, away, drifted + jump))
    kept_until = int(np.searchsorted(outside, RISK, side="right")) - 1
    if kept_until < 0:
        return Due(0.0, RANDOM_WALK, float(outside[0]), capped=False)
    capped = kept_until == _HORIZONS
    return Due(float(horizon[kept_until]), RANDOM_WALK, float(outside[kept_until]), capped=capped)


def _outside(tolerance: float, away: FloatArray, variance: FloatArray) -> FloatArray:
    spread = np.sqrt(variance)
    found: FloatArray = ndtr((away - tolerance) / spread) + ndtr((-tolerance - away) / spread)
    return found


def _chance_of_jump(time: FloatArray, days: FloatArray) -> FloatArray:
    typical = float(np.median(np.diff(days)))
    found: FloatArray = 1 - (1 - JUMPS) ** (time / typical)
    return found


def _filtered(
    days: FloatArray, values: FloatArray, std: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return log posterior weight, state mean, state variance and rate, each by rate of drift.

    A scalar Kalman filter for each rate of the grid, started at the first calibration. Whether the
    rig jumped in an interval is a mixture of two, merged to its mean and variance after each
    (generalised pseudo-Bayes of first order: Bar-Shalom, Li and Kirubarajan, Estimation with
    Applications to Tracking and Navigation, 2001, section 11.6.3).
    """
    u2 = float(np.median(std)) ** 2
    rate = np.exp(_RATES) * u2 / float(np.median(np.diff(days)))
    mean = np.full(len(rate), values[0])
    variance = np.full(len(rate), std[0] ** 2)
    score = -0.5 * ((_RATES - RATE_PRIOR[0]) / RATE_PRIOR[1]) ** 2
    jumped = _chance_of_jump(np.diff(days), days)
    for step, chance, value, u in zip(np.diff(days), jumped, values[1:], std[1:], strict=True):
        innovation = value - mean
        # Without and with a jump, shape (2, rates).
        before = np.stack([variance + rate * step, variance + rate * step + JUMP_STD**2 * u2])
        total = before + u**2
        log = np.log([[1 - chance], [chance]]) - 0.5 * (np.log(total) + innovation**2 / total)
        each = logsumexp(log, axis=0)
        share = np.exp(log - each)
        gain = before / total
        means = mean + gain * innovation
        score = score + each
        mean = (share * means).sum(axis=0)
        variance = (share * (before * (1 - gain) + (means - mean) ** 2)).sum(axis=0)
    return score, mean, variance, rate
