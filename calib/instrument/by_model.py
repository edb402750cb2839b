"""Measuring with all models of a calibration together, each with its weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.dataset.tables import GazeTable
from calib.instrument.calibration_file import Measuring
from calib.instrument.measuring import Measured, Positions, measure
from calib.rows.from_table import ImageObservations
from calib.uncertainty.mixture import CLEARLY_LONGER, inverse_length, mix_depths, mix_moments

SELECTED, AVERAGE = "selected", "average"
"""Names that stand for no single model of a calibration."""

NEGLIGIBLE = 1e-3
"""Weight below which a model is left out of the average: at 1 in 1000 nothing it says moves an end
of a 95 % interval by 2 % of the interval."""


@dataclass(frozen=True)
class Averaged:
    """Positions by all models together; attributes as those of `measuring.Measured`.

    Parameters
    ----------
    position_mm, std_mm
        Means and standard deviations of the mixture, within models and between them.
    low95_mm, high95_mm
        Quantiles of the mixture of z.
    weights, models
        What each model measures, and its weight; the weights sum to 1.
    """

    ids: tuple[str, ...]
    position_mm: FloatArray
    std_mm: FloatArray
    low95_mm: FloatArray
    high95_mm: FloatArray
    weights: FloatArray
    models: tuple[Measured, ...]

    @property
    def faults(self) -> Mapping[int, str]:
        """Why a row could not be measured by one of the models, by its place."""
        return {i: fault for model in self.models for i, fault in model.faults.items()}

    @property
    def covariance_mm2(self) -> FloatArray:
        """Covariance of x, y, z of each point, shape (n, 3, 3), within and between the models."""
        total = np.zeros((len(self.ids), 3, 3))
        for weight, model in zip(self.weights, self.models, strict=True):
            away = model.position_mm - self.position_mm
            total += weight * (model.covariance_mm2 + away[:, :, None] * away[:, None, :])
        return total

    def length(self, start: int, end: int) -> tuple[float, float]:
        """Return the distance of two points and its standard uncertainty, mm."""
        found = np.array([model.length(start, end) for model in self.models])
        mean, variance = mix_moments(self.weights, found[:, 0], found[:, 1] ** 2)
        return float(mean), float(np.sqrt(variance))


def measure_by(
    measuring: Measuring,
    table: GazeTable,
    *,
    model: str,
    seen: ImageObservations | None = None,
    refused: Mapping[int, str] = MappingProxyType({}),
) -> Positions:
    """Return the positions of the points in a table, by one model or by all of them.

    Parameters
    ----------
    seen, refused
        As in `calib.instrument.measuring.measure`.
    model
        `SELECTED`, `AVERAGE`, "rows", "adjustment" or the name of a fitted model.

    Raises
    ------
    UsageError
        If the calibration has no such model.
    """
    if model == AVERAGE:
        return measure_average(measuring, table, seen, refused=refused)
    return measure(instrument_of(measuring, model), table, seen, refused=refused)


def instrument_of(measuring: Measuring, model: str) -> Measuring:
    """Return the instrument as one model describes it, `SELECTED` or a fitted one by its name.

    "rows" and "adjustment" are the instruments by the rows' selected model and by all pictures.

    Raises
    ------
    UsageError
        If the calibration has no such model.
    """
    if model == SELECTED:
        return measuring
    if model in measuring.by:
        return measuring.by[model]
    measuring = _by_rows(measuring)
    for share in measuring.shares:
        if share.model == model:
            return replace(
                measuring,
                instrument=share.instrument,
                noise_factor=share.noise_factor,
                factor95=share.factor95,
            )
    known = ", ".join((SELECTED, *measuring.by, *(share.model for share in measuring.shares)))
    raise UsageError(f"model {model}: no one model of the calibration, which has {known}")


def _by_rows(measuring: Measuring) -> Measuring:
    """Return the instrument by the rows, among whose models the average is."""
    return measuring.by.get("rows", measuring)


def measure_average(
    measuring: Measuring,
    table: GazeTable,
    seen: ImageObservations | None = None,
    *,
    refused: Mapping[int, str] = MappingProxyType({}),
) -> Averaged:
    """Return the positions of the points in a table of readings, by all models together.

    Raises
    ------
    UsageError
        If the calibration does not hold the other models.
    """
    measuring = _by_rows(measuring)
    shares = [share for share in measuring.shares if share.weight >= NEGLIGIBLE]
    if not shares:
        raise UsageError(
            f"model {AVERAGE}: the calibration holds its selected model alone; calibrate again"
        )
    weights = np.array([share.weight for share in shares])
    weights /= weights.sum()
    models = tuple(
        measure(instrument_of(measuring, share.model), table, seen, refused=refused)
        for share in shares
    )
    return _mixed(weights, models, np.array([share.factor95 for share in shares]))


def _mixed(weights: FloatArray, models: Sequence[Measured], factor95: FloatArray) -> Averaged:
    position = np.stack([model.position_mm for model in models])
    std = np.stack([model.std_mm for model in models])
    mean, variance = mix_moments(weights, position, std**2)
    depths = mix_depths(weights, position[:, :, 2], std[:, :, 2], factor95)
    return Averaged(
        ids=models[0].ids,
        position_mm=mean,
        std_mm=np.sqrt(variance),
        low95_mm=depths.low95_mm,
        high95_mm=depths.high95_mm,
        weights=weights,
        models=tuple(models),
    )


def doubt(measuring: Measuring, measured: Positions, table: GazeTable) -> str | None:
    """Return what the reader of the selected model's intervals should know; None if nothing."""
    if not measuring.shares:
        return None
    average = measure_average(measuring, table)
    if set(average.faults) - set(measured.faults):
        return "not all models of the calibration meet these readings in front of C1"
    with np.errstate(invalid="ignore"):
        ratio = inverse_length(average.low95_mm, average.high95_mm) / inverse_length(
            measured.low95_mm, measured.high95_mm
        )
    ratio = ratio[np.isfinite(ratio)]
    if not ratio.max(initial=0.0) > CLEARLY_LONGER:
        return None
    parts = (f"{s.model} {s.weight:.2f}" for s in measuring.shares if s.weight >= NEGLIGIBLE)
    return (
        f"the rows leave open which model is right ({', '.join(parts)}): over all of them 95 % "
        f"intervals of depth are up to {ratio.max():.1f} times as long; --model {AVERAGE} "
        "gives these"
    )
