"""The certificate as a PTB Digital Calibration Certificate, version 3.3.0 (https://ptb.de/dcc).

Numbers are those of the other forms, digit for digit; covariances alone have more, since programs
invert them. The HTML form is embedded as the document for people.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence

from lxml import etree

from calib.certificate.data import (
    CertificateData,
    DepthLine,
    Judgement,
    Matrix,
    Region,
    Result,
)
from calib.certificate.wording import METHOD_REFERENCE, NORMS, NOT_STATED

DCC = "https://ptb.de/dcc"
SI = "https://ptb.de/si"
VERSION = "3.3.0"
LANGUAGE = "en"
COVERAGE = "0.95"

UNITS = {
    "mm": r"\milli\metre",
    "mrad": r"\milli\radian",
    "1": r"\one",
    "°C": r"\degreecelsius",
    "%": r"\percent",
}
"""D-SI names of the printed units."""

Content = etree._Element


def _dcc(tag: str, *children: Content, text: str | None = None, **attributes: str) -> Content:
    """Return an element of the DCC's namespace."""
    return _element(f"{{{DCC}}}{tag}", children, text, attributes)


def _si(tag: str, *children: Content, text: str | None = None) -> Content:
    """Return an element of D-SI's namespace."""
    return _element(f"{{{SI}}}{tag}", children, text, {})


def _element(
    name: str, children: Iterable[Content], text: str | None, attributes: dict[str, str]
) -> Content:
    element = etree.Element(name, attributes, nsmap={"dcc": DCC, "si": SI})
    element.text = text
    element.extend(list(children))
    return element


def _text(tag: str, words: str) -> Content:
    """Return a text or rich content of one paragraph."""
    return _dcc(tag, _dcc("content", text=words, lang=LANGUAGE))


def render_dcc(data: CertificateData, *, html: str) -> bytes:
    """Return the DCC as UTF-8 XML with `html` embedded."""
    root = _dcc(
        "digitalCalibrationCertificate",
        _administration(data),
        _results(data),
        _document(data, html),
        schemaVersion=VERSION,
    )
    etree.cleanup_namespaces(root)
    etree.indent(root)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8")


def _document(data: CertificateData, html: str) -> Content:
    return _dcc(
        "document",
        _text("name", "Certificate for people"),
        _dcc("fileName", text=f"{data.identifier}.html"),
        _dcc("mimeType", text="text/html"),
        _dcc("dataBase64", text=base64.b64encode(html.encode()).decode("ascii")),
    )


def _administration(d: CertificateData) -> Content:
    return _dcc(
        "administrativeData",
        _software("dccSoftware", d.software[:1]),
        _core(d),
        _dcc("items", _item(d)),
        _dcc("calibrationLaboratory", _contact("contact", d.laboratory, d.address, d.country)),
        _persons(d),
        _contact("customer", d.customer, None, None),
        _dcc("statements", *_statements(d)),
    )


def _software(tag: str, software: Sequence[tuple[str, str]]) -> Content:
    return _dcc(
        tag,
        *(
            _dcc("software", _text("name", name), _dcc("release", text=version))
            for name, version in software
        ),
    )


def _core(d: CertificateData) -> Content:
    amended = []
    if d.replaces is not None:
        amended = [
            _dcc(
                "reportAmendedSubstituted",
                _dcc("typeOfChange", text="amended"),
                _dcc("replacedUniqueIdentifier", text=d.replaces),
            )
        ]
    return _dcc(
        "coreData",
        _dcc("countryCodeISO3166_1", text=d.country),
        _dcc("usedLangCodeISO639_1", text=LANGUAGE),
        _dcc("mandatoryLangCodeISO639_1", text=LANGUAGE),
        _dcc("uniqueIdentifier", text=d.identifier),
        _dcc(
            "identifications",
            _identification("calibrationLaboratory", d.sha256, "SHA-256 of the dataset"),
            _identification("calibrationLaboratory", d.dataset, "name of the dataset"),
        ),
        *([] if d.received == NOT_STATED else [_dcc("receiptDate", text=d.received)]),
        _dcc("beginPerformanceDate", text=d.performed),
        _dcc("endPerformanceDate", text=d.performed),
        _dcc("performanceLocation", text="other"),
        _dcc("issueDate", text=d.issued),
        *amended,
    )


