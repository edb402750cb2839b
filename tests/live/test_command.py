"""`calib live` as a command: what it needs, what it prints, how it ends.

Evidence: property.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from importlib.metadata import requires
from pathlib import Path

import uvicorn
from live_server import live
from packaging.requirements import Requirement
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from calib.cli.main import main
from calib.live.commands import Check
from calib.live.serve import Server
from calib.rig.protocols import Lost

PROJECT = Path(__file__).parents[2]
CALIB = Path(sys.executable).with_name("calib")


def test_without_the_extra_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "uvicorn" else found(name)
    )
    assert main(["live"]) == 2
    error = capsys.readouterr().err
    assert "uvicorn cannot be imported" in error
    assert "active-gazing-calib[web]" in error


def test_a_taken_port_is_refused_before_the_rig_is_opened(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["live", "--port", str(taken.getsockname()[1])]) == 2
    error = capsys.readouterr().err
    assert "cannot listen at 127.0.0.1" in error
    assert "--port" in error


def test_a_calibration_that_is_none_ends_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calibration.json").write_text("{}")
    assert main(["live", "calibration.json", "--port", "0"]) == 2
    assert "calibration.json" in capsys.readouterr().err


def turning(socket):
    """Wait until the page's state says that C2 turns."""
    while True:
        heard = json.loads(socket.recv(timeout=60))
        if heard.get("state", {}).get("turning"):
            return


def test_a_signal_stops_the_motor_before_the_server_ends(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with live(tmp_path) as server:
        server.session.submit(Check(do="check"))
        server.turning()
        server.server.handle_exit(signal.SIGINT, None)
        assert server.server.should_exit
        assert server.session._bench.axis.is_stopped
        time.sleep(0.5)
        where = server.true_yaw()
        time.sleep(0.3)
        assert server.true_yaw() == where


def test_a_signal_ends_the_server_though_the_axis_does_not_answer():
    def lost():
        raise Lost("the cable is off")

    server = Server(uvicorn.Config(lambda: None), lost)
    server.handle_exit(signal.SIGTERM, None)
    assert server.should_exit
    assert not server.force_exit
    server.handle_exit(signal.SIGTERM, None)
    assert server.force_exit


def test_ctrl_c_in_a_move_ends_it(tmp_path):
    process = subprocess.Popen(
        [CALIB, "live", "--port", "0"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONWARNINGS": "error"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        line = process.stdout.readline()
        address = re.fullmatch(r"open (http://127\.0\.0\.1:\d+/\?token=\S{32,})\n", line)
        assert address is not None, line
        with urllib.request.urlopen(address[1]) as answer:  # noqa: S310 - http, as matched
            assert b"<title>calib live</title>" in answer.read()
        with connect(address[1].replace("http", "ws").replace("/?", "/ws?")) as socket:
            socket.send('{"do": "check"}')
            turning(socket)
            process.send_signal(signal.SIGINT)
            with suppress(ConnectionClosed):
                while True:
                    socket.recv(timeout=60)
        _, error = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0, error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def closure(names):
    """Return what packages require, themselves included, whatever the markers of Windows say."""
    found = set()
    todo = list(names)
    while todo:
        name = todo.pop().lower()
        if name in found:
            continue
        found.add(name)
        for text in requires(name) or ():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                todo.append(requirement.name)
    return found


def test_what_make_live_installs_is_all_that_the_page_needs():
    script = (PROJECT / "tools" / "setup_web.sh").read_text()
    installed = set(re.search(r'^packages="(.*)"$', script, re.MULTILINE)[1].split())
    core = set(re.findall(r"^([\w.-]+)==", (PROJECT / "requirements.lock").read_text(), re.M))
    pinned = set(re.findall(r"^([\w.-]+)==", (PROJECT / "requirements-dev.lock").read_text(), re.M))
    needed = closure(["starlette", "uvicorn", "websockets"])
    assert {name.replace("_", "-") for name in needed} - core <= installed
    assert installed <= pinned
