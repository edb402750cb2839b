"""Errors that rows and readings share, from rows to depth intervals.

Evidence: central differences through the whole fit; simulated truth (coverage); property.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.fit.importance import sample_importance
from calib.fit.posterior import laplace, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.plane import OBSERVABLE, depth
from calib.instrument.calibrated import CalibratedInstrument, instrument_from_draws
from calib.rows.from_table import RowSettings, Setup
from calib.rows.observations import Observations
from calib.simulate.rig import Noise, TrueRig, draw_rig
from calib.simulate.tables import draw_targets, observe
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    SharedErrors,
)
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.predictive import depth_draws, depth_sources, linear_positions

MODEL = "axis-offset"
DRAWS = 4000

LARGE = {"shared_focal": 1e-3, "shared_centre": 3e-3, "shared_z_rel": 5e-3}
"""Ten times the rows' own errors; most of it the parameters take up and take away again."""


def rig(seed: int) -> TrueRig:
    found = draw_rig(np.random.default_rng(seed), model=MODEL, fixed={})
    return replace(found, noise=replace(found.noise, **LARGE))


def calibrated(
    fit: RobustFit, rows: Observations, noisy: TrueRig, seed: int
) -> CalibratedInstrument:
    """Return the instrument by importance sampling: the chain's density, a hundred times faster."""
    rng = np.random.default_rng(seed)
    target = posterior_of(fit, rows, Priors({}))
    sample = sample_importance(target, *laplace(fit, target), rng)
    draws = sample.equally_weighted(DRAWS, rng)
    common = rng.standard_normal((DRAWS, fit.by_shared.shape[1]))
    draws[:, :-1] += common @ fit.by_shared.T
    noise: Noise = noisy.noise
    settings = RowSettings(
        u_x1c=noise.pixel_px / float(noisy.c1.matrix[0, 0]),
        u_z_mm=noise.z_mm,
        u_z_rel=noise.z_rel,
        encoder_step_rad=noisy.resolution_rad,
        u_alpha2_rad=noise.encoder_rad,
    )
    return instrument_from_draws(draws, common, fit, rows, Setup(settings))


def split(rows: Observations, count: int) -> tuple[Observations, Observations]:
    index = np.arange(len(rows))
    return rows.take(index < count), rows.take(index >= count)


def bench(
    seed: int, count: int = 14, *, clean: bool = False
) -> tuple[TrueRig, Observations, Observations, np.ndarray]:
    """Return a rig, its rows, test readings with the same shared errors, and their true depths.

    Clean ones have the uncertainties, but no errors.
    """
    noisy = rig(seed)
    rng = np.random.default_rng(seed + 1_000_000)
    low, high = noisy.depth_range_mm
    own = draw_targets(noisy, rng, count=count, depth_range_mm=(low, high))
    tests = draw_targets(noisy, rng, count=20, depth_range_mm=(low, 1.5 * high))
    points = np.concatenate([own, tests])
    simulated = observe(noisy, rng, points)
    seen = simulated.observed
    if clean:
        true = simulated.true_gaze
        seen = replace(
            seen,
            x1c=true.x1c,
            y1c=true.y1c,
            alpha2_rad=true.alpha2,
            gaze_residual_rad=true.residual,
            z_mm=points[:, 2],
        )
    return noisy, *split(seen, count), tests[:, 2]


def moved(rows: Observations, by: np.ndarray) -> Observations:
    """Return rows with errors added, shape (n, 5)."""
    return replace(
        rows,
        x1c=rows.x1c + by[:, OBSERVABLE.x1c],
        y1c=rows.y1c + by[:, OBSERVABLE.y1c],
        z_mm=rows.z_mm + by[:, OBSERVABLE.z],
    )


def test_effect_of_each_error_on_a_depth_agrees_with_central_differences() -> None:
    """Rows and reading with the same small error, and no other: calibrate, measure, compare."""
    _, rows, tests, _ = bench(3, clean=True)
    fit = fit_model(rows, Priors({}), model=MODEL)
    parameters = ParameterKnowledge(
        fit.names, fit.values, fit.covariance, None, ("A",) * len(fit.names)
    )
    shared = SharedErrors(rows.shared_names, fit.by_shared)
    instrument = Instrument(parameters, ReadingSpread(), shared)
    linear = linear_positions(instrument, tests.gaze, tests.shared[:, : OBSERVABLE.z])
    found = linear.by_common[:, 2, len(fit.names) :]
    step = 0.002
    for k, name in enumerate(rows.shared_names):
        ends = []
        for sign in (1, -1):
            by = sign * step * rows.shared[:, :, k]
            again = fit_model(moved(rows, by), Priors({}), model=MODEL)
            reading = moved(tests, sign * step * tests.shared[:, :, k])
            ends.append(depth(again.theta, reading.gaze))
        expected = (ends[0] - ends[1]) / (2 * step)
        # C1's principal point in v moves rows and readings, but without tilts no depth.
        assert (np.abs(expected).max() > 1) == (name != "C1 principal point, v")
        # What the parameters cannot take up spreads the rows, and with them the weights of the
        # loss, which the linear response leaves out: per cents of the largest effect.
        np.testing.assert_allclose(found[:, k], expected, atol=0.02 * np.abs(expected).max() + 1e-9)


