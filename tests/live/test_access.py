"""Who may move the motor: nobody by a foreign name, from a foreign page, or without the token.

Evidence: property. Every refusal is tried against a server that runs; the page's own request, with
the same words, is not refused.
"""

from __future__ import annotations

import http.client
import json
import threading
import urllib.error
import urllib.request
from contextlib import closing

import pytest
from live_server import live
from starlette.routing import Route, WebSocketRoute
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from calib.live.access import Access

UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        with live(folder) as server:
            yield server


def status(server, path, headers):
    """Return the status of a request with exactly these headers."""
    with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)) as connection:
        connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse().status


def own(server):
    return f"127.0.0.1:{server.port}"


def commanding(server):
    return f"/ws?token={server.access.token}"


def every_route(server):
    """Yield a path to each of the application's routes, with the token, and its upgrade."""
    routes = server.app._app.routes
    assert {type(route) for route in routes} == {Route, WebSocketRoute}
    names = {"/static/{name}": "live.js", "/run/{name}": "report.html"}
    for route in routes:
        path = route.path.replace("{name}", names.get(route.path, ""))
        upgrade = UPGRADE if isinstance(route, WebSocketRoute) else {}
        yield f"{path}?token={server.access.token}", upgrade
    yield f"/nowhere?token={server.access.token}", {}


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example:{port}",
     "127.0.0.1@evil.example", "", "[", "0x7f.1:{port}"],
)  # fmt: skip
def test_a_foreign_host_is_refused_on_every_route(served, host):
    before = served.true_yaw()
    for path, upgrade in every_route(served):
        headers = {"Host": host.format(port=served.port)} | upgrade
        assert status(served, path, headers) == 403, path
        headers["Host"] = own(served)
        assert status(served, path, headers) in (200, 101, 404), path
    assert served.record.get("job") is None
    assert served.true_yaw() == before


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://{own}", "http://{own}1", "http://localhost"]
)
def test_a_foreign_origin_is_refused_on_every_route(served, origin):
    for path, upgrade in every_route(served):
        headers = {"Host": own(served), "Origin": origin.format(own=own(served))} | upgrade
        assert status(served, path, headers) == 403, path
        headers["Origin"] = f"http://{own(served)}"
        assert status(served, path, headers) in (200, 101, 404), path


@pytest.mark.parametrize("token", ["", "?token=", "?token=wrong", "?token=é"])
def test_without_the_token_a_page_only_watches(served, token):
    before = served.true_yaw()
    with connect(f"ws://{own(served)}/ws{token}") as socket:
        first = json.loads(socket.recv())
        assert first["page"]["role"] == "watcher"
        assert not first["page"]["may_command"]
        for command in ("check", "stop", "take", "calibrate"):
            socket.send(json.dumps({"do": command}))
            while "notice" not in (heard := json.loads(socket.recv())):
                assert heard["page"]["role"] == "watcher"
            assert "only watches" in heard["notice"]
    assert served.record.get("job") is None
    assert served.true_yaw() == before


@pytest.mark.parametrize(
    "message",
    ["", "{", "[]", '{"do": "move"}', '{"do": "gaze", "count": 1e9}', '{"do":"check","x":1}'],
)
def test_what_is_no_command_is_refused_and_named(served, message):
    with connect(f"ws://{own(served)}{commanding(served)}") as socket:
        socket.send(message)
        while "notice" not in (heard := json.loads(socket.recv())):
            pass
        assert heard["notice"]
    assert served.record.get("job") is None


def test_a_stop_waits_for_nothing_that_was_asked_before(served, monkeypatch):
    looking, stopped = threading.Event(), threading.Event()
    monkeypatch.setattr(served.session, "pick", lambda _: str(looking.wait(30)))
    monkeypatch.setattr(served.session, "stop", stopped.set)
    with connect(f"ws://{own(served)}{commanding(served)}") as socket:
        socket.send('{"do": "pick", "camera": "c1", "u": 1, "v": 2.5}')
        socket.send('{"do": "stop"}')
        assert stopped.wait(30)
        looking.set()
        while json.loads(socket.recv(timeout=30)).get("picked") != "True":
            pass


def test_a_run_shows_only_its_own_files(served):
    run = served.session.places.run
    run.mkdir(parents=True, exist_ok=True)
    (run / "report.html").write_text("<p>report</p>")
    (run / "secret.txt").write_text("secret")
    (run.parent / "calibration.json").write_text("{}")
    host = {"Host": own(served)}
    assert status(served, "/run/report.html", host) == 200
    for path in ("secret.txt", "../calibration.json", "..%2fcalibration.json", ".stages", ""):
        assert status(served, f"/run/{path}", host) == 404, path


def test_the_page_may_load_nothing_from_elsewhere(served):
    with urllib.request.urlopen(f"http://{own(served)}/") as answer:
        policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy


def test_listening_elsewhere_needs_the_token_for_everything(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with live(tmp_path, host="0.0.0.0") as server:  # noqa: S104 - what is tested
        host = {"Host": own(server)}
        for path, upgrade in every_route(server):
            for wrong in ("", "?token=", "?token=wrong"):
                bare = path.partition("?")[0]
                wanted = 200 if bare.startswith("/static/") else 403
                assert status(server, bare + wrong, host | upgrade) == wanted, bare
        assert status(server, f"/?token={server.access.token}", host) == 200
        assert status(server, commanding(server), host | UPGRADE) == 101
        assert status(server, f"/?token={server.access.token}", {"Host": "evil.example"}) == 403
        with pytest.raises(InvalidStatus), connect(f"ws://{own(server)}/ws"):
            pass
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"http://{own(server)}/")


def test_each_run_has_its_own_token_which_is_not_shown():
    assert Access("127.0.0.1").token != Access("127.0.0.1").token
    assert len(Access("127.0.0.1").token) >= 32
    access = Access("127.0.0.1")
    assert access.token not in repr(access)
