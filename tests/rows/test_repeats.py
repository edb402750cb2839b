"""Repeated gazes count once.

Evidence: property of the combined rows; simulated truth: a count's rounding does not average out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.readers import read_measurements
from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import OBSERVABLE, gaze_at
from calib.rows.observations import Observations
from calib.rows.repeated_readings import combine, repetition_warning

STEP = np.deg2rad(0.05625)
U_X, U_Z_REL = 2e-4, 0.002
THETA = vector({"baseline_mm": 150.0, "delta2_rad": 0.01, "axis_z_mm": -20.0})


def rows_at(points: FloatArray, times: int, rng: np.random.Generator) -> Observations:
    """Return each target gazed at `times` times by a rig at rest; its depth is measured once."""
    n = len(points)
    aimed = gaze_at(THETA, points)
    depth = points[:, 2] * (1 + U_Z_REL * rng.standard_normal(n))
    every = np.repeat(np.arange(n), times)
    xy = np.stack([aimed.x1c, aimed.y1c], axis=1)[every]
    xy += U_X * rng.standard_normal(xy.shape)
    std = np.zeros((len(every), len(OBSERVABLE)))
    std[:, : OBSERVABLE.alpha2] = U_X
    std[:, OBSERVABLE.alpha2] = STEP / np.sqrt(12)
    std[:, OBSERVABLE.z] = U_Z_REL * depth[every]
    names = tuple(f"r{i}" for i in range(len(every)))
    return Observations(
        ids=names,
        groups=names,
        x1c=xy[:, 0],
        y1c=xy[:, 1],
        alpha2_rad=(np.rint(aimed.alpha2 / STEP) * STEP)[every],
        gaze_residual_rad=np.zeros(len(every)),
        z_mm=depth[every],
        std=std,
    )


def targets(rng: np.random.Generator, count: int) -> FloatArray:
    z = rng.uniform(500, 1500, count)
    x, y = rng.uniform(-0.5, 0.5, (2, count))
    return np.column_stack([x * z, y * z, z])


def test_rows_without_repeats_come_back_as_they_are() -> None:
    rng = np.random.default_rng(1)
    rows = rows_at(targets(rng, 300), 1, rng)
    assert combine(rows) is rows


def test_repeats_become_their_mean_in_the_order_of_the_table() -> None:
    rng = np.random.default_rng(2)
    rows = rows_at(targets(rng, 6), 10, rng)
    shuffled = rows.take(rng.permutation(60))
    one = combine(shuffled)
    assert len(one) == 6
    first = {float(z): i for i, z in reversed(list(enumerate(shuffled.z_mm)))}
    assert one.ids == tuple(shuffled.ids[i] for i in sorted(first.values()))
    for i in range(6):
        own = shuffled.z_mm == shuffled.z_mm[sorted(first.values())[i]]
        np.testing.assert_allclose(one.x1c[i], shuffled.x1c[own].mean(), rtol=1e-12)
        np.testing.assert_allclose(one.y1c[i], shuffled.y1c[own].mean(), rtol=1e-12)
    np.testing.assert_allclose(one.std[:, OBSERVABLE.x1c], U_X / np.sqrt(10))
    np.testing.assert_array_equal(one.std[:, OBSERVABLE.alpha2], STEP / np.sqrt(12))
    np.testing.assert_allclose(one.std[:, OBSERVABLE.z], U_Z_REL * one.z_mm)


def test_the_run_warns_of_repeats_but_not_of_chance() -> None:
    lines = [f"{i},0.1,0.0,{60 + i / 4}" for i in range(200)]
    table = read_measurements("\n".join(["id,x1c,y1c,alpha2_deg", *lines]), name="gaze.csv")
    rows = rows_at(targets(np.random.default_rng(5), 200), 1, np.random.default_rng(5))
    assert repetition_warning(table, rows) is None
    assert repetition_warning(table, rows.take(np.arange(199))) is None
    told = repetition_warning(table, rows.take(np.arange(20)))
    assert told is not None
    assert "200 rows repeat 20 gazes" in told


def test_depths_taken_anew_are_averaged() -> None:
    rng = np.random.default_rng(3)
    rows = rows_at(targets(rng, 5), 4, rng)
    anew = replace(rows, z_mm=rows.z_mm * (1 + U_Z_REL * rng.standard_normal(20)))
    one = combine(anew)
    np.testing.assert_allclose(one.z_mm, anew.z_mm.reshape(5, 4).mean(axis=1), rtol=1e-12)
    np.testing.assert_allclose(one.std[:, OBSERVABLE.z], U_Z_REL * rows.z_mm[::4] / 2)


def test_another_count_height_or_depth_is_no_repeat() -> None:
    """A gross error among repeats stays a row of its own, so that it can be named."""
    rng = np.random.default_rng(4)
    rows = rows_at(targets(rng, 5), 4, rng)
    for name, off in (("alpha2_rad", STEP), ("x1c", 0.01), ("y1c", 0.01), ("z_mm", 50.0)):
        values = np.array(getattr(rows, name))
        values[5] += off
        assert len(combine(replace(rows, **{name: values}))) == 6


def test_a_target_that_moves_by_small_steps_is_not_at_one_place() -> None:
    """C2 rests while a target moves along its gaze plane, each step far below the errors."""
    z = np.linspace(600.0, 1800.0, 400)
    start = gaze_at(THETA, np.array([[0.0, 0.0, 600.0]]))
    turn = start.alpha2[0] + THETA[INDEX["delta2_rad"]]
    points = np.stack([(z - 600.0) / np.tan(turn), np.zeros_like(z), z], axis=1)
    rows = rows_at(points, 1, np.random.default_rng(3))
    rows = replace(rows, alpha2_rad=np.full(len(z), start.alpha2[0]))
    found = combine(rows)
    assert 10 < len(found) < 200
    # Depth and direction are still all over the range, and no row stands for more than two widths.
    assert np.ptp(found.z_mm) > 0.9 * np.ptp(rows.z_mm)
    assert np.diff(np.sort(found.z_mm)).max() < 2 * 0.012 * 1800


def test_parameters_are_as_uncertain_as_they_scatter() -> None:
    """Simulated truth: 12 targets ten times each, 60 rigs, the baseline seen at 90 degrees.

    The rms of 60 pulls scatters by 9 %. Counted as 120 rows they come out above 3.
    """
    model, pulls = "axis-offset", []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        rows = combine(rows_at(targets(rng, 12), 10, rng))
        fit = fit_model(rows, Priors({}, None), model=model)
        seen = np.zeros(len(fit.values))
        seen[[fit.names.index(n) for n in ("baseline_mm", "eccentricity_mm")]] = 1
        off = seen @ fit.values - THETA[INDEX["baseline_mm"]]
        pulls.append(off / np.sqrt(seen @ fit.covariance @ seen))
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3
