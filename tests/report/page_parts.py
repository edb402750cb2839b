"""What tests look for in a report: tables, numbers in them, pictures."""

from __future__ import annotations

import base64
from urllib.parse import unquote

from lxml import html


def table(page: html.HtmlElement, caption: str) -> list[list[html.HtmlElement]]:
    """Return the body's cells of the table with a caption that begins so."""
    for candidate in page.iter("table"):
        if candidate.find("caption").text_content().startswith(caption):
            return [list(row) for row in candidate.find("tbody")]
    raise AssertionError(f"no table {caption}")


def keys(rows: list[list[html.HtmlElement]], column: int) -> list[float]:
    return [float(row[column].get("data-key")) for row in rows]


def decoded(uri: str) -> bytes:
    if uri.startswith("data:image/svg+xml,"):
        return unquote(uri.partition(",")[2]).encode()
    return base64.b64decode(uri.partition(";base64,")[2], validate=True)
