"""The instrument as all fitted models describe it, each with its weight (model averaging)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.fit.compare import Comparison
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.plane import gaze_at
from calib.instrument.calibrated import (
    CalibratedInstrument,
    DepthTable,
    build_instrument,
    tabulate_depths,
)
from calib.rows.from_table import Setup
from calib.rows.observations import Observations
from calib.uncertainty.measurement import Instrument, ModelShare
from calib.uncertainty.mixture import CLEARLY_LONGER, MixedDepths, inverse_length, mix_depths
from calib.uncertainty.predictive import linear_positions

FACTOR_POINTS = 9
"""Depths that a model's coverage factor is from: it changes slowly with depth."""


@dataclass(frozen=True)
class ModelAverage:
    """The average over the fitted models.

    Parameters
    ----------
    shares
        One a model.
    depth_mm
        Depths of the selected model's table, shape (n,).
    prediction
        What all models together say of readings there.
    """

    shares: tuple[ModelShare, ...]
    depth_mm: FloatArray
    prediction: MixedDepths


def build_average(
    posteriors: Mapping[str, Posterior],
    fits: Mapping[str, RobustFit],
    comparison: Comparison,
    rows: Observations,
    setup: Setup,
    selected: CalibratedInstrument,
    table: DepthTable,
    *,
    seed: SeedSequence,
) -> ModelAverage:
    """Return the average over the models that were compared.

    Parameters
    ----------
    selected, table
        The instrument of the selected model, at whose readings the depths are tabulated.
    """
    shares = []
    for score, child in zip(comparison.scores, seed.spawn(len(comparison.scores)), strict=True):
        name = score.model
        calibrated = build_instrument(posteriors[name], fits[name], rows, setup)
        shares.append(share_of(calibrated, weight=score.averaging_weight, seed=child))
    return ModelAverage(tuple(shares), table.depth_mm, _tabulated(shares, selected, table.depth_mm))


def share_of(
    calibrated: CalibratedInstrument,
    *,
    weight: float,
    seed: SeedSequence,
    points: int = FACTOR_POINTS,
) -> ModelShare:
    """Return a model's share, its coverage factor from `points` depths."""
    low, high = calibrated.calibrated_mm
    table = tabulate_depths(calibrated, low_mm=low, high_mm=high, seed=seed, points=points)
    return ModelShare(
        model=calibrated.model,
        weight=weight,
        instrument=without_draws(calibrated.instrument),
        noise_factor=calibrated.noise_factor,
        factor95=table.factor95,
    )


def doubt_of(average: ModelAverage, table: DepthTable) -> str | None:
    """Return a warning where the average's intervals are clearly longer than those of `table`."""
    ours, all_of_them = (
        inverse_length(p.low95_mm, p.high95_mm) for p in (table.prediction, average.prediction)
    )
    ratio = float((all_of_them / ours)[~table.extrapolated].max(initial=0.0))
    if not ratio > CLEARLY_LONGER:
        return None
    parts = (f"{share.model} {share.weight:.2f}" for share in average.shares)
    return (
        f"the rows leave open which model is right (weights: {', '.join(parts)}): averaged over "
        f"all of them 95 % intervals of depth are up to {ratio:.1f} times as long; "
        "calib measure --model average states them"
    )


def without_draws(instrument: Instrument) -> Instrument:
    """Return an instrument by means and covariances alone."""
    shared = instrument.shared
    return replace(
        instrument,
        parameters=replace(instrument.parameters, draws=None),
        shared=None if shared is None else replace(shared, own_draws=None),
    )


def _tabulated(
    shares: list[ModelShare], selected: CalibratedInstrument, depth_mm: FloatArray
) -> MixedDepths:
    """Return the mixture for targets on C1's optical axis, as the selected model gazes at them."""
    targets = np.stack([np.zeros_like(depth_mm), np.zeros_like(depth_mm), depth_mm], axis=1)
    gaze = gaze_at(selected.instrument.theta, targets)
    loadings = selected.loadings(gaze)
    found = [linear_positions(share.instrument, gaze, loadings) for share in shares]
    return mix_depths(
        np.array([share.weight for share in shares]),
        np.stack([one.position_mm[:, 2] for one in found]),
        np.stack([np.sqrt(one.covariance_mm2[:, 2, 2]) for one in found]),
        np.array([share.factor95 for share in shares]),
    )
