"""The parameters that report, terminal and drawing state first: of the instrument of record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.instrument.adjusted import ADJUSTMENT
from calib.results.calibration import GazeResult
from calib.results.effective_baseline import effective_baseline, effective_interval
from calib.uncertainty.montecarlo import NORMAL_FACTOR


@dataclass(frozen=True)
class Headline:
    """Parameters of record.

    Parameters
    ----------
    model
        Of the rows, or of the adjustment.
    by_adjustment
        Whether they are of the adjustment of all pictures.
    names, values, covariance
        Free parameters, shapes (p,) and (p, p).
    effective, effective95
        L_b + e with its standard uncertainty, and its 95 % interval, mm; None without eccentricity.
    """

    model: str
    by_adjustment: bool
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    effective: tuple[float, float] | None
    effective95: tuple[float, float] | None


def headline(gaze: GazeResult) -> Headline | None:
    """Return the parameters of record; None where no model was selected."""
    if gaze.comparison is None or gaze.calibrated is None:
        return None
    if gaze.choice is not None and gaze.choice.method == ADJUSTMENT:
        p = gaze.calibrated.instrument.parameters
        found = effective_baseline(p.names, p.values, p.covariance)
        ends = None if found is None else normal_interval(*found)
        return Headline(gaze.calibrated.model, True, p.names, p.values, p.covariance, found, ends)
    posterior = gaze.posterior[gaze.comparison.selected]
    names, values = posterior.names[:-1], posterior.mean[:-1]
    covariance = posterior.covariance[:-1, :-1]
    found = effective_baseline(names, values, covariance)
    ends = effective_interval(names, posterior.flat)
    return Headline(posterior.model, False, names, np.asarray(values), covariance, found, ends)


def normal_interval(value: float, std: float) -> tuple[float, float]:
    """Return the 95 % interval of a normal quantity."""
    return value - NORMAL_FACTOR * std, value + NORMAL_FACTOR * std
