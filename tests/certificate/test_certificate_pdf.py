"""Evidence: independent tool (poppler) on the rendered file."""

from __future__ import annotations

import importlib.abc
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import example
import pytest

from calib.certificate.forms import Forms, render_forms


@cache
def _forms(kind: str) -> Forms:
    made = {"hostile": example.hostile, "endless": example.endless, "plain": example.inputs}
    return render_forms(made[kind]())


def _poppler(tool: str, forms: Forms, folder: Path, *arguments: str) -> str:
    assert forms.pdf is not None, forms.pdf_missing
    file = folder / "certificate.pdf"
    file.write_bytes(forms.pdf)
    command = [tool, *arguments, str(file), *(["-"] if tool == "pdftotext" else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert "Error" not in done.stderr
    return done.stdout


@pytest.mark.parametrize("kind", ["plain", "hostile"])
def test_every_page_has_its_number_and_the_identifier(kind: str, tmp_path: Path) -> None:
    text = _poppler("pdftotext", _forms(kind), tmp_path, "-layout")
    pages = text.split("\f")[:-1]
    assert len(pages) >= 3
    identifier = example.inputs().issue.identifier
    for number, page in enumerate(pages, start=1):
        assert f"page {number} of {len(pages)}" in page
        assert identifier in page
    assert f"End of certificate {identifier}" in pages[-1]
    assert "End of certificate" not in "".join(pages[:-1])


def test_two_pages_hold_what_the_auditor_needs(tmp_path: Path) -> None:
    pages = _poppler("pdftotext", _forms("plain"), tmp_path, "-layout").split("\f")
    front = pages[0] + pages[1]
    for words in (
        "Conformity over the calibrated range",
        "Certified depths",
        "Calibrated parameters",
        "Independent reference: ruler",
        "Decision rule",
        "Authorised by",
    ):
        assert words in front
    assert pages[2].lstrip().startswith("Calibration certificate")
    assert "Annex A" in pages[2]
    assert "Annex" not in front


def test_endless_words_stay_on_the_page(tmp_path: Path) -> None:
    boxes = _poppler("pdftotext", _forms("endless"), tmp_path, "-bbox")
    sheet = float(re.findall(r'<page width="([\d.]+)"', boxes)[0])
    ends = [float(x) for x in re.findall(r'xMax="([\d.]+)"', boxes)]
    assert boxes.count("x" * 20) > 20
    assert max(ends) < sheet - RIGHT_MARGIN_PT


RIGHT_MARGIN_PT = 14 * 72 / 25.4
"""One millimetre less than the margin of the page: the box of an italic may lean out."""


def test_it_is_tagged_and_names_itself(tmp_path: Path) -> None:
    info = _poppler("pdfinfo", _forms("plain"), tmp_path)
    facts = dict(line.split(":", 1) for line in info.splitlines() if ":" in line)
    assert facts["Tagged"].strip() == "yes"
    assert facts["JavaScript"].strip() == "no"
    assert example.inputs().issue.identifier in facts["Title"]
    assert "A4" in facts["Page size"]


def test_all_fonts_are_embedded(tmp_path: Path) -> None:
    lines = _poppler("pdffonts", _forms("hostile"), tmp_path).splitlines()[2:]
    assert lines
    # The last columns are emb, sub, uni, and two numbers of the object.
    assert {line.split()[-5] for line in lines} == {"yes"}


def test_the_digital_certificate_is_attached_byte_for_byte(tmp_path: Path) -> None:
    forms = _forms("plain")
    target = tmp_path / "out.xml"
    _poppler("pdfdetach", forms, tmp_path, "-save", "1", "-o", str(target))
    assert target.read_bytes() == forms.xml


def test_nothing_is_fetched_from_outside(tmp_path: Path) -> None:
    from calib.certificate.pdf import render_pdf

    secret = tmp_path / "secret.svg"
    secret.write_text('<svg xmlns="http://www.w3.org/2000/svg"><text>SECRET</text></svg>')
    image = f"<img src='{secret.as_uri()}' alt='left out'>"
    page = f"<html lang='en'><body>{image}<p>text</p></body></html>"
    forms = replace(_forms("plain"), pdf=render_pdf(page, dcc=b"<a/>"))
    text = _poppler("pdftotext", forms, tmp_path)
    assert "text" in text
    assert "SECRET" not in text


class _WithoutPango(importlib.abc.MetaPathFinder):
    """WeasyPrint on a machine without its Debian libraries."""

    def find_spec(self, name: str, *_: object) -> None:
        if name == "weasyprint":
            raise OSError("cannot load library 'libpango-1.0-0'")


def test_html_and_dcc_do_without_the_libraries_of_the_pdf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "meta_path", [_WithoutPango(), *sys.meta_path])
    monkeypatch.delitem(sys.modules, "weasyprint", raising=False)
    monkeypatch.delitem(sys.modules, "calib.certificate.pdf", raising=False)
    forms = render_forms(example.inputs())
    assert forms.pdf is None
    assert "libpango" in (forms.pdf_missing or "")
    assert forms.html
    assert forms.xml
