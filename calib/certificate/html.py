"""The certificate as one HTML file: self-contained, no script, no network."""

from __future__ import annotations

import base64
import re
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from calib.certificate.data import CertificateData

_SUBSCRIPT = re.compile(r"(?<![A-Za-z])([A-Za-zτε])_([a-z])(?![A-Za-z_])")
_MINUS = re.compile(r"(?<![\w.\-])-(?=[\d∞])")

_INTERVAL = re.compile(r"(?<=\d) to (?=[\d−-])")
"""Of two ends that stay in one line."""

_LONG_WORD = re.compile(r"(?<!\S)(?![0-9a-f]{64}(?!\S))\S{33,}")
"""A word that could push a table off the page, which may break here and there; no digest.

CSS could break it anywhere, but then the widths of a table cost a layout of each letter.
"""

_PIECE = re.compile(r"\S{16}(?=\S)")
_BREAK = "\N{ZERO WIDTH SPACE}"


def _number(text: str) -> Markup:
    """Return a text with true minus signs, subscripts, and lines that break at the right places."""
    text = _INTERVAL.sub("\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}", text)
    text = _LONG_WORD.sub(lambda word: _PIECE.sub(rf"\g<0>{_BREAK}", word[0]), text)
    safe = str(escape(text))
    safe = _MINUS.sub("−", safe).replace(_BREAK, "<wbr>")
    return Markup(_SUBSCRIPT.sub(r"\1<sub>\2</sub>", safe))  # noqa: S704 - escaped above


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("calib.certificate"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = _number
    return environment


def stylesheet() -> str:
    """Return the style of the certificate."""
    return files("calib.certificate").joinpath("templates/certificate.css").read_text("utf-8")


def render_html(data: CertificateData) -> str:
    """Return the certificate as HTML."""
    figure = None
    if data.figure is not None:
        encoded = base64.b64encode(data.figure.svg.encode()).decode("ascii")
        figure = f"data:image/svg+xml;base64,{encoded}"
    template = _environment().get_template("certificate.html.j2")
    # The style is the package's own; the identifier in it has letters, digits and hyphens only.
    style = Markup(stylesheet().replace("@IDENTIFIER@", data.identifier))  # noqa: S704 - our own file
    return template.render(c=data, figure=figure, style=style)
