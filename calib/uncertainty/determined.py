"""The parameters in the combinations that a calibration determines, for the budget.

Parameters of one fit are often known far less well than what follows from them: a baseline to
10 mm and an eccentricity to 10 mm, but their sum to 0.4 mm. A budget in the parameters then lists
shares of ten thousands of per cent that cancel: true, and of no use to who reads it. It is
therefore made in quantities that are independent of each other: the effective baseline at the mean
gaze, L_b + e / sin(α), which the rows determine best; then, in the order of `PARAMETERS`, what
remains uncertain of each parameter once the quantities before it are known, the eccentricity in
place of what it adds to the effective baseline. Where C is the covariance of the parameters and q
their linear combinations, that is C = L D Lᵀ in q, with unit lower triangular L and diagonal D
(conditional distributions of a normal one; JCGM 102, 3.21 gives the covariance). The sensitivity to
such a quantity is the derivative of the result along it: those after it follow as they are
correlated with it. Shares then lie between 0 and 100 % and add up to that of the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import ECCENTRICITY, GAZED_BASELINE, INDEX, PARAMETERS

_BASELINE = "baseline_mm"

NOTHING_LEFT = 1e-12
"""A conditional variance below this share of the variance is a rounding error, and none."""


@dataclass(frozen=True)
class Determined:
    """Independent quantities in place of k parameters.

    Parameters
    ----------
    names
        Of the parameters, or `GAZED_BASELINE` in place of the baseline, length k.
    units
        "mm", "rad" or "1", length k.
    estimates
        Shape (k,).
    std
        What remains uncertain of each once those before it are known, shape (k,).
    to_parameters
        Change of each parameter per unit of each quantity, shape (k, k).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    estimates: FloatArray
    std: FloatArray
    to_parameters: FloatArray


def determined(
    names: Sequence[str], values: FloatArray, covariance: FloatArray, *, mean_gaze_rad: float
) -> Determined:
    """Return the independent quantities of parameters.

    Parameters
    ----------
    names, values, covariance
        The k parameters, in the order of `PARAMETERS`; shapes (k,) and (k, k).
    mean_gaze_rad
        Reading at which the effective baseline is taken.
    """
    k = len(names)
    combine = np.eye(k)
    shown = list(names)
    if _BASELINE in names and ECCENTRICITY in names:
        first, other = names.index(_BASELINE), names.index(ECCENTRICITY)
        combine[first, other] = 1 / math.sin(mean_gaze_rad)
        shown[first] = GAZED_BASELINE
    variance, lower = _factors(combine @ covariance @ combine.T)
    return Determined(
        names=tuple(shown),
        units=tuple(PARAMETERS[INDEX[name]].unit for name in names),
        estimates=combine @ values,
        std=np.sqrt(variance),
        to_parameters=np.asarray(np.linalg.solve(combine, lower), dtype=np.float64),
    )


def _factors(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return D, shape (k,), and unit lower triangular L, (k, k), with covariance = L diag(D) Lᵀ."""
    k = len(covariance)
    lower, variance = np.eye(k), np.zeros(k)
    rest = np.array(covariance, dtype=float)
    for i in range(k):
        if rest[i, i] <= NOTHING_LEFT * covariance[i, i]:
            continue
        variance[i] = rest[i, i]
        lower[i + 1 :, i] = rest[i + 1 :, i] / rest[i, i]
        rest -= np.outer(lower[:, i] * (np.arange(k) >= i), rest[i])
    return variance, lower
