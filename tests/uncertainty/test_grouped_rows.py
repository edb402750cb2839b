"""Rows in poses of the board with one reference depth each: depth intervals, and the warning.

Evidence: simulated truth (coverage, pulls, false warnings), with a negative control; properties of
the sources of a depth's uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from grouped_rows import DRAWS, Bench, bench, instrument, sampled, stated

from calib.fit.group_check import check_groups
from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibrated import CalibratedInstrument
from calib.rows.observations import GROUP_SOURCE, Observations
from calib.uncertainty.measurement import Reading
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.predictive import depth_draws, depth_sources, linear_positions

U_OWN = U_GROUP = 0.002
NO_PRIORS = Priors({})


def calibrated(one: Bench, rows: Observations, seed: int, model: str) -> CalibratedInstrument:
    fit = fit_model(rows, NO_PRIORS, model=model)
    return instrument(fit, sampled(fit, rows, seed), one, rows, seed)


def rig(seed: int, model: str = "base", poses: int = 5, targets: int = 6) -> Bench:
    return bench(seed, model=model, poses=poses, targets=targets, u_own=U_OWN, u_group=U_GROUP)


def scores(
    seeds: range, model: str, poses: int, targets: int, *, u_stated: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of 95 % intervals that hold the depth, by rig, and pulls, (rigs, p)."""
    held, pulls = [], []
    for seed in seeds:
        one = rig(seed, model, poses, targets)
        rows = stated(one.rows, u_stated) if u_stated else one.rows
        found = calibrated(one, rows, seed, model)
        rng = np.random.default_rng(seed)
        draws = depth_draws(found.instrument, one.tests.gaze, rng, most=DRAWS)
        below = np.array([np.mean(d < t) for d, t in zip(draws, one.true_depths_mm, strict=True)])
        held.append(np.mean((below > 0.025) & (below < 0.975)))
        p = found.instrument.parameters
        truth = one.rig.theta[list(MODELS[model].indices)]
        pulls.append((p.values - truth) / np.sqrt(np.diag(p.covariance)))
    return np.array(held), np.array(pulls)


SHAPES = [("base", 5, 6), ("axis-offset", 8, 9)]


@pytest.mark.parametrize(("model", "poses", "targets"), SHAPES)
@pytest.mark.parametrize(
    "seeds",
    [range(1000, 1040), pytest.param(range(2000, 2300), marks=pytest.mark.slow)],
    ids=["40 rigs", "300 rigs"],
)
def test_stated_groups_give_intervals_that_hold(
    model: str, poses: int, targets: int, seeds: range
) -> None:
    """Simulated truth. The standard error is from rig to rig; 300 rigs know 95 % to 0.5 %.

    Parameters along which the sharing makes the estimate better are left a little wide.
    """
    held, pulls = scores(seeds, model, poses, targets, u_stated=U_GROUP)
    error = float(held.std(ddof=1) / np.sqrt(len(held)))
    assert 0.95 - 3 * error < held.mean() < 0.97 + 2 * error
    rms = np.sqrt(np.mean(pulls**2, axis=0))
    scatter = 1 / np.sqrt(2 * len(seeds))
    assert (rms < 1.1 + 2 * scatter).all()
    assert (rms > 0.85 - 2 * scatter).all()


@pytest.mark.slow
@pytest.mark.parametrize(("model", "poses", "targets"), SHAPES)
def test_silent_groups_give_intervals_that_do_not(model: str, poses: int, targets: int) -> None:
    """Negative control: the same rigs, nothing stated."""
    held, _ = scores(range(2000, 2300), model, poses, targets, u_stated=0.0)
    assert held.mean() < 0.94


def test_the_source_has_one_line_and_no_part_in_a_reading() -> None:
    """Property: it stands beside the others, in table and budget, and adds to u in quadrature."""
    one = rig(3)
    rows = stated(one.rows, U_GROUP)
    found = calibrated(one, rows, 3, "base").instrument
    assert found.shared is not None
    assert (found.shared.of_readings, len(found.shared.names)) == (0, found.shared.of_rows_alone)
    linear = linear_positions(found, one.tests.gaze)
    sources = depth_sources(found, linear)
    u = np.sqrt(linear.covariance_mm2[:, 2, 2])
    np.testing.assert_allclose(np.linalg.norm(list(sources.values()), axis=0), u, rtol=1e-12)
    assert (sources[GROUP_SOURCE] > 0.1 * u).all()
    gaze = one.tests.gaze
    reading = Reading(float(gaze.x1c[0]), float(gaze.y1c[0]), float(gaze.alpha2[0]))
    model = MeasurementModel(found, [reading])
    budget = model.budget(quantity="z", estimate=0.0, sensitivity=model.jacobian[0, 2])
    assert dict(budget.sources)[GROUP_SOURCE] == pytest.approx(sources[GROUP_SOURCE][0], rel=1e-6)
    assert budget.standard_uncertainty == pytest.approx(u[0], rel=1e-9)


