"""Mistakes that the rows leave open and independent depths decide.

Evidence: simulated truth, mistakes made on it. Negative control: the same rigs without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from test_independent_references import found, history_of, rig, validation_of

from calib.core.arrays import FloatArray
from calib.diagnosis.findings import Attempt, Cause, Diagnosis, Suspect
from calib.diagnosis.later import as_meant
from calib.diagnosis.second import Task
from calib.fit.robust import fit_model
from calib.rows.from_table import ValidationRows
from calib.simulate.faults import Context, spoil

MODEL = "axis-offset"


def diagnosed(seed: int, faults: Mapping[str, float]) -> tuple[Diagnosis, tuple[Cause, ...]]:
    """Return what the rows of a rig say by themselves, and what is named with six depths more."""
    bench = rig(seed)
    context = Context(bench.rig.resolution_rad, np.random.default_rng(5))
    rows = spoil(bench.rows, faults, context)
    validation = validation_of(bench)
    six = ValidationRows(validation.rows.take(np.arange(6)), np.arange(6), {})
    six = replace(six, rows=spoil(six.rows, faults, context, validation=True))
    task = Task(rows, bench.priors, fit_model(rows, bench.priors, model=MODEL), history_of(bench))
    tried = task.tried()
    assert tried is not None
    by_rows = tried.diagnosis(found(bench, rows, None)[1])
    return by_rows, found(bench, rows, six, by_rows=by_rows)[0].causes


@pytest.mark.parametrize(("seed", "size_mm"), [(4, 10.0), (5, 6.0), (8, 10.0)])
def test_near_references_that_are_off_are_told_with_six_depths(seed: int, size_mm: float) -> None:
    by_rows, causes = diagnosed(seed, {"reference-bias-near": size_mm})
    assert by_rows.causes == ()
    assert "reference-bias-near" in [cause.name for cause in causes[:2]]
    cause = next(cause for cause in causes if cause.name == "reference-bias-near")
    assert cause.seen_in == "both"
    assert abs(cause.estimate - size_mm) < 4 * cause.std
    assert cause.text.startswith("reference depths up to")
    assert cause.effect > 1


@pytest.mark.parametrize("seed", [4, 5, 8])
def test_without_the_mistake_the_same_rigs_get_no_name(seed: int) -> None:
    assert diagnosed(seed, {})[1] == ()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("c1-distortion-left-in", [-0.1]),
        ("c1-principal-point", [0.02]),
        ("c1-focal-length", [0.03]),
        ("encoder-twice-per-turn", [0.002, 0.0]),
        ("microstep", [0.0003, 0.0]),
    ],
)
def test_a_mistake_of_the_rig_is_taken_off_later_readings(name: str, values: list[float]) -> None:
    bench = rig(2)
    validation = validation_of(bench)
    unit = Attempt(name, None, 0.0, 0.0, 0.0).hypothesis.per_unit
    context = Context(bench.rig.resolution_rad, np.random.default_rng(5))
    spoilt = spoil(validation.rows, {name: values[0] / unit}, context, validation=True)
    suspect = Suspect(
        Attempt(name, None, values[0] / unit, 0.1, 0.0),
        np.array(values),
        np.eye(len(values)),
        np.zeros(0),
        (1.0, 1.0),
    )
    meant = as_meant(suspect, bench.rows, replace(validation, rows=spoilt), history_of(bench))
    assert meant is not None
    assert meant[1] is not None

    def readings(rows: object) -> FloatArray:
        return np.stack([getattr(rows, key) for key in ("x1c", "y1c", "alpha2_rad")])

    before = np.abs(readings(spoilt) - readings(validation.rows)).max()
    left = np.abs(readings(meant[1].rows) - readings(validation.rows)).max()
    # Errors are evaluated where the reading is, not where it should be: a second-order rest.
    assert left < 0.25 * before
    assert np.array_equal(meant[1].rows.z_mm, spoilt.z_mm)
