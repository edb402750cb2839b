"""Stage: the calibrated instrument, what it measures over its range, and on the validation rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import BoolArray, FloatArray
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE, Gaze, gaze_at
from calib.rows.from_table import (
    Setup,
    direction_by_common,
)
from calib.rows.observations import Observations
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    ReadingSpread,
    SharedErrors,
    Spread,
)
from calib.uncertainty.montecarlo import NORMAL_FACTOR
from calib.uncertainty.predictive import (
    DepthPrediction,
    depth_sources,
    linear_positions,
    predict_depths,
)

GRID_POINTS = 21
"""Depths of the uncertainty table."""

LEAST_INSIDE = 2
"""Depths of a table that must be calibrated ones, or these have a table of their own."""

EVALUATION = {"data": "A", "prior": "B", "both": "A, B"}
"""Of a standard uncertainty (JCGM 100, 2.3.2), by what decided the parameter."""


@dataclass(frozen=True)
class CalibratedInstrument:
    """The instrument as the selected model describes it.

    Parameters
    ----------
    model
        Name of the model.
    instrument
        Parameters with their joint distribution, and the errors of a reading.
    noise_factor
        By how much the stated uncertainties of a reading were widened: the root mean square of
        the noise scale, at least 1. The rows may prove the stated uncertainties too small; that
        they are too large is not believed of a reading, since the reference depths may be what is
        better than stated.
    calibrated_mm
        Least and greatest reference depth of the rows, shape (2,).
    setup
        The cameras, and the errors that all readings share with the calibration.
    """

    model: str
    instrument: Instrument
    noise_factor: float
    calibrated_mm: FloatArray
    setup: Setup

    @property
    def measures_residual(self) -> bool:
        """Whether C2's image told the gaze residual of the calibration rows."""
        return self.instrument.reading.gaze_residual_rad.normal > 0

    def loadings(self, gaze: Gaze) -> FloatArray | None:
        """Return what the shared errors do to readings, shape (n, 4, m); None without any."""
        cameras, shared = self.setup.cameras, self.setup.shared
        if not shared.names:
            return None
        loadings = np.zeros((len(gaze), OBSERVABLE.z, shared.factor.shape[1]))
        if cameras.c1 is not None:
            xy = np.stack([gaze.x1c, gaze.y1c], axis=1)
            loadings[:, : OBSERVABLE.alpha2] = direction_by_common(xy, cameras.c1, shared)
        if cameras.c2 is not None and self.measures_residual:
            # Near the centre column: the error of cx2 over fx2.
            by_centre = shared.of_camera("c2", cameras.c2)[2]
            loadings[:, OBSERVABLE.residual] = -by_centre / cameras.c2.matrix[0, 0]
        return loadings


def build_instrument(
    posterior: Posterior, fit: RobustFit, rows: Observations, setup: Setup
) -> CalibratedInstrument:
    """Return the instrument of the selected model."""
    common = posterior.common.reshape(len(posterior.flat), -1)
    return instrument_from_draws(posterior.flat, common, fit, rows, setup)


def instrument_from_draws(
    draws: FloatArray, common: FloatArray, fit: RobustFit, rows: Observations, setup: Setup
) -> CalibratedInstrument:
    """Return the instrument that draws from a posterior describe.

    Parameters
    ----------
    draws
        Of equal weight, shared errors included: free parameters, then the logarithm of the noise
        scale, shape (m, p + 1).
    common
        The shared standard-normal errors that went with each draw, shape (m, k).
    fit
        The robust fit of the same model.
    """
    factor = max(1.0, float(np.sqrt(np.mean(np.exp(2 * draws[:, -1])))))
    own = draws[:, :-1] - common @ fit.by_shared.T
    parameters = ParameterKnowledge(
        names=fit.names,
        values=own.mean(axis=0),
        covariance=np.cov(own, rowvar=False) + fit.by_shared @ fit.by_shared.T,
        degrees_of_freedom=None,
        evaluation=tuple(EVALUATION[who] for who in fit.identified_by),
        draws=draws[:, :-1],
    )
    direction = float(np.median(rows.std[:, OBSERVABLE.x1c]))
    across = float(np.median(rows.std[:, OBSERVABLE.y1c]))
    residual = float(np.median(rows.std[:, OBSERVABLE.residual]))
    # Where the gaze residual is measured, the motor's step is no error: see calib.rows.from_table.
    step = 0.0 if residual > 0 else setup.settings.encoder_step_rad
    reading = ReadingSpread(
        x1c=Spread(normal=factor * direction),
        y1c=Spread(normal=factor * across),
        alpha2_rad=Spread(normal=factor * setup.settings.u_alpha2_rad, width=factor * step),
        gaze_residual_rad=Spread(normal=factor * residual),
    )
    origin = origin_of(parameters)
    shared = None
    if fit.shared_names:
        shared = SharedErrors(
            fit.shared_names,
            with_parameters=fit.by_shared,
            own_draws=own,
            of_rows_alone=len(fit.shared_names) - len(rows.shared_names),
        )
    return CalibratedInstrument(
        model=fit.model,
        instrument=Instrument(parameters, reading, shared, float(rows.alpha2_rad.mean())),
        noise_factor=factor,
        calibrated_mm=np.array([rows.z_mm.min(), rows.z_mm.max()]) + origin[0],
        setup=setup,
    )


