"""Evidence: property; the pages are parsed, and opened in a real browser without a network."""

from __future__ import annotations

import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import example
import pytest

from calib.certificate.build import build_certificate
from calib.certificate.html import render_html
from calib.certificate.inputs import CertificateInputs

VOID = {"meta", "img", "br", "col", "wbr"}


class _Page(HTMLParser):
    """Elements, attributes and text of a page; refuses tags that do not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.text: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self._open:
            self.text.append(data)


def _render(inputs: CertificateInputs) -> str:
    return render_html(build_certificate(inputs))


@pytest.mark.parametrize("make", [example.inputs, example.hostile])
def test_the_page_holds_no_script_and_asks_for_nothing(make) -> None:
    html = _render(make())
    page = _Page(html)
    assert not {"script", "iframe", "object", "embed", "link", "form", "base"} & set(page.tags)
    for _, name, value in page.attributes:
        assert not name.startswith("on")
        if name in ("src", "href", "action", "data", "srcset"):
            assert value.startswith("data:image/svg+xml;base64,")
    style = html[html.index("<style>") : html.index("</style>")]
    assert not re.search(r"url\(|@import", style)
    policy = next(v for t, n, v in page.attributes if n == "content" and "default-src" in v)
    assert "default-src 'none'" in policy


def test_hostile_text_is_shown_as_it_is() -> None:
    text = " ".join(_Page(_render(example.hostile())).text)
    assert text.count("<script>alert('x')</script> \"quoted\" & ]]> {{ 7 * 7 }}") > 20
    assert "\u202e" not in text
    assert "\x07" not in text


def test_figure_and_tables_can_be_read_without_eyes() -> None:
    page = _Page(_render(example.inputs()))
    (alternative,) = (v for t, n, v in page.attributes if (t, n) == ("img", "alt"))
    assert "490 mm: -" in alternative
    assert "Tolerance ±2 %" in alternative
    assert page.tags.count("caption") == page.tags.count("table")
    assert ("html", "lang", "en") in page.attributes
    scopes = [v for t, n, v in page.attributes if (t, n) == ("th", "scope")]
    assert len(scopes) == page.tags.count("th")


def test_identifier_end_and_verdict_are_on_the_page() -> None:
    inputs = example.inputs()
    text = " ".join("".join(_Page(_render(inputs)).text).split())
    identifier = inputs.issue.identifier
    assert f"No. {identifier}" in text
    assert text.rstrip().endswith(f"End of certificate {identifier}")
    assert "Conformity over the calibrated range: pass" in text


def test_numbers_print_with_a_true_minus_and_symbols_with_subscripts() -> None:
    html = _render(example.inputs())
    assert "−21.00" in html
    assert "L<sub>b</sub>" in html
    assert "AG-20260201" in html  # a hyphen stays one


def test_lines_break_in_endless_words_but_not_in_digests_and_intervals() -> None:
    inputs = example.endless()
    html = _render(inputs)
    assert "xxx<wbr>xxx" in html
    assert f'<td class="w" dir="auto">{inputs.provenance.dataset_sha256}</td>' in html
    assert "\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}" in html


def test_a_real_browser_opens_it_offline_without_complaint(tmp_path: Path) -> None:
    page = tmp_path / "certificate.html"
    page.write_text(_render(example.hostile()), encoding="utf-8")
    done = subprocess.run(
        [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--proxy-server=127.0.0.1:9",
            "--enable-logging=stderr",
            "--virtual-time-budget=2000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "End of certificate" in done.stdout
    assert "CONSOLE" not in done.stderr
