"""The report in a real browser, headless Chromium, opened from disk.

Evidence: independent tool.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
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


def test_the_folded_report_is_short_and_loses_nothing_unfolded_or_printed(report: Path) -> None:
    with chromium() as own:
        _size(own, 1280, 900)
        own.go(report.as_uri())
        text = "document.getElementById('main').textContent.length"
        height = "document.documentElement.scrollHeight"
        folded, said = own.evaluate(height), own.evaluate(text)
        assert folded < 12 * 900
        own.evaluate("document.querySelector('.everything').click()")
        opened = own.evaluate(height)
        assert opened > 2 * folded
        assert own.evaluate(text) == said
        own.evaluate("document.querySelector('.everything').click()")
        assert own.evaluate(height) < 1.1 * folded
        own.call("Emulation.setEmulatedMedia", media="print")
        _draw(own)
        hidden = (
            "Array.from(document.querySelectorAll('main table, main figure'))"
            ".filter(e => !e.checkVisibility({contentVisibilityAuto: true}) || !e.offsetHeight)"
            ".length"
        )
        assert own.evaluate(hidden) == 0


def test_a_link_opens_the_chapter_it_leads_to(browser: Browser) -> None:
    is_open = "document.querySelector('#posterior details').open"
    assert browser.evaluate(is_open) is False
    browser.evaluate("document.querySelector('nav a[href=\"#posterior\"]').click()")
    browser.evaluate("dispatchEvent(new HashChangeEvent('hashchange'))")
    assert browser.evaluate(is_open) is True


def test_checks_that_passed_are_folded_by_stage(browser: Browser) -> None:
    folds = browser.evaluate(
        "Array.from(document.querySelectorAll('#verdict .fold'), f => [f.open, "
        "f.querySelector('summary').textContent])"
    )
    assert folds
    assert all(is_open == ("failed" in words) for is_open, words in folds)


def test_every_table_downloads_with_all_digits(browser: Browser) -> None:
    tables = browser.evaluate("document.querySelectorAll('main table').length")
    links = "Array.from(document.querySelectorAll('.tools a[download$=\".csv\"]'))"
    assert browser.evaluate(f"{links}.length") == tables
    # Clicked, but kept from downloading.
    given = browser.evaluate(
        "(() => { const t = document.querySelector('#depth table.sortable');"
        "const a = t.closest('.scroll').nextElementSibling.querySelector('a');"
        "a.addEventListener('click', e => e.preventDefault()); a.click();"
        "return decodeURIComponent(a.href.split(',').slice(1).join(',')) })()"
    )
    heads, first, *others = csv.reader(given.splitlines())
    shown = browser.evaluate(
        "Array.from(document.querySelectorAll('#depth table.sortable tbody tr')).length"
    )
    assert len(others) + 1 == shown
    assert len(first) == len(heads)
    key = browser.evaluate(
        "document.querySelector('#depth table.sortable').tBodies[0].rows[0].cells[1].dataset.key"
    )
    assert key in first


def _press(browser: Browser, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)


def test_figures_and_the_scene_tell_their_values_to_the_keyboard(browser: Browser) -> None:
    image = "document.querySelector('#validation figure img')"
    tip = "document.querySelector('.tip')"
    browser.evaluate("document.querySelector('#validation details').open = true")
    browser.evaluate(f"{image}.focus()")
    points = browser.evaluate(f"JSON.parse({image}.dataset.points)")
    order = [text for *_, text in sorted(points, key=lambda p: (p[0], p[1]))]
    for wanted in order[:3]:
        _press(browser, "ArrowRight")
        assert browser.evaluate(f"{tip}.textContent") == wanted
    _press(browser, "ArrowLeft")
    assert browser.evaluate(f"{tip}.textContent") == order[1]
    _press(browser, "Enter")
    assert browser.evaluate("document.querySelector('dialog').open") is True
    large = "document.querySelector('dialog img')"
    _press(browser, "ArrowRight")
    assert browser.evaluate(f"!{tip}.hidden && {tip}.closest('dialog') !== null") is True
    _press(browser, "+")
    left = browser.evaluate(f"{large}.getBoundingClientRect().left")
    _press(browser, "ArrowRight")
    assert browser.evaluate(f"{large}.getBoundingClientRect().left") == pytest.approx(left - 80)
    _press(browser, "Escape")
    browser.evaluate("document.querySelector('dialog').close()")
    browser.evaluate("document.querySelector('#data details').open = true")
    browser.evaluate("document.querySelector('canvas').focus()")
    _press(browser, "n")
    assert " mm" in browser.evaluate(f"{tip}.textContent")
    assert browser.evaluate(f"{tip}.hidden") is False
    browser.evaluate("document.querySelector('canvas').blur()")
    assert browser.evaluate(f"{tip}.hidden") is True


def test_figures_tell_their_values_and_enlarge(browser: Browser) -> None:
    image = "document.querySelector('#validation figure img')"
    browser.evaluate(f"{image}.scrollIntoView()")
    browser.evaluate(
        f"(() => {{ const i = {image}; const [x, y] = JSON.parse(i.dataset.points)[0];"
        "const b = i.getBoundingClientRect();"
        "i.dispatchEvent(new PointerEvent('pointermove', {clientX: b.left + x * b.width,"
        "clientY: b.top + y * b.height, bubbles: true})); })()"
    )
    told = browser.evaluate("document.querySelector('.tip').textContent")
    assert "%: " in told
    assert browser.evaluate("document.querySelector('.tip').hidden") is False
    browser.evaluate(f"{image}.click()")
    assert browser.evaluate("document.querySelector('dialog').open") is True
    large = "document.querySelector('dialog img')"
    before = browser.evaluate(f"{large}.getBoundingClientRect().width")
    browser.evaluate(
        "document.querySelector('dialog').dispatchEvent(new KeyboardEvent('keydown',{key: '+'}))"
    )
    assert browser.evaluate(f"{large}.getBoundingClientRect().width") > 1.2 * before
    browser.evaluate("document.querySelector('dialog button').click()")
    assert browser.evaluate("document.querySelector('dialog').open") is False


def test_the_rig_turns_in_three_dimensions(browser: Browser) -> None:
    canvas = "document.querySelector('canvas[data-scene]')"
    scene = browser.evaluate(f"JSON.parse({canvas}.dataset.scene)")
    assert len(scene["targets"]) == 6
    assert len(scene["ellipsoids"]) >= 3
    longest = [np.linalg.norm(e["axes"][0]) for e in scene["ellipsoids"]]
    assert longest == sorted(longest)
    inked = (
        f"(() => {{ const c = {canvas}; const d = c.getContext('2d').getImageData(0, 0, c.width,"
        "c.height).data; let n = 0, s = 0; for (let i = 3; i < d.length; i += 4)"
        "if (d[i]) { n++; s += i; } return [n, s]; })()"
    )
    count, before = browser.evaluate(inked)
    assert count > 2000
    key = f"{canvas}.dispatchEvent(new KeyboardEvent('keydown', {{key: '%s'}}))"
    browser.evaluate(key % "ArrowLeft")
    assert browser.evaluate(inked)[1] != before
    browser.evaluate(key % "m")
    assert browser.evaluate(f"{canvas}.look.times") == 1


def test_the_headline_has_one_value_everywhere(browser: Browser) -> None:
    """Drawing, tile and table; the certificate has the same, see the chain's tests."""
    tile = browser.evaluate("document.querySelector('.tiles dd.value').textContent")
    row = browser.evaluate(
        "Array.from(document.querySelectorAll('#parameters tbody tr')).map(r => r.textContent)"
        ".find(t => t.includes('baseline seen at 90'))"
    )
    assert tile.removesuffix(" mm") in row
    remark = browser.evaluate("document.querySelector('.tiles dd:last-child').textContent")
    assert remark.partition("95 %: ")[2].removesuffix(" mm") in row