def test_draws_and_linear_law_agree_beside_errors_of_readings_too() -> None:
    """Property: with errors that readings share as well, each keeps its column."""
    one = rig(4, "axis-offset")
    loadings = np.zeros((len(one.rows), 5, 1))
    loadings[:, OBSERVABLE.x1c, 0] = 1e-3
    rows = replace(stated(one.rows, U_GROUP), shared=loadings, shared_names=("focal length",))
    found = calibrated(one, rows, 4, "axis-offset").instrument
    assert found.shared is not None
    assert found.shared.names[:2] == ("focal length", GROUP_SOURCE)
    assert found.shared.of_readings == 1
    with pytest.raises(ValueError, match="needs loadings"):
        MeasurementModel(found, [Reading(0.1, 0.0, 1.6)])
    of_tests = np.zeros((len(one.tests), 4, 1))
    of_tests[:, OBSERVABLE.x1c, 0] = 1e-3
    linear = linear_positions(found, one.tests.gaze, of_tests)
    u = np.sqrt(linear.covariance_mm2[:, 2, 2])
    rng = np.random.default_rng(0)
    drawn = [d.std() for d in depth_draws(found, one.tests.gaze, rng, loadings=of_tests)]
    np.testing.assert_allclose(drawn, u, rtol=0.05)


def test_silent_groups_are_warned_of_with_their_size() -> None:
    """Simulated truth: eight poses of nine targets; the size is known to 1 / sqrt(2 * 6)."""
    told, sizes = [], []
    for seed in range(20):
        one = rig(seed, "base", 8, 9)
        fit = fit_model(one.rows, NO_PRIORS, model="base")
        found = check_groups(one.rows, fit)
        assert (found.groups, found.rows) == (8, 72 - len(fit.outliers))
        told.append(found.together)
        sizes.append(found.u_z_rel)
    assert np.mean(told) > 0.5
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(U_GROUP, rel=0.2)


@pytest.mark.parametrize(
    "rigs",
    [range(60), pytest.param(range(1000), marks=pytest.mark.slow)],
    ids=["60 rigs", "1000 rigs"],
)
def test_clean_rigs_are_not_warned_of(rigs: range) -> None:
    """Simulated truth: one warning in 1000 rigs is expected; five would have a chance of 0.4 %.

    Of the probabilities themselves a tenth is below 0.1.
    """
    found = []
    for seed in rigs:
        one = bench(seed, model="axis-offset", poses=5, targets=6, u_own=U_OWN, u_group=0.0)
        fit = fit_model(one.rows, NO_PRIORS, model="axis-offset")
        found.append(check_groups(one.rows, fit).probability)
    assert sum(p < 0.001 for p in found) <= max(1, len(rigs) // 250)
    low = np.mean(np.array(found) < 0.1)
    assert low < 0.1 + 3 * np.sqrt(0.1 * 0.9 / len(rigs))


def test_what_is_stated_is_not_warned_of() -> None:
    one = rig(1, "base", 8, 9)
    silent = check_groups(one.rows, fit_model(one.rows, NO_PRIORS, model="base"))
    assert silent.groups == 8
    rows = stated(one.rows, U_GROUP)
    found = check_groups(rows, fit_model(rows, NO_PRIORS, model="base"))
    assert (found.groups, found.probability, found.together) == (0, 1.0, False)


def test_errors_that_all_rows_share_are_no_matter_of_groups() -> None:
    """Simulated truth: a shared error, stated, that differs from pose to pose and not within.

    Taken for errors of the groups it would be warned of on most rigs.
    """
    probabilities, blind = [], []
    for seed in range(40):
        one = bench(seed, model="base", poses=8, targets=9, u_own=U_OWN, u_group=0.0)
        rng = np.random.default_rng(seed)
        pose = np.unique(one.rows.groups, return_inverse=True)[1].ravel()
        pattern = np.where(pose % 2 == 0, 1.0, -1.0) * 0.003 * one.rows.z_mm
        loadings = np.zeros((len(one.rows), 5, 1))
        loadings[:, OBSERVABLE.z, 0] = pattern
        moved = replace(one.rows, z_mm=one.rows.z_mm + rng.standard_normal() * pattern)
        rows = replace(moved, shared=loadings, shared_names=("scale",))
        fit = fit_model(rows, NO_PRIORS, model="base")
        probabilities.append(check_groups(rows, fit).probability)
        blind.append(check_groups(moved, fit_model(moved, NO_PRIORS, model="base")).together)
    assert np.mean(blind) > 0.25
    assert not any(p < 0.001 for p in probabilities)
