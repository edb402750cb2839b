"""The page in a real browser: pictures, Stop, who has the motor.

Evidence: simulated truth, which only this test reads: where C2 stands is what the world says.
"""

from __future__ import annotations

import csv
import http.server
import json
import shutil
import threading
import time

import pytest
from live_server import live, settings
from playwright.sync_api import expect, sync_playwright
from websockets.sync.client import connect

from calib.geometry.camera import project
from calib.rig.protocols import Lost

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
        page.on("websocket", lambda socket: outside.append(socket.url))
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


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        with live(folder) as server:
            yield server


@pytest.fixture
def served(server):
    """Give the server at rest, with a board before both cameras and no page open."""
    with connect(f"ws://127.0.0.1:{server.port}/ws") as socket:
        while json.loads(socket.recv(timeout=30))["page"]["owned"]:
            pass
    server.session._bench.hand("board").place("here")
    yield server
    server.session.stop()
    server.idle()


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
    assert page.get_attribute("#c1", "data-marks") == str(world.board.rows * world.board.columns)
    assert "this page has the motor" in page.inner_text("#role")


def test_a_camera_that_is_lost_is_seen_to_be(served, page_of, monkeypatch):
    page = page_of(served.url)
    page.wait_for_selector("#c2[data-frames]")

    def lost():
        raise Lost("the cable of C2 is off")

    camera = served.session._bench.rig.c2
    with monkeypatch.context() as patch:
        patch.setattr(camera, "latest", lost)
        page.wait_for_selector("#c2.stale")
        assert "cable of C2 is off" in page.inner_text("#c2-text")
        assert "target at" in page.inner_text("#c1-text")
    page.wait_for_selector("#c2:not(.stale)")
    page.wait_for_selector("#c2-text:has-text('target at')")


def test_a_click_on_a_picture_names_the_target_there(served, page_of):
    page = page_of(served.url)
    page.wait_for_selector("#c1[data-target]")
    world = served.session._bench.rig.world
    pose = world.pose(world.clock.now_ns())
    corner = world.board.object_points()[world.board.columns + 2]  # column 2, row 1
    u, v = project(world.rig.c1, (pose[:3, :3] @ corner + pose[:3, 3])[None])[0]
    scale = page.evaluate("c1.clientWidth / c1.width")
    page.focus("#to")
    page.click("#c1", position={"x": u * scale, "y": v * scale})
    expect(page.locator("#to")).to_have_value("corner:2,1", timeout=LONG_MS)
    assert page.input_value("#target") == "board"
    page.click("#c1", position={"x": 3, "y": 3})
    page.wait_for_selector("#notice:has-text('nothing there')")


def test_a_click_that_is_doubled_is_one(served, page_of):
    page = page_of(served.url)
    page.dblclick("#check")
    state = served.turning()
    assert state["waiting"] == []
    page.click("#stop")
    served.idle()
    page.wait_for_selector("#check:enabled")


def test_a_number_out_of_range_is_told_and_asks_for_nothing(served, page_of):
    page = page_of(served.url)
    before = served.record.get("log")
    for given in ("0", "501", "2.5", ""):
        page.fill("#rows", given)
        # In one go: the next state disables the button of a rig that is not checked.
        page.evaluate("capture.disabled = false; capture.click()")
        expect(page.locator("#notice")).to_have_text("rows: give a whole number from 1 to 500")
    time.sleep(0.2)
    assert served.record.get("job") is None
    assert served.record.get("log") == before


def test_stop_in_the_middle_of_a_move(served, page_of):
    page = page_of(served.url)
    page.click("#check")
    served.turning()
    page.click("#stop")
    state = served.idle()
    at_rest(served)
    assert "stopped" in state["log"][-1]["text"]
    page.wait_for_selector('body[data-job=""]')
    # By keyboard, and it works again afterwards.
    page.focus("#check")
    page.keyboard.press("Enter")
    served.turning()
    page.keyboard.press("Escape")
    served.idle()
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
    served.idle()
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
    served.idle()
    at_rest(served)
    page.wait_for_selector("#role.owner")
    assert page.inner_text("#log").count("stopped") >= 1
    page.click("#check")
    served.turning()
    page.close()
    served.idle()
    at_rest(served)