def test_what_is_wider_than_a_narrow_window_says_so(report: Path) -> None:
    with chromium() as own:
        _size(own, 400, 860)
        own.go(report.as_uri())
        own.evaluate("document.querySelector('.everything').click()")
        _draw(own)
        silent = own.evaluate(
            "Array.from(document.querySelectorAll('.scroll'))"
            ".filter(s => s.scrollWidth > s.clientWidth + 1)"
            ".filter(s => getComputedStyle(s.nextElementSibling.querySelector('.cue')).display"
            " === 'none').length"
        )
        cut = own.evaluate("document.querySelectorAll('.scroll.cut').length")
        assert cut > 5
        assert silent == 0
        top = own.evaluate("document.querySelector('#verdict .notice').getBoundingClientRect().top")
        assert top < 400


def test_a_dark_window_gets_a_dark_page(report: Path) -> None:
    with chromium() as own:
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        own.call("Emulation.setEmulatedMedia", features=dark)
        own.go(report.as_uri())
        colour = "getComputedStyle(document.body).{}.match(/\\d+/g).map(Number)"
        assert max(own.evaluate(colour.format("backgroundColor"))) < 60
        assert min(own.evaluate(colour.format("color"))) > 200


def _draw(browser: Browser) -> None:
    """Let two frames pass: what hides and measures itself is then up to date."""
    browser.call(
        "Runtime.evaluate",
        expression="new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))",
        awaitPromise=True,
    )


def _size(browser: Browser, width: int, height: int) -> None:
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=False,
    )


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
