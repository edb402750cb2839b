"""The report of results that have all there can be, made once."""

from __future__ import annotations

import pytest
from lxml import html
from report_examples import everything

from calib.report.page import render_report


@pytest.fixture(scope="session")
def full() -> str:
    return render_report(*everything())


@pytest.fixture(scope="session")
def page(full: str) -> html.HtmlElement:
    return html.document_fromstring(full)