def test_a_watcher_that_leaves_stops_nothing(served, page_of):
    page, other = page_of(served.url), page_of(served.url)
    page.click("#check")
    served.turning()
    other.close()
    time.sleep(0.5)
    assert served.record.get("job") is not None
    page.click("#stop")
    served.idle()


class Foreign(http.server.BaseHTTPRequestHandler):
    """A site of somebody else."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>foreign</title>")

    def log_message(self, *_):
        pass


COMMAND = """address => new Promise((resolve) => {
  const socket = new WebSocket(address);
  socket.onopen = () => { socket.send('{"do": "check"}'); resolve("open"); };
  socket.onerror = () => resolve("refused");
})"""


def test_a_foreign_page_in_the_same_browser_moves_nothing(served, browser):
    before = served.true_yaw()
    address = f"ws://127.0.0.1:{served.port}/ws?token={served.access.token}"
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Foreign) as foreign:
        threading.Thread(target=foreign.serve_forever).start()
        page = browser.new_page()
        try:
            page.goto(f"http://127.0.0.1:{foreign.server_port}/")
            # Even if it had the token.
            assert page.evaluate(COMMAND, address) == "refused"
            assert served.record.get("job") is None
            assert served.true_yaw() == before
            # The same words from the page itself are obeyed.
            page.goto(served.url)
            assert page.evaluate(COMMAND, address) == "open"
        finally:
            page.close()
            foreign.shutdown()


def wait_idle(page):
    page.wait_for_selector('body[data-job=""]')


def clicked(page, button):
    """Click and wait until the job is done."""
    page.wait_for_selector(f"#{button}:enabled")
    page.click(f"#{button}")
    page.wait_for_selector('body:not([data-job=""])')
    wait_idle(page)


@pytest.mark.slow
def test_from_an_empty_folder_to_a_certified_calibration_and_depths_by_clicks(
    tmp_path, monkeypatch, page_of
):
    """Nothing is shortened: lenses, pairs, sweep, rows, validation, the chain as users run it."""
    monkeypatch.chdir(tmp_path)
    with live(tmp_path, rig=settings(time="simulated")) as server:
        page = page_of(server.url, color_scheme="dark", viewport={"width": 400, "height": 800})
        page.set_default_timeout(20 * LONG_MS)
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        assert page.is_disabled("#capture")
        clicked(page, "check")
        assert "fit" in page.inner_text("#check-text")
        for kind in ("intrinsics", "stereo", "sweep"):
            page.select_option("#pictures-kind", kind)
            clicked(page, "pictures")
        for kind, count in (("gaze", "15"), ("validation", "5")):
            page.select_option("#kind", kind)
            page.fill("#rows", count)
            clicked(page, "capture")
        assert page.inner_text("#capture-text").startswith("15 rows and 5 for validation")
        clicked(page, "calibrate")
        assert "calibrated, all gates passed" in page.inner_text("#log")
        result = json.loads((server.session.places.run / "calibration.json").read_text())
        assert result["rig"]["serial"] == "virtual-1"
        world = server.session._bench.rig.world
        true = []
        for _ in range(5):
            clicked(page, "gaze")
            true.append(world.target(world.clock.now_ns()))
        clicked(page, "length")
        assert page.evaluate("document.documentElement.scrollWidth") <= 400
        for tab in ("Certificate", "Report"):
            page.click(f"#tabs >> text={tab}")
            page.frame_locator("#document").locator("h1").first.wait_for()
        with page.expect_download() as download:
            page.click("#csv")
        rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    assert [row["id"] for row in rows] == ["t01", "t02", "t03", "t04", "t05"]
    for row, (x, y, z) in zip(rows, true, strict=True):
        for name, value in zip("xyz", (x, y, z), strict=True):
            assert abs(float(row[f"{name}_mm"]) - value) < 4 * float(row[f"u_{name}_mm"]), name
        assert float(row["z_low95_mm"]) < float(row["z_mm"]) < float(row["z_high95_mm"])
        assert float(row["u_z_mm"]) < 0.002 * z
    lengths = server.record.get("lengths")
    assert lengths[0]["from"] == "plate:left-upper"
    assert abs(lengths[0]["length_mm"] - 1400) < 4 * lengths[0]["u_mm"]
    assert lengths[0]["u_mm"] < 3.0
