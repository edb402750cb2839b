"""L_b + e, the baseline seen at 90 deg: the rows know it best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import ECCENTRICITY


def effective_baseline(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> tuple[float, float] | None:
    """Return L_b + e, the baseline seen at 90 deg, with its standard deviation, mm.

    None for models without eccentricity.
    """
    if ECCENTRICITY not in names:
        return None
    pick = np.array([name in ("baseline_mm", ECCENTRICITY) for name in names], dtype=float)
    return float(pick @ values), float(np.sqrt(pick @ covariance @ pick))


def effective_interval(names: Sequence[str], draws: FloatArray) -> tuple[float, float] | None:
    """Return the 95 % interval of L_b + e, mm, with equal tails.

    None for models without eccentricity.

    Parameters
    ----------
    draws
        Of the parameters `names`, shape (m, k) or more columns.
    """
    if ECCENTRICITY not in names:
        return None
    total = draws[:, names.index("baseline_mm")] + draws[:, names.index(ECCENTRICITY)]
    low, high = np.quantile(total, [0.025, 0.975])
    return float(low), float(high)
