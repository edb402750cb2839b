"""Evidence: structure of the PTB schema; with DCC_XSD set, the schema itself (`dcc_schema`)."""

from __future__ import annotations

import base64
from dataclasses import replace

import example
import numpy as np
import pytest
from dcc_schema import NAMES, PARTS, checked, texts
from lxml import etree

from calib.certificate.build import build_certificate
from calib.certificate.dcc import render_dcc
from calib.certificate.html import render_html
from calib.certificate.inputs import Administration, CertificateInputs
from calib.core.gate import Gate
from calib.uncertainty.conformity import ToleranceRule

AMENDED = replace(example.STATED, replaces="AG-1", amendment="serial number", received="2026-01-30")


def _parse(inputs: CertificateInputs) -> etree._Element:
    data = build_certificate(inputs)
    return checked(render_dcc(data, html=render_html(data)))


CASES = {
    "posterior": example.inputs,
    "fit": lambda: example.inputs(posterior=False),
    "simple rule": lambda: example.inputs(tolerance=ToleranceRule(0.02, "simple")),
    "silent": lambda: example.inputs(administration=Administration(), tolerance=None),
    "amended": lambda: example.inputs(administration=AMENDED),
    "failed": lambda: replace(example.inputs(), gates=(Gate("fit", False, "no"),)),
    "cameras": example.with_cameras,
    "hostile": example.hostile,
}


@pytest.mark.parametrize("case", CASES)
def test_the_parts_stand_in_their_order_and_none_is_empty(case: str) -> None:
    assert len(_parse(CASES[case]())) == len(PARTS)


def test_core_data_of_an_amendment() -> None:
    core = _parse(CASES["amended"]()).find("dcc:administrativeData/dcc:coreData", NAMES)
    assert core is not None
    assert texts(core, "dcc:uniqueIdentifier") == [example.inputs().issue.identifier]
    assert texts(core, "dcc:countryCodeISO3166_1") == ["CN"]
    assert texts(core, "dcc:receiptDate") == ["2026-01-30"]
    assert texts(core, "dcc:beginPerformanceDate") == ["2026-01-31"]
    assert texts(core, "dcc:issueDate") == ["2026-02-01"]
    assert texts(core, "dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier") == ["AG-1"]


def test_a_silent_manifest_invents_nothing() -> None:
    root = _parse(CASES["silent"]())
    assert texts(root, ".//dcc:calibrationLaboratory/dcc:contact/dcc:name/dcc:content") == [
        "not stated"
    ]
    assert texts(root, ".//dcc:item/dcc:identifications/dcc:identification/dcc:value") == [
        "not stated"
    ]
    assert texts(root, ".//dcc:countryCodeISO3166_1") == ["ZZ"]
    declarations = " ".join(texts(root, ".//dcc:statement/dcc:declaration/dcc:content"))
    assert "the date of performance given is that of issue" in declarations
    assert root.find(".//dcc:conformity", NAMES) is None
    conditions = texts(root, ".//dcc:influenceCondition//dcc:noQuantity/dcc:content")
    assert conditions == ["not stated", "not stated"]


def test_numbers_are_those_of_the_page_digit_for_digit() -> None:
    inputs = example.inputs(posterior=False)
    data = build_certificate(inputs)
    root = _parse(inputs)
    for parameter in data.parameters:
        real = _quantity(root, parameter.name)
        assert texts(real, "si:value") == [parameter.value]
        assert texts(real, ".//si:valueExpandedMU") == [parameter.expanded_uncertainty]
        assert texts(real, ".//si:coverageFactor") == [parameter.coverage_factor]
        assert texts(real, "si:unit") == [
            {"mm": r"\milli\metre", "mrad": r"\milli\radian"}[parameter.unit]
        ]
    shown = [line.depth.value for line in data.depths]
    depths = root.findall(".//dcc:quantity[dcc:name]", NAMES)
    found = [
        texts(q, "si:real/si:value")[0]
        for q in depths
        if texts(q, "dcc:name/dcc:content") == ["depth z"]
    ]
    assert found == shown


def _quantity(root: etree._Element, name: str) -> etree._Element:
    for quantity in root.iterfind(".//dcc:quantity", NAMES):
        if texts(quantity, "dcc:name/dcc:content") == [name]:
            real = quantity.find("si:real", NAMES)
            assert real is not None
            return real
    raise AssertionError(f"no quantity {name}")


def test_without_coverage_factor_the_interval_is_given() -> None:
    data = build_certificate(example.inputs())
    root = _parse(example.inputs())
    delta2 = _quantity(root, data.parameters[1].name)
    assert texts(delta2, ".//si:intervalMin") == [data.parameters[1].low]
    assert texts(delta2, ".//si:intervalMax") == [data.parameters[1].high]
    assert texts(delta2, ".//si:coverageProbability") == ["0.95"]
    assert delta2.find(".//si:coverageFactor", NAMES) is None


