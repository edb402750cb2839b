"""How often a mistake is named where there is none, and how often the right one is named.

Evidence: simulated truth, rigs of all conditions of the study, one row in ten a gross error among
them. The figures are printed; those of a larger run stand in docs/uncertainty.md.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.diagnosis.engine import Tried
from calib.diagnosis.session import RowHistory
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.plane import OBSERVABLE, depth
from calib.rows.observations import Observations
from calib.simulate.faults import FAULTS, Context, spoil
from calib.study.conditions import CONDITIONS
from calib.study.rigs import Bench, set_up

SIZE = int(os.environ.get("CALIB_STUDY_SIZE", "4"))
"""Rigs a condition, and a fault and number of rows; 20 for the figures of the documents."""

SEED = 4101

TOLD = tuple(
    name
    for name in FAULTS
    # What rows alone cannot show, and what `calib check` refuses before.
    if name not in ("reference-scale", "x-mirrored", "y-mirrored")
)


def tell(capsys: pytest.CaptureFixture[str], said: str) -> None:
    with capsys.disabled():
        sys.stdout.write(f"\n{said}\n")


def tried(rows: Observations, priors: Priors, bench: Bench, model: str) -> tuple[str, ...]:
    fit = fit_model(rows, priors, model=model)
    full = 16 * bench.rig.resolution_rad
    history = RowHistory({}, {}, bench.rig.resolution_rad, full)
    found = Tried.of(rows, priors, fit, history, is_left=False)
    return () if found is None else found.named


@pytest.mark.slow
def test_clean_rigs_get_no_false_name(capsys: pytest.CaptureFixture[str]) -> None:
    named: Counter[str] = Counter()
    rigs = 0
    for condition in CONDITIONS.values():
        for number in range(SIZE):
            bench = set_up(condition, seed=SEED, number=number)
            model = "base" if condition.model == "base" else "axis-offset"
            try:
                found = tried(bench.rows, bench.priors, bench, model)
            except EstimationError:
                continue
            rigs += 1
            named.update(found[:1])
    said = f"{sum(named.values())} false names of {rigs} clean rigs: {dict(named)}"
    tell(capsys, said)
    # One in a hundred, and what chance makes of that in so many.
    assert sum(named.values()) <= 0.01 * rigs + 3 * np.sqrt(0.01 * rigs), said


def effect(clean: RobustFit, spoiled: RobustFit, bench: Bench) -> float:
    """Return by how many u the mistake moves the depth of a row's target, at most."""
    gaze = bench.rows.gaze
    at = depth_jacobian(clean.theta, gaze)
    of_theta = at.by_theta[:, list(clean.structure.indices)]
    variance = np.einsum("ni,ij,nj->n", of_theta, clean.covariance, of_theta)
    own = at.by_observable * bench.rows.std[:, : OBSERVABLE.z]
    u = np.sqrt(variance + (own**2).sum(axis=1))
    change = np.abs(depth(spoiled.theta, gaze) - at.z) / u
    return float(np.max(change))


@pytest.mark.slow
@pytest.mark.parametrize("rows", [14, 24, 60])
def test_mistakes_that_matter_are_named(rows: int, capsys: pytest.CaptureFixture[str]) -> None:
    right: Counter[str] = Counter()
    wrong: list[tuple[str, str]] = []
    missed: Counter[str] = Counter()
    total: Counter[str] = Counter()
    condition = CONDITIONS["axis-offset-14"]
    condition = replace(condition, rows=rows)
    for place, fault in enumerate(TOLD):
        for number in range(SIZE):
            bench = set_up(condition, seed=SEED, number=number)
            rng = np.random.default_rng((SEED, place, number))
            value = FAULTS[fault].value
            if fault not in ("unit", "range-not-depth", "rows-exchanged"):
                value *= float(np.exp(rng.uniform(np.log(0.3), np.log(2.0))))
            context = Context(bench.rig.resolution_rad, rng)
            spoiled = spoil(bench.rows, {fault: value}, context)
            before = fit_model(bench.rows, bench.priors, model="axis-offset")
            try:
                after = fit_model(spoiled, bench.priors, model="axis-offset")
                found = tried(spoiled, bench.priors, bench, "axis-offset")
            except EstimationError:
                continue
            if effect(before, after, bench) < 2:
                continue
            total[fault] += 1
            if fault in found:
                right[fault] += 1
            elif found:
                wrong.append((fault, found[0]))
            else:
                missed[fault] += 1
    count, good = sum(total.values()), sum(right.values())
    said = f"{rows} rows: {good} of {count} named; missed {dict(missed)}; wrong {wrong}"
    tell(capsys, said)
    least = {14: 0.55, 24: 0.7, 60: 0.8}[rows]
    assert good >= least * count, said
    assert len(wrong) <= 0.15 * count, said
