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


def _number(text: str) -> Markup:
    """Return a number with a true minus sign, and symbols with their subscripts."""
    safe = _MINUS.sub("−", str(escape(text)))
    return Markup(_SUBSCRIPT.sub(r"\1<sub>\2</sub>", safe))  # noqa: S704 - escaped two lines above


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
    style = Markup(stylesheet().replace("@IDENTIFIER@", data.identifier))  # noqa: S704
    return template.render(c=data, figure=figure, style=style)
