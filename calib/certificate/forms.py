"""The three forms of one certificate."""

from __future__ import annotations

from dataclasses import dataclass

from calib.certificate.build import build_certificate
from calib.certificate.dcc import render_dcc
from calib.certificate.html import render_html
from calib.certificate.inputs import CertificateInputs


@dataclass(frozen=True)
class Forms:
    """The contents of the files.

    Parameters
    ----------
    html, xml
        certificate.html, which the DCC embeds, and certificate.xml, which the PDF holds.
    pdf
        certificate.pdf; None where `pdf_missing` says why it cannot be made here.
    """

    html: str
    xml: bytes
    pdf: bytes | None
    pdf_missing: str | None


def render_forms(inputs: CertificateInputs) -> Forms:
    """Return the certificate in its three forms."""
    data = build_certificate(inputs)
    html = render_html(data)
    xml = render_dcc(data, html=html)
    try:
        # Its Debian libraries may be missing; HTML and XML do without them.
        from calib.certificate.pdf import render_pdf
    except OSError as error:
        return Forms(html, xml, None, f"WeasyPrint's libraries are missing: {error}")
    return Forms(html, xml, render_pdf(html, dcc=xml), None)
