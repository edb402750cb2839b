"""Depths that several models measure, as one distribution: a mixture with a weight each.

Each model's inverse depth is nearly normal, with the coverage factor that its own Monte Carlo draws
ask for. The interval's ends are quantiles of the mixture; its variance is that within the models
and that between them (Hoeting et al. 1999, doi 10.1214/ss/1009212519, eq. 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.uncertainty.montecarlo import NORMAL_FACTOR

CLEARLY_LONGER = 1.25
"""Intervals of all models over those of one, from which on the doubt about the model matters: if
the longer cover 95 %, the shorter cover 88 %."""

HALVINGS = 60
"""Of the bracket around a quantile, some ten standard deviations wide: to rounding."""

BRACKET = 6.0
"""Standard deviations beyond all models' means that the bracket begins with: a 95 % interval of any
mixture of normals lies within 1.96."""


@dataclass(frozen=True)
class MixedDepths:
    """Depths by all models; arrays of shape (n,), mm.

    Parameters
    ----------
    z_mm, u_mm
        Mean and standard deviation of the mixture.
    low95_mm, high95_mm
        Its 2.5 and 97.5 % quantiles; the latter infinite where a reading does not limit the depth.
    """

    z_mm: FloatArray
    u_mm: FloatArray
    low95_mm: FloatArray
    high95_mm: FloatArray


def mix_depths(
    weights: FloatArray, z: FloatArray, u: FloatArray, factor95: FloatArray
) -> MixedDepths:
    """Return the mixture of the depths that models measure of the same readings.

    Parameters
    ----------
    weights
        Sum to 1, shape (models,).
    z, u
        Depths and standard uncertainties, mm, shape (models, n).
    factor95
        Coverage factors of inverse depth, shape (models,).
    """
    mean, variance = mix_moments(weights, z, u**2)
    spread = factor95[:, None] / NORMAL_FACTOR * u / z**2
    if len(weights) == 1:
        half = NORMAL_FACTOR * spread[0]
        near, far = 1 / z[0] + half, 1 / z[0] - half
    else:
        near, far = (_quantile(weights, 1 / z, spread, level) for level in (0.975, 0.025))
    with np.errstate(divide="ignore"):
        high = np.where(far > 0, 1 / far, np.inf)
    return MixedDepths(z_mm=mean, u_mm=np.sqrt(variance), low95_mm=1 / near, high95_mm=high)


def mix_moments(
    weights: FloatArray, mean: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance of mixtures, shape (...), of components, shape (models, ...)."""
    middle: FloatArray = np.tensordot(weights, mean, axes=1)
    total: FloatArray = np.tensordot(weights, variance + (mean - middle) ** 2, axes=1)
    return middle, total


def inverse_length(low95_mm: FloatArray, high95_mm: FloatArray) -> FloatArray:
    """Return the lengths of intervals of inverse depth, which are always finite, 1/mm."""
    length: FloatArray = 1 / low95_mm - 1 / high95_mm
    return length


def _quantile(
    weights: FloatArray, mean: FloatArray, spread: FloatArray, level: float
) -> FloatArray:
    """Return a quantile, shape (n,), of mixtures of normals, shape (models, n), by bisection."""
    from scipy.special import ndtr  # takes as long as all else that measuring imports

    low = (mean - BRACKET * spread).min(axis=0)
    high = (mean + BRACKET * spread).max(axis=0)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = np.tensordot(weights, ndtr((middle - mean) / spread), axes=1) < level
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    quantile: FloatArray = (low + high) / 2
    return quantile