def _identification(issuer: str, value: str, name: str) -> Content:
    return _dcc(
        "identification",
        _dcc("issuer", text=issuer),
        _dcc("value", text=value),
        _text("name", name),
    )


def _item(d: CertificateData) -> Content:
    return _dcc(
        "item",
        _text("name", d.item),
        _text("description", f"Condition on receipt: {d.condition}"),
        _dcc("identifications", _identification("manufacturer", d.serial, "serial number")),
    )


def _contact(tag: str, name: str, address: str | None, country: str | None) -> Content:
    place = [_text("further", NOT_STATED if address is None else address)]
    if country is not None:
        place.insert(0, _dcc("countryCode", text=country))
    return _dcc(tag, _text("name", name), _dcc("location", *place))


def _persons(d: CertificateData) -> Content:
    return _dcc(
        "respPersons",
        _dcc(
            "respPerson",
            _dcc("person", _text("name", d.approved_by)),
            _dcc("role", text="authorised by"),
            _dcc("mainSigner", text="true"),
        ),
        _dcc(
            "respPerson",
            _dcc("person", _text("name", d.operator)),
            _dcc("role", text="calibrated by"),
            _dcc("mainSigner", text="false"),
        ),
    )


def _statements(d: CertificateData) -> list[Content]:
    said = [
        ("Place of calibration", d.place),
        ("Date of calibration", _dated(d)),
        ("Traceability", d.traceability),
        ("Deviations from the method", d.deviations),
        ("Summary", d.summary),
        *((s.label, s.value) for s in d.statements),
        *((f"Caution {i}", caution) for i, caution in enumerate(d.cautions, start=1)),
    ]
    if d.prohibition is not None:
        said.insert(0, ("Not to be used", d.prohibition))
    if d.amendment is not None:
        said.append(("Reason of the amendment", d.amendment))
    if d.country == "ZZ":
        said.append(("Country", f"{NOT_STATED}; ZZ is a user-assigned code"))
    statements = [_statement(name, words) for name, words in said]
    tolerance = "" if d.tolerance is None else f" Tolerance {d.tolerance}."
    conclusion = _statement("Conformity", f"{d.conclusion.words}.{tolerance} {d.rule}")
    if d.conclusion.verdict is not None:
        conclusion.append(_dcc("conformity", text=d.conclusion.verdict))
    return [*statements, conclusion]


def _dated(d: CertificateData) -> str:
    if d.calibrated == NOT_STATED:
        return f"{NOT_STATED}; the date of performance given is that of issue"
    return d.calibrated


def _statement(name: str, words: str) -> Content:
    return _dcc("statement", _text("name", name), _text("declaration", words))


def _results(d: CertificateData) -> Content:
    results = [_measurement("Parameters of the instrument", _parameters(d))]
    if d.depths:
        results.append(_measurement("Depth", [_depth(line) for line in d.depths]))
    if d.checks:
        found = [_checked(error, judged) for error, judged in d.checks]
        results.append(_measurement("Independent check of depth", found, d.check_summary))
    if d.lengths:
        found = [_result(e.name, e.meaning, _quantity(e)) for e in d.lengths]
        results.append(_measurement("Error of length", found, d.length_summary))
    return _dcc(
        "measurementResults",
        _dcc("usedMethods", _method(d)),
        _software("usedSoftware", d.software),
        _dcc("influenceConditions", *_conditions(d)),
        *results,
    )


def _method(d: CertificateData) -> Content:
    return _dcc(
        "usedMethod",
        _text("name", "Calibration of active gazing"),
        _text("description", d.method),
        *(_dcc("norm", text=norm) for norm in NORMS),
        _dcc("reference", text=METHOD_REFERENCE),
    )


def _conditions(d: CertificateData) -> list[Content]:
    return [
        _dcc("influenceCondition", _text("name", name), _dcc("data", _condition(value, unit)))
        for name, value, unit in (
            ("temperature", d.temperature_c, "°C"),
            ("relative humidity", d.humidity_percent, "%"),
        )
    ]


def _condition(value: str | None, unit: str) -> Content:
    if value is None:
        return _dcc("quantity", _text("noQuantity", NOT_STATED))
    return _dcc("quantity", _si("real", _si("value", text=value), _si("unit", text=UNITS[unit])))


