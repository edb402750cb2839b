"""Mistakes that only independent references show: a common scale, a zero or an origin that differ.

Evidence: simulated truth, mistakes made on it by hand.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.dataset.tables import LengthTable
from calib.diagnosis.differences import differences
from calib.diagnosis.findings import Cause, Diagnosis
from calib.diagnosis.independent import LEAST, diagnose_references
from calib.diagnosis.session import RowHistory
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.instrument.calibrated import (
    CalibratedInstrument,
    DepthTable,
    instrument_from_draws,
    tabulate_depths,
)
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations
from calib.simulate.faults import FULL_STEP_COUNTS
from calib.study.conditions import CONDITIONS
from calib.study.rigs import INSIDE, StudiedRig, set_up

MODEL = "axis-offset"
NOTHING = Diagnosis(MODEL)
CONDITION = replace(CONDITIONS["axis-offset-14"], rows=24)


@cache
def rig(seed: int) -> StudiedRig:
    return set_up(CONDITION, seed=seed, number=0)


def validation_of(
    bench: StudiedRig, *, alpha_rad: float = 0.0, z_mm: float = 0.0
) -> ValidationRows:
    """Return independent rows of a rig, readings and references off by so much."""
    tests = bench.tests[INSIDE]
    z = bench.true_depths_mm[INSIDE] + z_mm
    noise = np.random.default_rng(7).normal(size=len(z))
    rows = replace(
        tests, z_mm=z + noise * tests.std[:, -1], alpha2_rad=tests.alpha2_rad + alpha_rad
    )
    return ValidationRows(rows, np.arange(len(rows)), {})


def instrument(fit: RobustFit, bench: StudiedRig, rows: Observations) -> CalibratedInstrument:
    rng = np.random.default_rng(3)
    draws = rng.multivariate_normal(fit.values, fit.covariance, 2000)
    noise = np.full((len(draws), 1), np.log(fit.noise_scale))
    return instrument_from_draws(
        np.hstack([draws, noise]), np.zeros((len(draws), 0)), fit, rows, bench.setup
    )


def found(
    bench: StudiedRig,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None = None,
    by_rows: Diagnosis = NOTHING,
) -> tuple[Diagnosis, DepthTable]:
    fit = fit_model(rows, bench.priors, model=MODEL)
    calibrated = instrument(fit, bench, rows)
    low, high = float(rows.z_mm.min()), float(rows.z_mm.max())
    depths = tabulate_depths(calibrated, low_mm=low, high_mm=high, seed=SeedSequence(1))
    found = diagnose_references(
        by_rows, calibrated, fit, rows, validation, lengths, depths, history_of(bench)
    )
    return found, depths


def history_of(bench: StudiedRig) -> RowHistory:
    resolution = bench.rig.resolution_rad
    return RowHistory({}, {}, resolution, FULL_STEP_COUNTS * resolution)


def first(diagnosis: Diagnosis, name: str) -> Cause:
    assert diagnosis.causes, diagnosis.tried
    assert name == diagnosis.causes[0].name, [(t.name, t.gain) for t in diagnosis.tried]
    return diagnosis.causes[0]


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_scale_of_all_references_is_named_by_independent_depths(seed: int) -> None:
    bench = rig(seed)
    rows = replace(bench.rows, z_mm=bench.rows.z_mm * 1.03)
    cause = first(found(bench, rows, validation_of(bench))[0], "reference-scale")
    assert abs(cause.estimate - 3.0) < 3 * cause.std
    assert cause.seen_in == "references"
    assert cause.effect > 1
    assert "too large" in cause.text
    before, after = cause.residual_mrad
    assert (after**2).sum() < 0.2 * (before**2).sum()


@pytest.mark.parametrize("seed", range(1, 4))
def test_a_zero_that_moved_between_the_tables_is_told_from_a_scale(seed: int) -> None:
    bench = rig(seed)
    turned = validation_of(bench, alpha_rad=float(np.deg2rad(0.4)))
    diagnosis = found(bench, bench.rows, turned)[0]
    cause = first(diagnosis, "reading-step")
    assert abs(cause.estimate - 0.4) < 3 * cause.std
    assert "validation rows" in cause.text


def test_references_that_count_from_elsewhere_are_told_from_a_scale() -> None:
    bench = rig(2)
    diagnosis = found(bench, bench.rows, validation_of(bench, z_mm=-40.0))[0]
    cause = first(diagnosis, "reference-offset")
    assert abs(cause.estimate - 40.0) < 3 * cause.std


def test_rows_with_a_mistake_of_their_own_are_mended_first() -> None:
    """Calibrated by them the instrument contradicts the references, whose fault that is not."""
    bench = rig(1)
    rows = replace(bench.rows, z_mm=bench.rows.z_mm * 1.03)
    validation = validation_of(bench)
    cause = first(found(bench, rows, validation)[0], "reference-scale")
    mistaken = Diagnosis(MODEL, causes=(replace(cause, seen_in="rows"),))
    assert mistaken.left_out is not None
    assert found(bench, rows, validation, by_rows=mistaken)[0].causes == mistaken.causes
    minor = Diagnosis(MODEL, causes=(replace(cause, seen_in="rows", effect=0.01),))
    assert len(found(bench, rows, validation, by_rows=minor)[0].causes) > 1


def test_sound_rigs_get_no_name() -> None:
    named = []
    for seed in range(20, 32):
        bench = rig(seed)
        named += [cause.name for cause in found(bench, bench.rows, validation_of(bench))[0].causes]
    # Chance names one of fifty or so; twelve rigs name two by a chance of 2 %.
    assert len(named) <= 1, named


def test_lengths_alone_show_a_scale() -> None:
    bench = rig(4)
    rows = replace(bench.rows, z_mm=bench.rows.z_mm * 1.03)
    lengths = lengths_between(bench)
    diagnosis = found(bench, rows, None, lengths)[0]
    named = {cause.name: cause for cause in diagnosis.causes}
    assert "reference-scale" in named, diagnosis.tried
    cause = named["reference-scale"]
    assert abs(cause.estimate - 3.0) < 3 * cause.std
    assert not found(bench, bench.rows, None, lengths)[0].causes


def test_lengths_yet_to_be_measured_add_nothing_to_validation_depths() -> None:
    """Also where the model has the origin of the references as a parameter."""
    bench = rig(1)
    rows = replace(bench.rows, z_mm=bench.rows.z_mm * 1.03)
    silent = replace(bench, priors=Priors({**bench.priors.stated, REFERENCE_OFFSET: (0.0, 50.0)}))
    unknown = replace(lengths_between(bench), length_mm=np.full(8, np.nan))
    with_it, without = (
        found(silent, rows, validation_of(bench), lengths)[0].tried for lengths in (unknown, None)
    )
    assert [(t.name, t.gain) for t in with_it] == [(t.name, t.gain) for t in without]
    assert len(without) == 3


def lengths_between(bench: StudiedRig) -> LengthTable:
    """Return true distances between targets of the calibration rows."""
    truth = bench.true_rows
    points = np.stack([truth.x1c, truth.y1c, np.ones(len(truth))], axis=1) * truth.z_mm[:, None]
    order = np.argsort(points[:, 0], kind="stable")
    pairs = list(zip(order[:8], order[::-1][:8], strict=True))
    return LengthTable(
        file="lengths.csv",
        line=tuple(range(2, 2 + len(pairs))),
        ids=tuple(f"l{k}" for k in range(len(pairs))),
        start=tuple(truth.ids[i] for i, _ in pairs),
        end=tuple(truth.ids[j] for _, j in pairs),
        length_mm=np.array([np.linalg.norm(points[i] - points[j]) for i, j in pairs]),
        u_length_mm=np.full(len(pairs), 0.05),
    )


def test_two_references_are_too_few() -> None:
    bench = rig(1)
    few = validation_of(bench, z_mm=-400.0)
    few = ValidationRows(few.rows.take(np.arange(LEAST - 1)), np.arange(LEAST - 1), {})
    assert not found(bench, bench.rows, few)[0].tried


def test_derivatives_of_depth_follow_the_geometry() -> None:
    """The term of a moved zero is the change of measured depths, by finite differences."""
    bench = rig(3)
    fit = fit_model(bench.rows, bench.priors, model=MODEL)
    calibrated = instrument(fit, bench, bench.rows)
    step = 1e-6

    def error(alpha: float) -> FloatArray:
        turned = validation_of(bench, alpha_rad=alpha)
        return differences(calibrated, fit, bench.rows, turned, None).error_mm

    seen = differences(calibrated, fit, bench.rows, validation_of(bench), None)
    slope = (error(step) - error(-step)) / (2 * step)
    # Taken at measured depths: off by about twice their relative errors, of 1 % here.
    np.testing.assert_allclose(seen.by_zero, slope, rtol=0.04)
