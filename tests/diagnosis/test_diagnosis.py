"""Mistakes of a lab are named, and rigs without any are left alone.

Evidence: simulated truth, where the mistake was made on purpose. Negative controls: the same rigs
without it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty_rigs import fitted, tried_on

from calib.diagnosis.engine import Tried
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.session import RowHistory, row_history
from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.mirror.problem import Mirror
from calib.rows.common_errors import CommonErrors
from calib.simulate.faults import FAULTS

NAMED = (
    "range-not-depth",
    "reference-bias-far",
    "reading-step",
    "reading-drift",
    "backlash",
    "c1-distortion-left-in",
    "c1-principal-point",
    "c1-focal-length",
    "rows-exchanged",
    "group-reference",
    "unit",
    "rehomed",
)


@pytest.mark.parametrize("fault", NAMED)
def test_a_mistake_is_named_first(fault: str, tmp_path: Path) -> None:
    assert tried_on(tmp_path, fault).named[0] == fault


@pytest.mark.parametrize(("rows", "wrong"), [(12, 3), (24, 8)])
def test_some_wrong_depths_are_no_backlash(rows: int, wrong: int, tmp_path: Path) -> None:
    """Negative control: rows that fall into two classes are not of two sides of approach."""
    seen, priors, _, dataset = fitted(tmp_path, seed=2, rows=rows)
    z = seen.z_mm.copy()
    z[np.random.default_rng(2).choice(rows, wrong, replace=False)] *= 1.06
    spoilt = replace(seen, z_mm=z)
    fit = fit_model(spoilt, priors, model="axis-offset")
    found = Tried.of(spoilt, priors, fit, row_history(dataset), is_left=False)
    assert found is not None
    assert "backlash" not in found.named
    assert not list(found._suspects()), "of so spoilt a fit references can tell no cause"


def test_a_reference_from_the_front_of_a_lens_is_named(tmp_path: Path) -> None:
    assert tried_on(tmp_path, "reference-offset", 60.0).named[0] == "reference-offset"


def test_an_offset_that_the_model_allows_for_is_named_as_such(tmp_path: Path) -> None:
    rows, priors, fit, dataset = fitted(tmp_path, "reference-offset", 60.0)
    del fit
    free = Priors({**priors.stated, "reference_offset_mm": (0.0, 50.0)})
    refit = fit_model(rows, free, model="axis-offset")
    found = Tried.of(rows, free, refit, row_history(dataset), is_left=False)
    assert found is not None
    assert found.named[0] == "reference-offset"
    outcome = found.outcomes["reference-offset"]
    assert outcome.is_carried
    assert abs(float(outcome.values[0]) - 60) < 3 * float(np.sqrt(outcome.covariance[0, 0]))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_nothing_is_named_on_a_clean_rig(seed: int, outliers: float, tmp_path: Path) -> None:
    assert tried_on(tmp_path, seed=seed, outlier_share=outliers).named == ()


@pytest.mark.parametrize(
    ("fault", "size"),
    [
        ("reading-step", 0.2),
        ("reading-drift", -0.3),
        ("rehomed", 0.2),
        ("c1-focal-length", 4.0),
        ("c1-distortion-left-in", -0.3),
    ],
)
def test_its_size_is_found(fault: str, size: float, tmp_path: Path) -> None:
    hypothesis = HYPOTHESES[fault]
    outcome = tried_on(tmp_path, fault, size, rows=40).outcomes[fault]
    std = float(np.sqrt(outcome.covariance[0, 0])) / hypothesis.per_unit
    found = float(outcome.values[0]) / hypothesis.per_unit
    # Four standard uncertainties, which must be far below what is to be found.
    assert std < abs(size) / 8
    assert abs(found - size) < 4 * std


def test_a_step_is_found_where_it_is(tmp_path: Path) -> None:
    assert tried_on(tmp_path, "reading-step").outcomes["reading-step"].at == "g13"
    assert tried_on(tmp_path, "rehomed").outcomes["rehomed"].at == "g09 to g16"


def test_approaches_tell_of_backlash_at_few_rows(tmp_path: Path) -> None:
    rows, priors, fit, dataset = fitted(tmp_path, rows=8)
    side = np.array([1.0, 1, -1, 1, -1, -1, 1, -1])
    spoiled = replace(rows, alpha2_rad=rows.alpha2_rad + np.deg2rad(0.15) * side)
    history = row_history(dataset)
    known = replace(history, approach=dict(zip(rows.ids, side.tolist(), strict=True)))
    from calib.fit.robust import fit_model

    refit = fit_model(spoiled, priors, model="axis-offset")
    del fit
    with_sides = Tried.of(spoiled, priors, refit, known, is_left=False)
    without = Tried.of(spoiled, priors, refit, history, is_left=False)
    assert with_sides is not None
    assert without is not None
    assert with_sides.named[0] == "backlash"
    gains = [found.outcomes["backlash"].gain for found in (with_sides, without)]
    assert gains[0] > gains[1] + 3


def test_times_order_the_rows(tmp_path: Path) -> None:
    rows, priors, _, dataset = fitted(tmp_path, "reading-drift")
    order = np.random.default_rng(0).permutation(len(rows))
    shuffled = rows.take(order)
    history = row_history(dataset)
    times = {name: 10.0 * i for i, name in enumerate(rows.ids)}
    from calib.fit.robust import fit_model

    fit = fit_model(shuffled, priors, model="axis-offset")
    found = Tried.of(shuffled, priors, fit, replace(history, time_s=times), is_left=False)
    assert found is not None
    assert found.named[0] == "reading-drift"


@pytest.mark.parametrize("fault", ["reading-step", "c1-principal-point", "range-not-depth"])
def test_a_rig_in_the_mirror_has_the_same_causes(fault: str, tmp_path: Path) -> None:
    rows, priors, fit, dataset = fitted(tmp_path, fault)
    mirrored = Mirror.of(CommonErrors()).rows(rows)
    right = Tried.of(rows, priors, fit, row_history(dataset), is_left=False)
    # Mirrored twice: a rig on the left whose rows went into the mirror.
    again = Mirror.of(CommonErrors()).rows(mirrored)
    left = Tried.of(again, priors, fit, row_history(dataset), is_left=True)
    assert right is not None
    assert left is not None
    assert left.named == right.named


def test_rows_too_few_give_no_diagnosis(tmp_path: Path) -> None:
    rows, priors, fit, dataset = fitted(tmp_path, rows=6)
    few = rows.take(np.arange(4))
    step = row_history(dataset).step_rad
    fewer = replace(fit, rejected=fit.rejected[:4])
    assert Tried.of(few, priors, fewer, RowHistory({}, {}, step), is_left=False) is None


def test_every_hypothesis_has_a_fault_to_test_it() -> None:
    assert set(HYPOTHESES) <= set(FAULTS)
