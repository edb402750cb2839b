"""Control charts of one quantity of a rig, standardised by its stated uncertainty.

The reference is the weighted mean of the calibrations at acceptance. Single deviations (Shewhart)
are from it, frozen. Its error is common to all of them: EWMA and CUSUM, which add deviations up,
would take it for a step and call one sound rig in eight out of control within ten calibrations
(five at acceptance, simulated), so that they add up recursive residuals instead, which are
independent whatever the reference's error (Quesenberry 1991, doi:10.1080/00224065.1991.11979327).
A small step after few calibrations at acceptance cannot be distinguished from that error. Limits
come from the stated uncertainties, not from the scatter of a few calibrations, which at the length
of such histories would call one sound rig in four out of control. Whether the stated
uncertainties may carry the limits is a test of its own: `scatter_test`.

Sources: Montgomery, Introduction to Statistical Quality Control, chapters 6 and 9; Lucas and
Saccucci (1990), doi:10.1080/00401706.1990.10484583.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calib.core.arrays import BoolArray, FloatArray

SHEWHART_LIMIT = 3.0
"""In units of the standard uncertainty: in-control average run length 370.4."""

EWMA_WEIGHT = 0.2
EWMA_LIMIT = 2.86
"""In units of the statistic's own standard deviation: in-control average run length about 370."""

CUSUM_ALLOWANCE = 0.5
CUSUM_LIMIT = 4.77
"""Two-sided, in units of the standard uncertainty: in-control average run length about 370."""

RUN_LENGTH = 370.0
"""Of each chart, in the mean, until it is outside by chance."""

UNCERTAINTY_RISK = 0.01
"""Chance that sound uncertainties are called too small by `scatter_test`."""


@dataclass(frozen=True)
class Chart:
    """One chart's statistic, its limit, and where it is outside.

    Parameters
    ----------
    name
        Shewhart, EWMA or CUSUM.
    statistic
        By calibration, shape (n,), in units of the limit's scale; for CUSUM the side farther out,
        with its sign.
    limit
        Of the absolute statistic.
    """

    name: str
    statistic: FloatArray
    limit: float

    @property
    def outside(self) -> BoolArray:
        """Where the statistic is outside the limits, shape (n,)."""
        found: BoolArray = np.abs(self.statistic) > self.limit
        return found

    @property
    def first_alarm(self) -> int | None:
        """Index of the first calibration outside the limits."""
        outside = np.flatnonzero(self.outside)
        return int(outside[0]) if len(outside) else None


@dataclass(frozen=True)
class Reference:
    """The value frozen at acceptance: weighted mean and its standard uncertainty."""

    value: float
    std: float


def reference(values: FloatArray, std: FloatArray) -> Reference:
    """Return the weighted mean of the accepted calibrations' values."""
    weight = 1 / std**2
    return Reference(float(weight @ values / weight.sum()), float(weight.sum() ** -0.5))


def standardised(values: FloatArray, std: FloatArray, at: Reference) -> FloatArray:
    """Return deviations from the reference in units of their standard uncertainty, shape (n,).

    The reference's own uncertainty is part of the unit. For calibrations after acceptance only:
    those that the reference was made from are correlated with it.
    """
    z: FloatArray = (values - at.value) / np.sqrt(std**2 + at.std**2)
    return z


def recursive_residuals(values: FloatArray, std: FloatArray, at: Reference) -> FloatArray:
    """Return deviations from the mean of all before, in units of their uncertainty, shape (n,).

    Independent and standard normal for a rig that has not changed: Quesenberry (1991), case of
    known variance and unknown mean, here with a variance of each value's own.
    """
    mean, variance = at.value, at.std**2
    found = np.empty(len(values))
    for i, (value, u) in enumerate(zip(values, std, strict=True)):
        total = variance + u**2
        found[i] = (value - mean) / np.sqrt(total)
        gain = variance / total
        mean += gain * (value - mean)
        variance *= 1 - gain
    return found


def shewhart(z: FloatArray) -> Chart:
    """Return the chart of single deviations, which sees large steps."""
    return Chart("Shewhart", z, SHEWHART_LIMIT)


def ewma(z: FloatArray) -> Chart:
    """Return the exponentially weighted moving average over its exact standard deviation.

    Lucas and Saccucci (1990), equations 1 and 3, with the limits that widen from the first value.
    """
    level, found = 0.0, np.empty(len(z))
    for i, value in enumerate(z):
        level = EWMA_WEIGHT * value + (1 - EWMA_WEIGHT) * level
        found[i] = level
    shrink = 1 - (1 - EWMA_WEIGHT) ** (2 * np.arange(1, len(z) + 1))
    return Chart("EWMA", found / np.sqrt(EWMA_WEIGHT / (2 - EWMA_WEIGHT) * shrink), EWMA_LIMIT)


def cusum(z: FloatArray) -> Chart:
    """Return the two-sided tabular cumulative sum, the side farther out with its sign."""
    up = down = 0.0
    found = np.empty(len(z))
    for i, value in enumerate(z):
        up = max(0.0, up + value - CUSUM_ALLOWANCE)
        down = max(0.0, down - value - CUSUM_ALLOWANCE)
        found[i] = up if up >= down else -down
    return Chart("CUSUM", found, CUSUM_LIMIT)


def charts(values: FloatArray, std: FloatArray, at: Reference) -> tuple[Chart, Chart, Chart]:
    """Return the three charts of the calibrations after acceptance, in time order."""
    independent = recursive_residuals(values, std, at)
    return shewhart(standardised(values, std, at)), ewma(independent), cusum(independent)


def scatter_test(values: FloatArray, std: FloatArray) -> tuple[float, float]:
    """Return chi-squared over its degrees of freedom, and the p of a scatter as large or larger.

    Of the calibrations about their weighted mean. A small p says that the stated uncertainties
    are too small or that the rig has changed; the charts tell the two apart by their order in time.

    Raises
    ------
    ValueError
        For fewer than two calibrations.
    """
    if len(values) < 2:
        raise ValueError("a scatter takes two calibrations")
    mean = reference(values, std).value
    square = float((((values - mean) / std) ** 2).sum())
    freedom = len(values) - 1
    return square / freedom, float(chdtrc(freedom, square))
