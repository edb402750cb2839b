"""The page in a real browser: pictures, Stop, who has the motor.

Evidence: simulated truth, which only this test reads: where C2 stands is what the world says.
"""

from __future__ import annotations

import json
import shutil
import time

import pytest
from live_server import live
from playwright.sync_api import sync_playwright
from websockets.sync.client import connect

from calib.geometry.camera import project

LONG_MS = 60_000


@pytest.fixture(scope="module")
def browser():
    binary = shutil.which("chromium")
    assert binary is not None, "chromium is missing; `make test` installs it"
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=binary, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def page_of(browser):
    """Give a function that opens pages; whatever they ask of other machines fails the test."""
    contexts, outside, faults = [], [], []

    def opened(url, **settings):
        context = browser.new_context(**settings)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(LONG_MS)
        page.on("request", lambda request: outside.append(request.url))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(url)
        page.wait_for_selector("body[data-ready]")
        return page

    yield opened
    for context in contexts:
        context.close()
    local = ("http://127.0.0.1:", "blob:http://127.0.0.1:", "ws://127.0.0.1:", "data:")
    assert [url for url in outside if not url.startswith(local)] == []
    assert faults == []


@pytest.fixture
def served(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with live(tmp_path) as server:
        yield server


def at_rest(server):
    """Assert that C2 stands still, once its ramp has ended, and return where."""
    time.sleep(0.5)
    before = server.true_yaw()
    time.sleep(0.3)
    assert server.true_yaw() == before
    return before


def test_pictures_come_with_the_target_marked_and_are_new(served, page_of):
    page = page_of(served.url)
    for camera in ("c1", "c2"):
        page.wait_for_selector(f"#{camera}[data-frames]")
        first = int(page.get_attribute(f"#{camera}", "data-frames"))
        page.wait_for_timeout(1500)
        assert int(page.get_attribute(f"#{camera}", "data-frames")) > first
    u, v = map(float, page.get_attribute("#c1", "data-target").split())
    world = served.session._bench.rig.world
    true = project(world.rig.c1, world.target(world.clock.now_ns())[None])[0]
    assert abs(u - true[0]) < 1.0
    assert abs(v - true[1]) < 1.0
    assert "this page has the motor" in page.inner_text("#role")


def test_stop_in_the_middle_of_a_move(served, page_of):
    page = page_of(served.url)
    page.click("#check")
    served.turning()
    page.click("#stop")
    state = served.idle(seconds=10)
    at_rest(served)
    assert "stopped" in state["log"][-1]["text"]
    page.wait_for_selector('body[data-job=""]')
    # By keyboard, and it works again afterwards.
    page.focus("#check")
    page.keyboard.press("Enter")
    served.turning()
    page.keyboard.press("Escape")
    served.idle(seconds=10)
    at_rest(served)


def test_of_two_pages_one_has_the_motor_and_both_may_stop(served, page_of):
    owner, other = page_of(served.url), page_of(served.url)
    assert "another page has the motor" in other.inner_text("#role")
    assert other.is_disabled("#check")
    with connect(f"ws://127.0.0.1:{served.port}/ws?token={served.access.token}") as socket:
        for command in ("check", "take"):
            socket.send(json.dumps({"do": command}))
        while "notice" not in (heard := json.loads(socket.recv())):
            assert heard["page"]["role"] == "watcher"
        assert heard["notice"] == "another page has the motor"
    assert served.record.get("job") is None
    owner.click("#check")
    served.turning()
    other.click("#stop")
    served.idle(seconds=10)
    at_rest(served)
    owner.close()
    other.wait_for_selector("#take:not([hidden])")
    other.click("#take")
    other.wait_for_selector("#role.owner")
    assert other.is_enabled("#check")


def test_a_page_closed_or_reloaded_in_a_move_stops_the_motor(served, page_of):
    page = page_of(served.url)
    page.click("#check")
    served.turning()
    page.reload()
    served.idle(seconds=10)
    at_rest(served)
    page.wait_for_selector("#role.owner")
    assert page.inner_text("#log").count("stopped") >= 1
    page.click("#check")
    served.turning()
    page.close()
    served.idle(seconds=10)
    at_rest(served)


def test_a_watcher_that_leaves_stops_nothing(served, page_of):
    page, other = page_of(served.url), page_of(served.url)
    page.click("#check")
    served.turning()
    other.close()
    time.sleep(0.5)
    assert served.record.get("job") is not None
    page.click("#stop")
    served.idle(seconds=10)