def _measurement(name: str, results: Sequence[Content], words: str | None = None) -> Content:
    described = [] if words is None else [_text("description", words)]
    return _dcc("measurementResult", _text("name", name), *described, _dcc("results", *results))


def _result(name: str, words: str, *data: Content) -> Content:
    return _dcc("result", _text("name", name), _text("description", words), _dcc("data", *data))


def _parameters(d: CertificateData) -> list[Content]:
    found = [_result(p.name, f"{p.meaning}; {p.remark}", _quantity(p)) for p in d.parameters]
    return [*found, _matrix(d.covariance)]


def _matrix(m: Matrix) -> Content:
    """Return a covariance matrix as a list of its rows, each with its units."""
    rows = [
        _dcc(
            "quantity",
            _text("name", name),
            _si(
                "realListXMLList",
                _si("valueXMLList", text=" ".join(row)),
                _si("unitXMLList", text=" ".join(UNITS[m.units[i]] + UNITS[u] for u in m.units)),
            ),
        )
        for i, (name, row) in enumerate(zip(m.names, m.rows, strict=True))
    ]
    words = f"rows and columns: {', '.join(m.names)}"
    return _result("Covariance of the parameters", words, _dcc("list", *rows))


def _quantity(r: Result, judged: Judgement | None = None) -> Content:
    metadata = [] if judged is None else [_dcc("measurementMetaData", _judged(judged))]
    return _dcc("quantity", _text("name", r.name), _real(r), *metadata)


def _real(r: Result) -> Content:
    return _si(
        "real",
        _si("value", text=r.value),
        _si("unit", text=UNITS[r.unit]),
        *_uncertainty(r),
    )


def _uncertainty(r: Result) -> list[Content]:
    if r.expanded_uncertainty is not None and r.coverage_factor is not None:
        stated = _si(
            "expandedMU",
            _si("valueExpandedMU", text=r.expanded_uncertainty),
            _si("coverageFactor", text=r.coverage_factor),
            _si("coverageProbability", text=COVERAGE),
        )
    elif r.low is not None and r.high is not None:
        stated = _si(
            "coverageIntervalMU",
            _si("valueStandardMU", text=r.standard_uncertainty or "NaN"),
            _si("intervalMin", text=r.low),
            _si("intervalMax", text=r.high),
            _si("coverageProbability", text=COVERAGE),
        )
    elif r.standard_uncertainty is not None:
        stated = _si("standardMU", _si("valueStandardMU", text=r.standard_uncertainty))
    else:
        return []
    return [_si("measurementUncertaintyUnivariate", stated)]


def _judged(j: Judgement) -> Content:
    words = (
        f"tolerance ±{j.limit} mm, tolerance / U {j.ratio}, probability of conformance "
        f"{j.probability} %"
    )
    if j.warning is not None:
        words += f"; {j.warning}"
    return _dcc("metaData", _text("declaration", words), _dcc("conformity", text=j.verdict))


def _depth(line: DepthLine) -> Content:
    words = f"at x1c = {line.ray}; {line.depth.remark}"
    if line.extrapolated:
        words += "; extrapolated: outside the calibrated range"
    return _result(
        f"Depth {line.depth.value} mm",
        words,
        _quantity(line.depth, line.judgement),
        _position(line.region),
    )


def _position(region: Region) -> Content:
    unit = UNITS["mm"]
    three = f"{unit} {unit} {unit}"
    squared = f"{unit}\\tothe{{2}}"
    columns = [
        _si(
            "columnXMLList",
            _si(
                "covarianceXMLList",
                _si("valueXMLList", text=" ".join(column)),
                _si("unitXMLList", text=" ".join([squared] * 3)),
            ),
        )
        for column in region.covariance
    ]
    return _dcc(
        "quantity",
        _text("name", "position x, y, z"),
        _si(
            "realListXMLList",
            _si("valueXMLList", text=" ".join(region.position)),
            _si("unitXMLList", text=three),
            _si(
                "measurementUncertaintyMultivariateXMLList",
                _si(
                    "ellipsoidalRegionMUXMLList",
                    _si("covarianceMatrixXMLList", *columns),
                    _si("coverageFactorXMLList", text=region.coverage_factor),
                    _si("coverageProbabilityXMLList", text=COVERAGE),
                ),
            ),
        ),
    )


def _checked(error: Result, judged: Judgement | None) -> Content:
    return _result(f"Point {error.name}", error.meaning, _quantity(error, judged))