def test_sources_are_those_of_the_budget() -> None:
    """Property: the table over the range and the certificate's budget say the same."""
    noisy, rows, tests, _ = bench(4)
    instrument = calibrated(fit_model(rows, Priors({}), model=MODEL), rows, noisy, 4).instrument
    loadings = tests.shared[:, : OBSERVABLE.z]
    linear = linear_positions(instrument, tests.gaze, loadings)
    sources = depth_sources(instrument, linear)
    u = np.sqrt(linear.covariance_mm2[:, 2, 2])
    np.testing.assert_allclose(np.linalg.norm(list(sources.values()), axis=0), u, rtol=1e-12)
    gaze = tests.gaze
    for i in range(3):
        reading = Reading(
            float(gaze.x1c[i]), float(gaze.y1c[i]), float(gaze.alpha2[i]), shared=loadings[i]
        )
        model = MeasurementModel(instrument, [reading])
        budget = model.budget(quantity="z", estimate=0.0, sensitivity=model.jacobian[0, 2])
        assert budget.standard_uncertainty == pytest.approx(u[i], rel=1e-9)
        parts = dict(budget.sources)
        for name in ("parameters", "C1 focal length", "scale of the reference depth"):
            assert parts[name] == pytest.approx(sources[name][i], rel=1e-6)


def test_large_shared_errors_that_cancel_leave_no_trace_of_their_draws() -> None:
    """Property: parameters and readings move together; what cancels must do so to rounding.

    The direct effect is several times u. Were covariance and link found apart, one from draws and
    one from the fit, the difference of the two would be several times u as well, or negative.
    """
    noisy, rows, tests, _ = bench(5)
    fit = fit_model(rows, Priors({}), model=MODEL)
    loadings = tests.shared[:, : OBSERVABLE.z]
    found = []
    for seed in (1, 2):
        instrument = calibrated(fit, rows, noisy, seed).instrument
        linear = linear_positions(instrument, tests.gaze, loadings)
        found.append(np.sqrt(linear.covariance_mm2[:, 2, 2]))
        through_reading = linear.by_common[:, 2, len(fit.names) :] - (
            linear.by_common[:, 2, : len(fit.names)] @ fit.by_shared
        )
        assert np.median(np.linalg.norm(through_reading, axis=1) / found[-1]) > 3
    # DRAWS of the rows' own posterior know its covariance to 2 % or so, u to 1 %.
    np.testing.assert_allclose(found[0], found[1], rtol=0.05)


def coverage(seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Return, by rig, the share of 95 % intervals that hold the truth: predictive, linear."""
    held = []
    for seed in seeds:
        noisy, rows, tests, truth = bench(seed)
        fit = fit_model(rows, Priors({}), model=MODEL)
        instrument = calibrated(fit, rows, noisy, seed).instrument
        loadings = tests.shared[:, : OBSERVABLE.z]
        linear = linear_positions(instrument, tests.gaze, loadings)
        z, u = linear.position_mm[:, 2], np.sqrt(linear.covariance_mm2[:, 2, 2])
        by_line = np.abs(1 / truth - 1 / z) <= 1.96 * u / z**2
        rng = np.random.default_rng(seed)
        draws = depth_draws(instrument, tests.gaze, rng, loadings=loadings, most=DRAWS)
        below = np.array([np.mean(d < t) for d, t in zip(draws, truth, strict=True)])
        held.append((np.mean((below > 0.025) & (below < 0.975)), np.mean(by_line)))
    predictive, line = np.array(held).T
    return predictive, line


@pytest.mark.parametrize(
    "seeds",
    [range(100, 140), pytest.param(range(200, 600), marks=pytest.mark.slow)],
    ids=["40 rigs", "400 rigs"],
)
def test_coverage_of_depths_read_with_the_errors_of_the_calibration(seeds: range) -> None:
    """Simulated truth: intervals hold the depth as often as they say, to their statistics.

    Rigs differ in how many of their intervals hold the truth; the standard error is from rig to
    rig. Intervals may be slightly wide: what of a shared error the parameters cannot take up is
    seen in the residuals, and widens the noise scale too.
    """
    for held in coverage(seeds):
        error = float(held.std(ddof=1) / np.sqrt(len(held)))
        assert 0.95 - 3 * error < held.mean()
        assert held.mean() < 0.985
