"""The page of the report, parsed.

Evidence: properties of the page (structure, escaping, size), and regression of its numbers against
the results that it was made from.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree, html
from matplotlib.figure import Figure
from page_parts import decoded, table
from report_examples import everything, images, paper

from calib.core.gate import Gate
from calib.report import plotting
from calib.report.page import SECTIONS, render_report

LIMIT_BYTES = 3_000_000


HOSTILE = (
    "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>&amp;{{7*7}}$\\alpha$ "
    "\u202e\u05d0\u05d1 javascript:alert(3) " + "x" * 300
)


def test_every_section_is_there_and_reached_from_the_contents(page: html.HtmlElement) -> None:
    sections = page.xpath("//main/section")
    assert len(sections) == len(SECTIONS)
    targets = [link.get("href") for link in page.xpath("//nav//a")]
    assert targets == [f"#{section.get('id')}" for section in sections]


def test_the_verdict_comes_first(page: html.HtmlElement) -> None:
    first = page.xpath("//main/section")[0]
    assert first.get("id") == "verdict"
    assert "notice" in first[1].get("class")


def test_ids_are_unique(page: html.HtmlElement) -> None:
    ids = page.xpath("//@id")
    assert len(ids) == len(set(ids))


def test_each_figure_has_text_alternative_caption_and_data(page: html.HtmlElement) -> None:
    figures = page.xpath("//figure[.//div]")
    assert len(figures) >= 20
    for figure in figures:
        (picture,) = figure.xpath(".//img")
        # A text alternative says what is seen, with figures; a caption what a fault would be.
        assert len(picture.get("alt")) > 40, figure.get("id")
        assert re.search(r"\d", picture.get("alt")), figure.get("id")
        assert len(figure.find("figcaption").text_content()) > 80, figure.get("id")
        (link,) = figure.xpath(".//a[@download]")
        rows = list(csv.reader(io.StringIO(decoded(link.get("href")).decode())))
        assert len(rows) > 1
        assert {len(row) for row in rows} == {len(rows[0])}


WITHOUT_UNIT = re.compile(r"row|validation row|pair|view, by its place|x1c = tan|\$.*\\ln")


def test_axes_say_what_they_show_and_its_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    draw = plotting.svg
    monkeypatch.setattr(plotting, "svg", lambda figure: drawn.append(figure) or draw(figure))
    render_report(*everything())
    assert len(drawn) >= 20
    for figure in drawn:
        labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())]
        # Panels beside each other share an axis and its label.
        assert any(labels)
        for label in filter(None, labels):
            assert " / " in label or " = " in label or WITHOUT_UNIT.match(label), label


def test_each_thumbnail_says_what_it_shows(page: html.HtmlElement) -> None:
    shown = page.xpath("//ul[@class='sheet']//img")
    assert len(shown) == sum(len(sheet.names) for sheet in images().sheets.values())
    assert all(picture.get("alt") for picture in shown)
    missed = page.xpath("//ul[@class='sheet']/li[@class='bad']//img")
    assert [picture.get("alt") for picture in missed] == ["c/06.png: no board found"] * 2


def addresses(root: etree._Element) -> list[str]:
    """Return all that a browser might fetch or follow from a document."""
    names = ("src", "href", "srcset", "action", "data", "poster", "background", "ping")
    return [
        value
        for element in root.iter()
        for name, value in element.attrib.items()
        if etree.QName(name).localname in names
    ]


def test_nothing_leads_out_of_the_file(full: str, page: html.HtmlElement) -> None:
    for address in addresses(page):
        assert address.startswith(("#", "data:")), address[:80]
    for style in re.findall(r"<style>.*?</style>", full, re.DOTALL):
        assert "url(" not in style
        assert "@import" not in style
    for picture in page.xpath("//img[starts-with(@src, 'data:image/svg')]"):
        drawn = decoded(picture.get("src"))
        for address in addresses(etree.fromstring(drawn)):
            assert address.startswith(("#", "data:image/png", "data:image/jpeg")), address[:80]
        assert b"@import" not in drawn
        assert b"<script" not in drawn


def test_only_the_own_script_may_run(full: str) -> None:
    (script,) = re.findall(r"<script>(.*?)</script>", full, re.DOTALL)
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', full)
    assert f"script-src 'sha256-{allowed}'" in policy
    assert policy.startswith("default-src 'none';")


def test_the_page_stays_small(full: str) -> None:
    assert len(full.encode()) < LIMIT_BYTES


def test_the_same_results_give_the_same_page(full: str) -> None:
    assert render_report(*everything()) == full


def test_hostile_text_comes_out_as_text() -> None:
    calibration, context = everything()
    rows = calibration.gaze.rows
    hostile = tuple(f"{HOSTILE}{i}" for i in range(len(rows)))
    sheets = {
        name: replace(sheet, names=(HOSTILE,) * len(sheet.names))
        for name, sheet in calibration.images.sheets.items()
    }
    calibration = replace(
        calibration,
        name=HOSTILE,
        title=HOSTILE,
        gaze=replace(calibration.gaze, rows=replace(rows, ids=hostile, groups=hostile)),
        images=replace(calibration.images, sheets=sheets),
        gates=(*calibration.gates, Gate(HOSTILE, passed=False, detail=HOSTILE)),
        warnings=(HOSTILE,),
    )
    context = replace(
        context,
        source=(("Citation", HOSTILE), ("Address", HOSTILE)),
        reference=HOSTILE,
        validation_reference=HOSTILE,
        made=replace(context.made, command=HOSTILE, commit=HOSTILE),
    )
    text = render_report(calibration, context)
    page = html.document_fromstring(text)
    assert len(page.xpath("//script")) == 1
    assert not page.xpath("//img[not(starts-with(@src, 'data:'))]")
    assert not page.xpath("//@*[starts-with(name(), 'on')]")
    assert not [a for a in addresses(page) if not a.startswith(("#", "data:"))]
    readable = HOSTILE.replace("\u202e", "\ufffd")
    assert page.xpath("//h1")[0].text == readable
    assert page.xpath("string(//title)") == f"Accuracy report: {readable}"
    assert table(page, "Calibration rows")[0][0].text_content() == f"{readable}0"
    assert "49" not in page.xpath("//h1")[0].text
    # On figures such names give way to numbers; nothing of them may be left in the drawings.
    for picture in page.xpath("//img[starts-with(@src, 'data:image/svg')]"):
        assert b"alert" not in decoded(picture.get("src"))


def test_a_failed_check_is_said_first() -> None:
    calibration, context = paper()
    gate = Gate("convergence", passed=False, detail="the chain did not converge: add rows")
    page = html.document_fromstring(
        render_report(replace(calibration, gates=(*calibration.gates, gate)), context)
    )
    notices = page.xpath("//section[@id='verdict']/div[contains(@class, 'notice')]")
    assert "bad" in notices[0].get("class")
    assert "Do not use" in notices[0].text_content()
    (figures,) = page.xpath("//section[@id='verdict']//dl[contains(@class, 'tiles')]")
    assert "void" in figures.get("class")
    assert "not to be used" in figures.getprevious().text_content()
    assert "The chain did not converge: add rows." in notices[-1].text_content()


def test_a_dataset_without_gaze_rows_has_its_report() -> None:
    calibration, context = everything()
    bare = replace(calibration, gaze=None, not_adjusted=None)
    page = html.document_fromstring(render_report(bare, replace(context, reference=None)))
    shown = [section.get("id") for section in page.xpath("//main/section")]
    assert shown == [
        "verdict",
        "data",
        "detection",
        "intrinsics",
        "stereo",
        "sweep",
        "published",
        "provenance",
    ]


def test_rows_that_no_model_fits_have_their_report() -> None:
    calibration, context = paper()
    empty = replace(
        calibration.gaze,
        linear=None,
        convex=None,
        robust={},
        posterior={},
        refused={"base/robust": "all targets lie at one place"},
        comparison=None,
        calibrated=None,
        depths=None,
        validation=None,
        evidence=None,
    )
    gates = (Gate("fit", passed=False, detail="no model could be fitted"),)
    page = html.document_fromstring(
        render_report(replace(calibration, gaze=empty, gates=gates), context)
    )
    assert "all targets lie at one place" in page.xpath("string(//section[@id='verdict'])")


def test_many_rows_do_not_swell_the_page() -> None:
    calibration, context = everything()
    gaze, times = calibration.gaze, 1500
    rows = gaze.rows.take(np.tile(np.arange(len(gaze.rows)), times))
    rows = replace(rows, ids=tuple(map(str, range(len(rows)))))
    robust = {
        name: replace(fit, residual_mrad=np.tile(fit.residual_mrad, times))
        for name, fit in gaze.robust.items()
    }
    many = replace(calibration, gaze=replace(gaze, rows=rows, robust=robust))
    text = render_report(many, context)
    assert len(text.encode()) < LIMIT_BYTES
    assert f"of {len(rows)} rows, evenly picked" in text
