"""Elements of a Digital Calibration Certificate: PTB's namespaces, D-SI units, plain text."""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree

DCC = "https://ptb.de/dcc"
SI = "https://ptb.de/si"
LANGUAGE = "en"

UNITS = {
    "mm": r"\milli\metre",
    "mrad": r"\milli\radian",
    "1": r"\one",
    "°C": r"\degreecelsius",
    "%": r"\percent",
}
"""D-SI names of the printed units."""

Content = etree._Element


def dcc(tag: str, *children: Content, text: str | None = None, **attributes: str) -> Content:
    """Return an element of the DCC's namespace."""
    return _element(f"{{{DCC}}}{tag}", children, text, attributes)


def si(tag: str, *children: Content, text: str | None = None) -> Content:
    """Return an element of D-SI's namespace."""
    return _element(f"{{{SI}}}{tag}", children, text, {})


def _element(
    name: str, children: Iterable[Content], text: str | None, attributes: dict[str, str]
) -> Content:
    element = etree.Element(name, attributes, nsmap={"dcc": DCC, "si": SI})
    element.text = text
    element.extend(list(children))
    return element


def rich_text(tag: str, words: str) -> Content:
    """Return a text or rich content of one paragraph."""
    return dcc(tag, dcc("content", text=words, lang=LANGUAGE))


def software(tag: str, programs: Iterable[tuple[str, str]]) -> Content:
    """Return the names and releases of programs."""
    return dcc(
        tag,
        *(
            dcc("software", rich_text("name", name), dcc("release", text=version))
            for name, version in programs
        ),
    )
