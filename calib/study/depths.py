"""Depths that a calibrated bench measures, by one model or by all together, against their truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibrated import CalibratedInstrument, tabulate_depths
from calib.study.rigs import StudiedRig
from calib.uncertainty.mixture import mix_depths
from calib.uncertainty.predictive import depth_draws, linear_positions

DRAWS = 4000
"""Draws of equal weight that an instrument gets, and of a predictive distribution: the ends of a
95 % interval are then known to 4 % of u, far below their scatter from rig to rig."""

GRID = 5
"""Depths of the table that `calib measure` has its coverage factor from; the chain takes 21."""

Record = dict[str, Any]


@dataclass(frozen=True)
class ModelDepths:
    """What one model says of the test readings, by part.

    Parameters
    ----------
    factor95
        Coverage factor of inverse depth.
    noise_factor
        By how much the stated uncertainties of a reading were widened.
    z_mm, u_mm
        Depths and their standard uncertainties by the linear law, shape (n,) each.
    below
        Share of the predictive distribution below the truth, shape (n,).
    """

    factor95: float
    noise_factor: float
    z_mm: Mapping[str, FloatArray]
    u_mm: Mapping[str, FloatArray]
    below: Mapping[str, FloatArray]


def model_depths(
    calibrated: CalibratedInstrument,
    bench: StudiedRig,
    for_depths: SeedSequence,
    table: SeedSequence,
) -> ModelDepths:
    """Return what an instrument says of the test readings of a bench."""
    low, high = calibrated.calibrated_mm
    tabulated = tabulate_depths(calibrated, low_mm=low, high_mm=high, seed=table, points=GRID)
    z, u, below = {}, {}, {}
    for part, rows in bench.tests.items():
        loadings = rows.shared[:, : OBSERVABLE.z] if rows.shared_names else None
        linear = linear_positions(calibrated.instrument, rows.gaze, loadings)
        z[part] = linear.position_mm[:, 2]
        u[part] = np.sqrt(linear.covariance_mm2[:, 2, 2])
        every = depth_draws(
            calibrated.instrument,
            rows.gaze,
            np.random.default_rng(for_depths),
            loadings=loadings,
            most=DRAWS,
        )
        truth = bench.true_depths_mm[part]
        below[part] = np.array([np.mean(d < t) for d, t in zip(every, truth, strict=True)])
    return ModelDepths(tabulated.factor95, calibrated.noise_factor, z, u, below)


def depth_record(
    weights: Sequence[float], models: Sequence[ModelDepths], bench: StudiedRig
) -> Record:
    """Return, by part: relative errors, uncertainties, and where the truth stands.

    Parameters
    ----------
    weights
        Of the models in the mixture, summing to 1; a single model has the weight 1.
    """
    share, factors = np.array(weights), np.array([model.factor95 for model in models])
    record: Record = {}
    for part, truth in bench.true_depths_mm.items():
        z = np.stack([model.z_mm[part] for model in models])
        u = np.stack([model.u_mm[part] for model in models])
        mixed = mix_depths(share, z, u, factors)
        record[part] = {
            "rank": share @ np.stack([model.below[part] for model in models]),
            "error_rel": mixed.z_mm / truth - 1,
            "u_rel": mixed.u_mm / mixed.z_mm,
            "measure95": ((mixed.low95_mm <= truth) & (truth <= mixed.high95_mm)).astype(float),
        }
    return record
