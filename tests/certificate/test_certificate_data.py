"""Evidence: property, and the figures of the results the certificate is made from."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace
from decimal import Decimal

import example
import numpy as np
import pytest

from calib.certificate.build import build_certificate
from calib.certificate.data import CertificateData
from calib.certificate.inputs import Administration, CertificateInputs
from calib.certificate.numbers import LISTED_CHECKS
from calib.core.gate import Gate
from calib.results.wording import NOT_STATED, clean
from calib.uncertainty.certified import CheckedDepth, check_depth
from calib.uncertainty.conformity import ToleranceRule
from calib.uncertainty.evidence import NotCertified


def _values(data: CertificateData) -> dict[str, str]:
    return {entry.label: entry.value for line in data.fields for entry in line}


def test_every_field_of_iso_17025_is_there_as_stated() -> None:
    data = build_certificate(example.inputs())
    values = _values(data)
    stated = example.STATED
    assert values["Laboratory"] == stated.laboratory
    assert values["Address"] == stated.address
    assert values["Customer"] == stated.customer
    assert values["Item calibrated"] == stated.instrument
    assert values["Serial number"] == stated.serial
    assert values["Condition"] == stated.condition
    assert values["Place of calibration"] == stated.location
    assert values["Date of calibration"] == "2026-01-31"
    assert values["Date of issue"] == "2026-02-01"
    assert values["Conditions"] == "temperature 21.3 °C; relative humidity 45 %"
    assert values["Calibrated by"] == stated.operator
    assert values["Authorised by"] == stated.approved_by
    assert values["Deviations"] == "none"
    assert values["Traceability"].startswith("The scale of depth is that of the reference: stereo")
    statements = " ".join(s.value for s in data.statements)
    assert "relate only to the item calibrated" in statements
    assert "not be reproduced except in full" in statements
    assert "No accreditation is claimed" in statements


def test_what_the_manifest_leaves_out_is_not_stated() -> None:
    data = build_certificate(example.inputs(administration=Administration(), tolerance=None))
    values = _values(data)
    silent = set(values) - {"Method", "Traceability", "Date of issue"}
    assert {values[label] for label in silent} == {NOT_STATED}
    assert len(silent) == 13
    assert data.country == "ZZ"
    assert data.performed == data.issued
    assert data.conclusion.verdict is None
    assert "no statement of conformity" in data.conclusion.words
    assert all(line.judgement is None for line in data.depths)


def test_one_condition_alone_does_not_hide_the_other() -> None:
    data = build_certificate(example.inputs(administration=Administration(temperature_c=20.0)))
    assert _values(data)["Conditions"] == "temperature 20 °C; relative humidity not stated"


def test_a_reference_without_name_is_said_so() -> None:
    inputs = example.inputs()
    inputs = replace(inputs, calibration=replace(inputs.calibration, reference=None))
    assert _values(build_certificate(inputs))["Traceability"].startswith(NOT_STATED)


def test_numbers_are_rounded_to_two_digits_of_their_uncertainty() -> None:
    inputs = example.inputs(posterior=False)
    data = build_certificate(inputs)
    for line, certified in zip(data.depths, inputs.evidence.depths, strict=True):
        shown = line.depth
        u = shown.standard_uncertainty if shown.from_interval else shown.expanded_uncertainty
        assert u is not None
        place = Decimal(u).as_tuple().exponent
        assert len(Decimal(u).as_tuple().digits) == 2
        assert Decimal(shown.value).as_tuple().exponent == place
        assert shown.low is not None
        assert shown.high is not None
        interval = certified.result.interval
        assert Decimal(shown.low) <= Decimal(repr(interval.low))
        assert Decimal(shown.high) >= Decimal(repr(interval.high))
        half = max(certified.result.z_mm - interval.low, interval.high - certified.result.z_mm)
        assert float(line.relative) >= 100 * half / certified.result.z_mm


def test_each_line_has_u_and_k_marked_where_they_are_of_an_interval() -> None:
    for posterior in (True, False):
        inputs = example.inputs(posterior=posterior)
        data = build_certificate(inputs)
        for line, certified in zip(data.depths, inputs.evidence.depths, strict=True):
            shown, stated = line.depth, certified.result
            assert shown.from_interval == (not stated.linear_valid)
            half = (stated.interval.high - stated.interval.low) / 2
            assert shown.expanded_uncertainty is not None
            # Rounded up, by less than a place of u.
            assert half <= float(shown.expanded_uncertainty) <= 1.1 * half
            u = stated.standard_uncertainty_mm
            assert u is not None
            assert float(shown.coverage_factor or 0) == pytest.approx(half / u, abs=0.0051)
    posterior_data = build_certificate(example.inputs(posterior=True))
    assert all(1.7 < float(p.coverage_factor or 0) < 2.2 for p in posterior_data.parameters)
    assert all(p.from_interval for p in posterior_data.parameters)
    fitted = build_certificate(example.inputs(posterior=False))
    assert {p.coverage_factor for p in fitted.parameters} == {"2.07"}  # t, 22 degrees of freedom
    assert not any(p.from_interval for p in fitted.parameters)
    # A check without an upper limit has no u, and so no k.
    bounded = [error for error, _ in posterior_data.checks if error.standard_uncertainty]
    assert all(error.coverage_factor for error in bounded)
    assert bounded
    assert all(error.coverage_factor for error in posterior_data.lengths)


def test_parameters_of_a_posterior_state_its_shortest_interval() -> None:
    inputs = example.inputs()
    data = build_certificate(inputs)
    draws = inputs.calibration.instrument.parameters.draws
    assert draws is not None
    delta2 = data.parameters[1]
    assert delta2.unit == "mrad"
    inside = np.mean(
        (1e3 * draws[:, 1] >= float(delta2.low or 0))
        & (1e3 * draws[:, 1] <= float(delta2.high or 0))
    )
    # Rounded outwards to two digits of u: 95 % and up to 0.2 % more.
    assert 0.95 <= inside < 0.957
    assert delta2.remark == "identified by the data"


def test_the_method_names_outliers_and_widened_uncertainties() -> None:
    method = _values(build_certificate(example.inputs()))["Method"]
    assert "26 rows" in method
    assert "1 row disagrees with the others (7)" in method
    assert "widened by a factor of 1.31" in method  # as the report has it


def test_the_worst_statement_in_the_calibrated_range_decides() -> None:
    inputs = example.inputs()
    tight = ToleranceRule(0.006, "guard-band")
    evidence = example.evidence(True, tight)
    data = build_certificate(replace(inputs, evidence=evidence))
    order = ["pass", "conditionalPass", "conditionalFail", "fail"]
    inside = [
        line.judgement.verdict for line in data.depths if line.judgement and not line.extrapolated
    ]
    inside += [
        judged.verdict
        for (_, judged), check in zip(data.checks, evidence.checks, strict=True)
        if judged and not check.extrapolated
    ]
    assert data.conclusion.verdict == max(inside, key=order.index) != "pass"


def test_depths_outside_the_calibration_are_marked_and_do_not_decide() -> None:
    data = build_certificate(example.inputs())
    assert [line.extrapolated for line in data.depths] == [False, False, False, True]
    assert any("extrapolated" in caution for caution in data.cautions)
    assert "3 certified depths" in data.conclusion.basis


def test_a_failed_check_forbids_use_and_withholds_every_statement() -> None:
    inputs = replace(
        example.inputs(), gates=(Gate("convergence", False, "R-hat 1.4"), Gate("fit", True, "ok"))
    )
    data = build_certificate(inputs)
    assert data.prohibition is not None
    assert "convergence" in data.prohibition
    assert data.conclusion.verdict is None
    assert all(line.judgement is None for line in data.depths)
    assert all(judged is None for _, judged in data.checks)


def test_a_depth_in_range_that_cannot_be_certified_withholds_the_conclusion() -> None:
    inputs = example.inputs()
    for depth, verdict in ((700.0, None), (3000.0, "pass")):
        evidence = replace(inputs.evidence, not_certified=(NotCertified(depth, "no upper limit"),))
        data = build_certificate(replace(inputs, evidence=evidence))
        assert data.conclusion.verdict == verdict
        assert any("no upper limit" in caution for caution in data.cautions)


def _with_checks(errors: list[float]) -> CertificateInputs:
    inputs = example.inputs()
    checks: tuple[CheckedDepth, ...] = tuple(
        check_depth(
            name=str(i),
            reference_mm=800.0,
            u_reference_mm=0.5,
            z_mm=800.0 + error,
            u_mm=3.0,
            low95_mm=794.0 + error,
            high95_mm=806.0 + error,
            calibrated_mm=example.CALIBRATED_MM,
            tolerance=ToleranceRule(0.05, "simple"),
        )
        for i, error in enumerate(errors)
    )
    return replace(inputs, evidence=replace(inputs.evidence, checks=checks))


def test_a_contradicting_reference_rules_out_a_pass() -> None:
    agreeing = build_certificate(_with_checks([1, -2, 3, 5, -8]))
    assert agreeing.conclusion.verdict == "pass"
    # 10 mm are within the tolerance of 40 mm, and far beyond U = 6 mm.
    contradicting = build_certificate(_with_checks([10, -12, 11, 2]))
    assert contradicting.conclusion.verdict == "conditionalPass"
    assert "contradicts" in contradicting.conclusion.basis
    assert any("only 1 of 4" in caution for caution in contradicting.cautions)


def test_a_check_without_upper_limit_is_printed_and_fails_nothing_silently() -> None:
    data = build_certificate(example.inputs())
    error, judged = data.checks[-1]
    assert error.low is None
    assert judged is not None
    assert judged.verdict != "pass"


def test_an_amendment_names_what_it_replaces() -> None:
    stated = replace(example.STATED, replaces="AG-1", amendment="serial number corrected")
    data = build_certificate(example.inputs(administration=stated))
    assert (data.replaces, data.amendment) == ("AG-1", "serial number corrected")
    assert build_certificate(example.inputs()).replaces is None


def test_the_next_calibration_is_dated_only_if_asked_for() -> None:
    stated = replace(example.STATED, next_calibration="2027-03-01")
    data = build_certificate(example.inputs(administration=stated))
    assert ("2027-03-01", True) in [(s.value, s.label.startswith("Next")) for s in data.statements]
    assert not any("Next" in s.label for s in build_certificate(example.inputs()).statements)


def test_shares_of_the_printed_budget_add_up() -> None:
    data = build_certificate(example.inputs())
    budgets = data.annexes[0].tables[1:]
    assert len(budgets) >= 3
    for table in budgets:
        *parts, total = (float(row[-1]) for row in table.rows)
        assert total == 100
        # Each share is rounded to 0.1.
        assert math.isclose(sum(parts), 100, abs_tol=0.05 * len(parts) + 1e-9)


def test_slight_inputs_share_a_row_and_parameters_never_do() -> None:
    inputs = example.inputs()
    first, *others = inputs.evidence.depths
    plain = first.result.budget
    slight = [replace(row, share_percent=0.01) for row in plain.rows]
    budget = replace(plain, rows=tuple(slight))
    changed = replace(first, result=replace(first.result, budget=budget))
    evidence = replace(inputs.evidence, depths=(changed, *others))
    table = build_certificate(replace(inputs, evidence=evidence)).annexes[0].tables[1]
    names = [row[0] for row in table.rows]
    known = [f"{name}, above known" for name in ("δ2", "Z_a", "e")]
    assert names == ["L_b + e / sin α", *known, "2 further inputs", "depth z"]
    assert table.rows[4][-1] == "0.0"
    assert plain.correlations == ()


def test_parameters_are_printed_with_a_covariance_that_can_be_used() -> None:
    """Seven digits: positive definite as read, though L_b and e correlate to -0.9997."""
    inputs = example.inputs()
    p = inputs.calibration.instrument.parameters
    annex = next(a for a in build_certificate(inputs).annexes if a.title.startswith("Parameters"))
    table = annex.tables[0]
    printed = np.array([[float(cell) for cell in row[3:]] for row in table.rows])
    scale = np.array([1e3 if name.endswith("rad") else 1.0 for name in p.names])
    np.testing.assert_allclose(printed, p.covariance * np.outer(scale, scale), rtol=1e-6)
    assert np.linalg.eigvalsh(printed)[0] > 0


@pytest.mark.parametrize("cameras", [False, True])
def test_contributions_add_up_in_quadrature_and_cameras_have_a_line_each(cameras: bool) -> None:
    inputs = example.with_cameras() if cameras else example.inputs()
    data = build_certificate(inputs)
    annex = data.annexes[0]
    summary, first = annex.tables[:2]
    sources = [row[0] for row in summary.rows]
    named = ["intrinsics of C1", "pose of C2 (stereo reference)"] if cameras else []
    assert sources == ["parameters", *named, "x1c", "α2, resolution", "together"]
    assert [row[0] for row in first.rows if row[0] in named] == named
    assert ("a correction of 0 mm" in annex.introduction) == cameras
    for k, depth in enumerate(inputs.evidence.depths, start=1):
        *parts, together = (float(row[k]) for row in summary.rows)
        u = depth.result.budget.standard_uncertainty
        # Parts are rounded to a digit more than u has, u to its second digit.
        assert math.isclose(math.hypot(*parts), u, rel_tol=0.02)
        assert math.isclose(together, u, rel_tol=0.06)
        assert [e.value for e in data.depths[k - 1].contributions] == [
            row[k] for row in summary.rows[:-1]
        ]


def test_without_a_tolerance_no_column_speaks_of_conformance() -> None:
    judged, plain = (
        next(a for a in build_certificate(i).annexes if a.title == "Independent check").tables[0]
        for i in (example.inputs(), example.inputs(tolerance=None))
    )
    assert [c for c in judged.columns if c not in plain.columns] == ["Conformance / %"]
    for table in (judged, plain):
        assert {len(row) for row in table.rows} == {len(table.columns)}
        assert table.words[-1] == table.columns.index("Statement")
    assert [row[-1] for row in plain.rows][-1] == "extrapolated"


def test_what_holds_for_all_depths_is_said_once() -> None:
    annex = build_certificate(example.inputs()).annexes[0]
    assert annex.introduction.count("Effective degrees of freedom") == 1
    assert not any("Effective degrees of freedom" in table.note for table in annex.tables)
    # With degrees of freedom each depth has its own number.
    annex = build_certificate(example.inputs(posterior=False)).annexes[0]
    said = annex.introduction.count("Effective degrees of freedom")
    said += sum("Effective degrees of freedom" in table.note for table in annex.tables)
    assert said in (1, len(annex.tables) - 1)


def test_warnings_are_printed_as_sentences() -> None:
    warned = replace(example.inputs(), warnings=("readings without u2 are wider", "Stop!"))
    assert build_certificate(warned).cautions[-2:] == ("Readings without u2 are wider.", "Stop!")


def test_every_text_is_clean_whatever_the_manifest_says() -> None:
    forbidden = set("\x07\u202e\u202c\ud800\ufffe")
    found = list(_strings(build_certificate(example.hostile())))
    assert sum("<script>" in text for text in found) > 20
    for text in found:
        assert not forbidden & set(text)


def _strings(value: object):
    if isinstance(value, str):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _strings(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _strings(getattr(value, field.name))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (None, NOT_STATED),
        ("", NOT_STATED),
        (" \n\t ", NOT_STATED),
        ("a\nb  c", "a b c"),
        ("\u202eabc", "\ufffdabc"),
        ("bell\x07", "bell\ufffd"),
        ("שלום", "שלום"),
    ],
)
def test_clean(text: str | None, shown: str) -> None:
    assert clean(text) == shown


def test_of_very_many_checks_the_worst_are_listed() -> None:
    """Property: what is printed ends; summary and conclusion are of all checks."""
    plain = example.inputs()
    first = plain.evidence.checks[0]
    count = 3 * LISTED_CHECKS
    off = [0.01 * (i % 7 - 3) * (1 + (i % 50 == 0)) for i in range(count)]
    checks = tuple(
        replace(first, name=f"p{i}", z_mm=z, low95_mm=z - 1, high95_mm=z + 1)
        for i, z in enumerate(first.reference_mm + d for d in off)
    )
    data = build_certificate(replace(plain, evidence=replace(plain.evidence, checks=checks)))
    listed = [int(error.name[1:]) for error, _ in data.checks]
    assert len(listed) == LISTED_CHECKS
    assert listed == sorted(listed)
    assert {i for i in range(count) if abs(off[i]) > 0.03} <= set(listed)
    assert f"{count} points" in str(data.check_summary)
    assert f"Listed are the {LISTED_CHECKS} points" in str(data.check_summary)
    annex = next(a for a in data.annexes if a.title == "Independent check")
    assert [row[0] for row in annex.tables[0].rows] == [f"p{i}" for i in listed]
    assert f"The {LISTED_CHECKS} worst are listed" in annex.introduction
