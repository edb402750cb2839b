"""Default priors of a rig much larger or smaller than those that they were made for.

Their lengths (axis offset, eccentricity, standoff) are those of rigs of `BASELINES_MM`. A rig ten
times as large has ten times the offsets, and absolute priors would hold them against its rows.
"""

from __future__ import annotations

import numpy as np

from calib.core.errors import EstimationError
from calib.fit.start import find_start
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.rows.observations import Observations

BASELINES_MM = (60.0, 400.0)
"""Within these the default priors stand as they are: of the 77 mm of Xu and Wang and what one
tripod bar carries. Below, they shrink with the baseline. From twice the larger on they have the
same part of the baseline as at the smaller (the axis a third of it): how well a large rig is built
nobody knows beforehand, and a prior too wide only costs width."""

LARGEST_FACTOR = 100.0


def scaled_defaults(rows: Observations) -> dict[str, tuple[float, float]]:
    """Return default priors in mm, mean and standard deviation, scaled; none for a usual rig.

    The baseline is that of the search for a start, before any prior. It only says how large the rig
    is: two figures of it count. What `reference_offset_mm` stands for, the depth of lenses and
    flanges, does not grow with the rig.
    """
    try:
        start = find_start(rows, axis_z=True)
    except EstimationError:
        return {}
    factor = _factor(abs(float(start[INDEX["baseline_mm"]])))
    if factor == 1:
        return {}
    return {
        p.name: (0.0, factor * p.prior_std)
        for p in PARAMETERS
        if p.unit == "mm" and p.prior_std is not None and p.name != REFERENCE_OFFSET
    }


def _factor(baseline_mm: float) -> float:
    low, high = BASELINES_MM
    if baseline_mm <= low:
        factor = baseline_mm / low
    else:
        # From 400 to 800 mm, in between: no jump where a rig is a little larger.
        share = np.clip(np.log2(baseline_mm / high), 0, 1)
        factor = (baseline_mm / low) ** share
    return float(f"{np.clip(factor, 1 / LARGEST_FACTOR, LARGEST_FACTOR):.2g}")
