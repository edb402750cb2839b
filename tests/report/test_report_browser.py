"""The report in a real browser, headless Chromium, opened from disk.

Evidence: independent tool.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, chromium
from report_examples import everything

from calib.report.page import render_report


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(render_report(*everything()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser(report: Path) -> Iterator[Browser]:
    with chromium() as running:
        running.go(report.as_uri())
        yield running


def test_opens_without_an_error(browser: Browser) -> None:
    assert browser.evaluate("document.title").startswith("Accuracy report")
    assert browser.of("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded") == []


def test_asks_nothing_of_any_network(browser: Browser, report: Path) -> None:
    asked = [request["request"]["url"] for request in browser.of("Network.requestWillBeSent")]
    assert asked[0] == report.as_uri()
    assert all(url.startswith("data:") for url in asked[1:])


def test_every_picture_is_shown(browser: Browser) -> None:
    sizes = browser.evaluate("Array.from(document.images, i => [i.complete, i.naturalWidth])")
    assert len(sizes) > 20
    assert all(complete and width > 0 for complete, width in sizes)


def test_tables_sort_both_ways_by_the_values(browser: Browser) -> None:
    table = "Array.from(document.querySelectorAll('#depth table.sortable'))[0]"
    column = f"Array.from({table}.tBodies[0].rows, r => Number(r.cells[1].dataset.key))"
    click = f"{table}.querySelectorAll('th button')[1].click()"
    before = browser.evaluate(column)
    browser.evaluate(click)
    assert browser.evaluate(column) == sorted(before)
    assert browser.evaluate(f"{table}.querySelectorAll('th')[1].ariaSort") == "ascending"
    browser.evaluate(click)
    assert browser.evaluate(column) == sorted(before, reverse=True)


def test_a_policy_keeps_other_scripts_from_running(report: Path) -> None:
    insert = (
        "const s = document.createElement('script'); s.textContent = 'window.intruder = 1';"
        "document.body.append(s); String(window.intruder)"
    )
    with chromium() as own:
        own.go(report.as_uri())
        assert own.evaluate(insert) == "undefined"
        (refusal,) = own.of("Log.entryAdded")
        assert "Content Security Policy" in refusal["entry"]["text"]


@pytest.mark.parametrize("width", [360, 820, 1280, 1920])
def test_the_page_is_as_wide_as_its_window(browser: Browser, width: int) -> None:
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=900,
        deviceScaleFactor=1,
        mobile=False,
    )
    assert browser.evaluate("document.documentElement.scrollWidth") <= width


def test_every_table_is_seen_whole_in_a_window_of_1100_px(browser: Browser) -> None:
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=1100,
        height=900,
        deviceScaleFactor=1,
        mobile=False,
    )
    scrolled = browser.evaluate(
        "Array.from(document.querySelectorAll('.scroll'))"
        ".filter(s => s.scrollWidth > s.clientWidth).map(s => s.ariaLabel)"
    )
    assert scrolled == []


def test_is_read_without_scripts(report: Path) -> None:
    with chromium("--blink-settings=scriptEnabled=false") as plain:
        plain.go(report.as_uri())
        tree = plain.call("DOM.getDocument", depth=0)
        found = plain.call("DOM.querySelectorAll", nodeId=tree["root"]["nodeId"], selector="button")
        assert found["nodeIds"] == []
        rows = plain.call(
            "DOM.querySelectorAll", nodeId=tree["root"]["nodeId"], selector="#depth tbody tr"
        )
        assert len(rows["nodeIds"]) > 10
        assert plain.of("Log.entryAdded", "Runtime.exceptionThrown") == []
