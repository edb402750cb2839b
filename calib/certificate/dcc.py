"""The certificate as a PTB Digital Calibration Certificate, version 3.3.0 (https://ptb.de/dcc).

Numbers are those of the other forms, digit for digit; covariances alone have more, since programs
invert them. The HTML form is embedded as the document for people.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence

from lxml import etree

from calib.certificate.data import (
    CertificateData,
    DepthLine,
    Entry,
    Judgement,
    Matrix,
    Region,
    Result,
)
from calib.certificate.elements import LANGUAGE, UNITS, Content, dcc, rich_text, si
from calib.results.wording import METHOD_REFERENCE, NORMS, NOT_STATED

VERSION = "3.3.0"
COVERAGE = "0.95"


def render_dcc(data: CertificateData, *, html: str) -> bytes:
    """Return the DCC as UTF-8 XML with `html` embedded."""
    root = dcc(
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
    return dcc(
        "document",
        rich_text("name", "Certificate for people"),
        dcc("fileName", text=f"{data.identifier}.html"),
        dcc("mimeType", text="text/html"),
        dcc("dataBase64", text=base64.b64encode(html.encode()).decode("ascii")),
    )


def _administration(d: CertificateData) -> Content:
    return dcc(
        "administrativeData",
        _software("dccSoftware", d.software[:1]),
        _core(d),
        dcc("items", _item(d)),
        dcc("calibrationLaboratory", _contact("contact", d.laboratory, d.address, d.country)),
        _persons(d),
        _contact("customer", d.customer, None, None),
        dcc("statements", *_statements(d)),
    )


def _software(tag: str, software: Sequence[tuple[str, str]]) -> Content:
    return dcc(
        tag,
        *(
            dcc("software", rich_text("name", name), dcc("release", text=version))
            for name, version in software
        ),
    )


def _core(d: CertificateData) -> Content:
    amended = []
    if d.replaces is not None:
        amended = [
            dcc(
                "reportAmendedSubstituted",
                dcc("typeOfChange", text="amended"),
                dcc("replacedUniqueIdentifier", text=d.replaces),
            )
        ]
    return dcc(
        "coreData",
        dcc("countryCodeISO3166_1", text=d.country),
        dcc("usedLangCodeISO639_1", text=LANGUAGE),
        dcc("mandatoryLangCodeISO639_1", text=LANGUAGE),
        dcc("uniqueIdentifier", text=d.identifier),
        dcc(
            "identifications",
            _identification("calibrationLaboratory", d.sha256, "SHA-256 of the dataset"),
            _identification(
                "calibrationLaboratory", d.calibration_sha256, "SHA-256 of calibration.json"
            ),
            _identification("calibrationLaboratory", d.dataset, "name of the dataset"),
        ),
        *([] if d.received == NOT_STATED else [dcc("receiptDate", text=d.received)]),
        dcc("beginPerformanceDate", text=d.performed),
        dcc("endPerformanceDate", text=d.performed),
        dcc("performanceLocation", text="other"),
        dcc("issueDate", text=d.issued),
        *amended,
    )


def _identification(issuer: str, value: str, name: str) -> Content:
    return dcc(
        "identification",
        dcc("issuer", text=issuer),
        dcc("value", text=value),
        rich_text("name", name),
    )


def _item(d: CertificateData) -> Content:
    return dcc(
        "item",
        rich_text("name", d.item),
        rich_text("description", f"Condition on receipt: {d.condition}"),
        dcc("identifications", _identification("manufacturer", d.serial, "serial number")),
    )


def _contact(tag: str, name: str, address: str | None, country: str | None) -> Content:
    place = [rich_text("further", NOT_STATED if address is None else address)]
    if country is not None:
        place.insert(0, dcc("countryCode", text=country))
    return dcc(tag, rich_text("name", name), dcc("location", *place))


def _persons(d: CertificateData) -> Content:
    return dcc(
        "respPersons",
        dcc(
            "respPerson",
            dcc("person", rich_text("name", d.approved_by)),
            dcc("role", text="authorised by"),
            dcc("mainSigner", text="true"),
        ),
        dcc(
            "respPerson",
            dcc("person", rich_text("name", d.operator)),
            dcc("role", text="calibrated by"),
            dcc("mainSigner", text="false"),
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
        conclusion.append(dcc("conformity", text=d.conclusion.verdict))
    return [*statements, conclusion]


def _dated(d: CertificateData) -> str:
    if d.calibrated == NOT_STATED:
        return f"{NOT_STATED}; the date of performance given is that of issue"
    return d.calibrated


def _statement(name: str, words: str) -> Content:
    return dcc("statement", rich_text("name", name), rich_text("declaration", words))


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
    return dcc(
        "measurementResults",
        dcc("usedMethods", _method(d)),
        _software("usedSoftware", d.software),
        dcc("influenceConditions", *_conditions(d)),
        *results,
    )


def _method(d: CertificateData) -> Content:
    return dcc(
        "usedMethod",
        rich_text("name", "Calibration of active gazing"),
        rich_text("description", d.method),
        *(dcc("norm", text=norm) for norm in NORMS),
        dcc("reference", text=METHOD_REFERENCE),
    )


def _conditions(d: CertificateData) -> list[Content]:
    return [
        dcc("influenceCondition", rich_text("name", name), dcc("data", _condition(value, unit)))
        for name, value, unit in (
            ("temperature", d.temperature_c, "°C"),
            ("relative humidity", d.humidity_percent, "%"),
        )
    ]


def _condition(value: str | None, unit: str) -> Content:
    if value is None:
        return dcc("quantity", rich_text("noQuantity", NOT_STATED))
    return dcc("quantity", si("real", si("value", text=value), si("unit", text=UNITS[unit])))


def _measurement(name: str, results: Sequence[Content], words: str | None = None) -> Content:
    described = [] if words is None else [rich_text("description", words)]
    return dcc("measurementResult", rich_text("name", name), *described, dcc("results", *results))


def _result(name: str, words: str, *data: Content) -> Content:
    return dcc(
        "result", rich_text("name", name), rich_text("description", words), dcc("data", *data)
    )


def _parameters(d: CertificateData) -> list[Content]:
    found = [_result(p.name, f"{p.meaning}; {p.remark}", _quantity(p)) for p in d.parameters]
    return [*found, _matrix(d.covariance)]


def _matrix(m: Matrix) -> Content:
    """Return a covariance matrix as a list of its rows, each with its units."""
    rows = [
        dcc(
            "quantity",
            rich_text("name", name),
            si(
                "realListXMLList",
                si("valueXMLList", text=" ".join(row)),
                si("unitXMLList", text=" ".join(UNITS[m.units[i]] + UNITS[u] for u in m.units)),
            ),
        )
        for i, (name, row) in enumerate(zip(m.names, m.rows, strict=True))
    ]
    words = f"rows and columns: {', '.join(m.names)}"
    return _result("Covariance of the parameters", words, dcc("list", *rows))


def _quantity(r: Result, judged: Judgement | None = None) -> Content:
    metadata = [] if judged is None else [dcc("measurementMetaData", _judged(judged))]
    return dcc("quantity", rich_text("name", r.name), _real(r), *metadata)


def _real(r: Result) -> Content:
    return si(
        "real",
        si("value", text=r.value),
        si("unit", text=UNITS[r.unit]),
        *_uncertainty(r),
    )


def _uncertainty(r: Result) -> list[Content]:
    if r.expanded_uncertainty is not None and r.coverage_factor is not None:
        stated = si(
            "expandedMU",
            si("valueExpandedMU", text=r.expanded_uncertainty),
            si("coverageFactor", text=r.coverage_factor),
            si("coverageProbability", text=COVERAGE),
        )
    elif r.low is not None and r.high is not None:
        stated = si(
            "coverageIntervalMU",
            si("valueStandardMU", text=r.standard_uncertainty or "NaN"),
            si("intervalMin", text=r.low),
            si("intervalMax", text=r.high),
            si("coverageProbability", text=COVERAGE),
        )
    elif r.standard_uncertainty is not None:
        stated = si("standardMU", si("valueStandardMU", text=r.standard_uncertainty))
    else:
        return []
    return [si("measurementUncertaintyUnivariate", stated)]


def _judged(j: Judgement) -> Content:
    words = (
        f"tolerance ±{j.limit} mm, tolerance / U {j.ratio}, probability of conformance "
        f"{j.probability} %"
    )
    if j.warning is not None:
        words += f"; {j.warning}"
    return dcc("metaData", rich_text("declaration", words), dcc("conformity", text=j.verdict))


def _depth(line: DepthLine) -> Content:
    words = f"at x1c = {line.ray}; {line.depth.remark}"
    if line.extrapolated:
        words += "; extrapolated: outside the calibrated range"
    return _result(
        f"Depth {line.depth.value} mm",
        words,
        _quantity(line.depth, line.judgement),
        _position(line.region),
        _contributions(line.contributions),
    )


def _contributions(sources: Sequence[Entry]) -> Content:
    return dcc(
        "list",
        rich_text("name", "contributions to the standard uncertainty of depth"),
        *(
            dcc(
                "quantity",
                rich_text("name", source.label),
                si("real", si("value", text=source.value), si("unit", text=UNITS["mm"])),
            )
            for source in sources
        ),
    )


def _position(region: Region) -> Content:
    unit = UNITS["mm"]
    three = f"{unit} {unit} {unit}"
    squared = f"{unit}\\tothe{{2}}"
    columns = [
        si(
            "columnXMLList",
            si(
                "covarianceXMLList",
                si("valueXMLList", text=" ".join(column)),
                si("unitXMLList", text=" ".join([squared] * 3)),
            ),
        )
        for column in region.covariance
    ]
    return dcc(
        "quantity",
        rich_text("name", "position x, y, z"),
        si(
            "realListXMLList",
            si("valueXMLList", text=" ".join(region.position)),
            si("unitXMLList", text=three),
            si(
                "measurementUncertaintyMultivariateXMLList",
                si(
                    "ellipsoidalRegionMUXMLList",
                    si("covarianceMatrixXMLList", *columns),
                    si("coverageFactorXMLList", text=region.coverage_factor),
                    si("coverageProbabilityXMLList", text=COVERAGE),
                ),
            ),
        ),
    )


def _checked(error: Result, judged: Judgement | None) -> Content:
    return _result(f"Point {error.name}", error.meaning, _quantity(error, judged))
