"""The certificate as a tagged PDF with the digital certificate attached.

It claims no conformity with PDF/A or PDF/UA: nothing here could check the claim.
"""

from __future__ import annotations

import weasyprint

ATTACHMENT = "certificate.xml"


def render_pdf(html: str, *, dcc: bytes) -> bytes:
    """Return the certificate as PDF with the DCC, XML, attached.

    The page carries all it needs in itself: nothing else is fetched, neither from the network nor
    from the disk.
    """
    attachment = weasyprint.Attachment(
        string=dcc,
        name=ATTACHMENT,
        description="Digital calibration certificate, PTB DCC 3.3.0",
        relationship="Alternative",
    )
    fetcher = weasyprint.URLFetcher(allowed_protocols=("data",))
    document = weasyprint.HTML(string=html, url_fetcher=fetcher)
    pdf: bytes = document.write_pdf(attachments=[attachment], pdf_tags=True)
    return pdf
