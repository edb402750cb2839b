"""The certificate as a PTB Digital Calibration Certificate, version 3.3.0 (https://ptb.de/dcc).

Numbers are those of the other forms, digit for digit; covariances alone have more, since programs
invert them. The HTML form is embedded as the document for people; a style sheet shows the XML
itself as a page.
"""

from __future__ import annotations

import base64
from importlib.resources import files

from lxml import etree

from calib.certificate.data import CertificateData
from calib.certificate.dcc_results import results
from calib.certificate.elements import LANGUAGE, Content, dcc, rich_text, software
from calib.results.wording import NOT_STATED

VERSION = "3.3.0"


def render_dcc(data: CertificateData, *, html: str) -> bytes:
    """Return the DCC as UTF-8 XML with `html` embedded."""
    root = dcc(
        "digitalCalibrationCertificate",
        _administration(data),
        results(data),
        _document(data, html),
        schemaVersion=VERSION,
    )
    etree.cleanup_namespaces(root)
    etree.indent(root)
    root.addprevious(etree.ProcessingInstruction("xml-stylesheet", _stylesheet()))
    return etree.tostring(root.getroottree(), xml_declaration=True, encoding="UTF-8")


def _stylesheet() -> str:
    """Return what lets a browser show the XML as a page.

    CSS, not XSLT, which browsers are giving up and refuse for local files; and in the file itself:
    the XML stays one file.
    """
    css = files("calib.certificate").joinpath("templates/dcc.css").read_bytes()
    encoded = base64.b64encode(css).decode("ascii")
    return f'type="text/css" href="data:text/css;base64,{encoded}"'


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
        software("dccSoftware", d.software[:1]),
        _core(d),
        dcc("items", _item(d)),
        dcc("calibrationLaboratory", _contact("contact", d.laboratory, d.address, d.country)),
        _persons(d),
        _contact("customer", d.customer, None, None),
        dcc("statements", *_statements(d)),
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
    said_once = "" if d.conclusion.words == d.rule else f" {d.rule}"
    words = d.conclusion.words.rstrip(".")
    conclusion = _statement("Conformity", f"{words}.{tolerance}{said_once}")
    if d.conclusion.verdict is not None:
        conclusion.append(dcc("conformity", text=d.conclusion.verdict))
    return [*statements, conclusion]


def _dated(d: CertificateData) -> str:
    if d.calibrated == NOT_STATED:
        return f"{NOT_STATED}; the date of performance given is that of issue"
    return d.calibrated


def _statement(name: str, words: str) -> Content:
    return dcc("statement", rich_text("name", name), rich_text("declaration", words))