def origin_of(parameters: ParameterKnowledge) -> tuple[float, float]:
    """Return from how far in front of C1's centre z_mm was found to count, and its u, mm."""
    if REFERENCE_OFFSET not in parameters.names:
        return 0.0, 0.0
    i = parameters.names.index(REFERENCE_OFFSET)
    return float(parameters.values[i]), float(np.sqrt(parameters.covariance[i, i]))


@dataclass(frozen=True)
class DepthTable:
    """Depth uncertainty over the range, for a target on C1's optical axis.

    Parameters
    ----------
    depth_mm
        Shape (n,).
    prediction
        What the instrument says of a target there.
    extrapolated
        Whether the depth lies outside those of the calibration rows, shape (n,).
    factor95
        Half width of the 95 % interval of 1 / z over its linear standard uncertainty: the largest
        of the calibrated depths, at least 1.96. Inverse depth is nearly normal where depth itself
        is skewed: `calib measure` makes its intervals with it.
    sources_mm
        What each source contributes to the linear standard uncertainty, by name, shape (n,) each.
    middle_mm, middle_u_mm
        A depth near the middle of the calibrated ones, and its standard uncertainty.
    """

    depth_mm: FloatArray
    prediction: DepthPrediction
    extrapolated: BoolArray
    factor95: float
    sources_mm: Mapping[str, FloatArray]
    middle_mm: float
    middle_u_mm: float


def tabulate_depths(
    calibrated: CalibratedInstrument,
    *,
    low_mm: float,
    high_mm: float,
    seed: SeedSequence,
    points: int = GRID_POINTS,
) -> DepthTable:
    """Return the depth uncertainty from `low_mm` to `high_mm`.

    What holds for the calibrated depths does not depend on the range asked for.
    """
    z = np.linspace(low_mm, high_mm, points)
    gaze = _on_axis(calibrated, z)
    instrument, loadings = calibrated.instrument, calibrated.loadings(gaze)
    prediction = predict_depths(instrument, gaze, np.random.default_rng(seed), loadings=loadings)
    sources = depth_sources(instrument, linear_positions(instrument, gaze, loadings))
    low, high = calibrated.calibrated_mm
    outside = (z < low) | (z > high)
    depth, judged, inside = z, prediction, ~outside
    if low_mm > low or high_mm < high or inside.sum() < LEAST_INSIDE:
        depth = np.linspace(low, high, points)
        inside = np.ones(points, dtype=np.bool_)
        own = _on_axis(calibrated, depth)
        rng = np.random.default_rng(seed)
        judged = predict_depths(instrument, own, rng, loadings=calibrated.loadings(own))
    middle = int(np.argmin(np.abs(depth - (low + high) / 2)))
    return DepthTable(
        depth_mm=z,
        prediction=prediction,
        extrapolated=outside,
        factor95=_factor95(judged, inside),
        sources_mm=sources,
        middle_mm=float(depth[middle]),
        middle_u_mm=float(judged.u_mm[middle]),
    )


def _on_axis(calibrated: CalibratedInstrument, z_mm: FloatArray) -> Gaze:
    """Return the readings of targets on C1's optical axis."""
    targets = np.stack([np.zeros_like(z_mm), np.zeros_like(z_mm), z_mm], axis=1)
    return gaze_at(calibrated.instrument.theta, targets)


def _factor95(p: DepthPrediction, inside: BoolArray) -> float:
    """Return the coverage factor of inverse depth where it is largest among the depths inside."""
    half = (1 / p.low95_mm - 1 / p.high95_mm) / 2
    factor = half * p.z_mm**2 / p.gum_u_mm
    return float(max(NORMAL_FACTOR, factor[inside].max(initial=0.0)))