def test_the_covariance_can_be_inverted_again() -> None:
    inputs = example.inputs()
    root = _parse(inputs)
    rows = [
        [float(x) for x in text.split()]
        for text in texts(root, ".//dcc:list/dcc:quantity/si:realListXMLList/si:valueXMLList")
    ]
    covariance = inputs.calibration.instrument.parameters.covariance
    scale = np.array([1, 1e3, 1, 1])
    np.testing.assert_allclose(rows, covariance * np.outer(scale, scale), rtol=1e-9)
    assert np.linalg.eigvalsh(np.array(rows))[0] > 0
    units = texts(root, ".//dcc:list/dcc:quantity/si:realListXMLList/si:unitXMLList")
    assert units[1].split()[0] == r"\milli\radian\milli\metre"


def test_positions_carry_their_ellipsoid() -> None:
    inputs = example.inputs()
    root = _parse(inputs)
    regions = root.findall(".//si:ellipsoidalRegionMUXMLList", NAMES)
    assert len(regions) == len(inputs.evidence.depths)
    columns = [
        [float(x) for x in text.split()]
        for text in texts(regions[0], ".//si:covarianceXMLList/si:valueXMLList")
    ]
    expected = inputs.evidence.depths[0].position.covariance_mm2
    np.testing.assert_allclose(columns, expected, rtol=1e-9)
    assert float(texts(regions[0], "si:coverageFactorXMLList")[0]) > 2


def test_each_depth_says_what_its_uncertainty_is_made_of() -> None:
    inputs = example.with_cameras()
    root = _parse(inputs)
    lists = [
        element
        for element in root.iterfind(".//dcc:result/dcc:data/dcc:list", NAMES)
        if texts(element, "dcc:name/dcc:content")
        == ["contributions to the standard uncertainty of depth"]
    ]
    for element, depth in zip(lists, build_certificate(inputs).depths, strict=True):
        names = texts(element, "dcc:quantity/dcc:name/dcc:content")
        assert names == [source.label for source in depth.contributions]
        assert "intrinsics of C1" in names
        values = texts(element, "dcc:quantity/si:real/si:value")
        assert values == [source.value for source in depth.contributions]
        assert set(texts(element, "dcc:quantity/si:real/si:unit")) == {r"\milli\metre"}


def test_budget_and_expanded_uncertainty_are_those_of_the_page() -> None:
    inputs = example.with_cameras()
    root = _parse(inputs)
    data = build_certificate(inputs)

    def named(name: str):
        lists = root.iterfind(".//dcc:result/dcc:data/dcc:list", NAMES)
        return [e for e in lists if "".join(texts(e, "dcc:name/dcc:content")).startswith(name)]

    for element, depth in zip(named("uncertainty budget"), data.depths, strict=True):
        lines = element.findall("dcc:list", NAMES)
        for line, printed in zip(lines, depth.budget, strict=True):
            assert texts(line, "dcc:name/dcc:content") == [printed.quantity]
            values = [float(v) for v in texts(line, "dcc:quantity/si:real/si:value")]
            estimate, sensitivity, contribution, share = values
            (u,) = texts(line, ".//si:valueStandardMU")
            assert estimate == float(printed.estimate)
            assert u == printed.standard_uncertainty
            assert share == float(printed.share)
            assert abs(sensitivity) * float(u) == pytest.approx(contribution, rel=0.06)
    stated = [*data.parameters, *(d.depth for d in data.depths), *(e for e, _ in data.checks)]
    stated = [*stated, *data.lengths]
    stated = [r for r in stated if r.from_interval and r.coverage_factor]
    for element, result in zip(named("expanded uncertainty"), stated, strict=True):
        values = texts(element, "dcc:quantity/si:real/si:value")
        assert values == [result.expanded_uncertainty, result.coverage_factor]


def test_conformity_is_said_for_each_depth_and_for_all() -> None:
    inputs = example.inputs()
    root = _parse(inputs)
    each = texts(root, ".//dcc:metaData/dcc:conformity")
    assert len(each) == len(inputs.evidence.depths) + len(inputs.evidence.checks)
    assert set(each) <= {"pass", "conditionalPass", "conditionalFail", "fail"}
    assert texts(root, ".//dcc:statement/dcc:conformity") == ["pass"]


def test_a_failed_calibration_says_so_first_and_states_no_conformity() -> None:
    root = _parse(CASES["failed"]())
    first = root.find(".//dcc:statements/dcc:statement", NAMES)
    assert first is not None
    assert texts(first, "dcc:name/dcc:content") == ["Not to be used"]
    assert root.find(".//dcc:conformity", NAMES) is None


def test_the_page_is_embedded() -> None:
    inputs = example.inputs()
    root = _parse(inputs)
    (encoded,) = texts(root, "dcc:document/dcc:dataBase64")
    html = render_html(build_certificate(inputs))
    assert base64.b64decode(encoded).decode() == html


def test_hostile_text_stays_text() -> None:
    root = _parse(example.hostile())
    text = " ".join(str(t) for t in root.itertext())
    assert text.count("<script>alert('x')</script> \"quoted\" & ]]>") > 10
    assert not [e for e in root.iter() if etree.QName(e).localname == "script"]
