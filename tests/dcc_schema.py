"""Checks of a digital calibration certificate: structure, and PTB's schema where DCC_XSD names it.

DCC_XSD is the path of dcc.xsd, version 3.3.0, with D-SI and QUDT where it imports them. The schema
is PTB's (https://ptb.de/dcc) and no part of this project.
"""

from __future__ import annotations

import os
import re

from lxml import etree

from calib.certificate.elements import DCC, SI

NAMES = {"dcc": DCC, "si": SI}
REAL = re.compile(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?")

PARTS = ["administrativeData", "measurementResults", "document"]
ADMINISTRATIVE = {
    "dccSoftware",
    "coreData",
    "items",
    "calibrationLaboratory",
    "respPersons",
    "customer",
    "statements",
}


def checked(xml: bytes) -> etree._Element:
    """Return the root of a certificate that has passed."""
    parser = etree.XMLParser(no_network=True)
    root = etree.fromstring(xml, parser)
    if schema := os.environ.get("DCC_XSD"):
        etree.XMLSchema(etree.parse(schema, parser)).assertValid(root)
    assert root.tag == f"{{{DCC}}}digitalCalibrationCertificate"
    assert root.get("schemaVersion") == "3.3.0"
    assert [etree.QName(child).localname for child in root] == PARTS
    assert {etree.QName(child).localname for child in root[0]} == ADMINISTRATIVE
    # No element may be empty but by mistake: the schema's strings are not.
    for element in root.iter():
        assert len(element) or (element.text or "").strip()
    for element in root.iter(f"{{{SI}}}value"):
        assert REAL.fullmatch(element.text or "")
    for element in root.iter(f"{{{SI}}}valueXMLList"):
        assert all(REAL.fullmatch(number) for number in (element.text or "").split())
    return root


def texts(root: etree._Element, path: str) -> list[str]:
    """Return the texts of the elements at a path."""
    return [str(e.text) for e in root.iterfind(path, NAMES)]


def sources(root: etree._Element) -> list[set[str]]:
    """Return the sources of uncertainty that each certified depth names."""
    lists = root.iterfind(".//dcc:result/dcc:data/dcc:list", NAMES)
    return [
        set(texts(element, "dcc:quantity/dcc:name/dcc:content"))
        for element in lists
        if "contributions" in "".join(texts(element, "dcc:name/dcc:content"))
    ]


def shares(root: etree._Element) -> list[list[float]]:
    """Return the shares, per cent, in the budget of each certified depth."""
    budgets = [
        element
        for element in root.iterfind(".//dcc:result/dcc:data/dcc:list", NAMES)
        if "budget" in "".join(texts(element, "dcc:name/dcc:content"))
    ]
    return [
        [
            float(quantity.findtext("si:real/si:value", None, NAMES) or "nan")
            for quantity in budget.iterfind("dcc:list/dcc:quantity", NAMES)
            if texts(quantity, "dcc:name/dcc:content") == ["share of the variance"]
        ]
        for budget in budgets
    ]
