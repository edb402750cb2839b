"""Guided pictures as a job of the page's session. Evidence: property."""

from __future__ import annotations

import threading

import pytest
from live_server import settings

from calib.live.bench import Places
from calib.live.commands import Pictures
from calib.live.session import Given, Session


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    places = Places(None, tmp_path / "data", tmp_path / "run")
    with Session(Given(settings(time="simulated"), places)) as opened:
        yield opened


def until(session, wanted):
    for _ in range(4000):
        state = session.record.snapshot()[1]
        if wanted(state):
            return state
        threading.Event().wait(0.01)
    raise AssertionError(state)


def test_an_outline_is_shown_until_stop_and_pictures_are_kept(session):
    session.submit(Pictures(do="pictures", kind="intrinsics"))
    state = until(session, lambda s: s.get("asked") and s["pictures"]["c1"] >= 1)
    asked = state["asked"]
    assert asked["camera"] == "c1"
    assert "nearer by" in asked["why"]
    assert len(asked["outline"]) >= 8
    session.stop()
    state = until(session, lambda s: s["job"] is None)
    assert state["asked"] is None
    assert "stopped; the pictures taken are kept" in state["log"][-1]["text"]
    kept = sorted((session.places.dataset / "intrinsics" / "c1").glob("*.png"))
    assert len(kept) == state["pictures"]["c1"]
    session.submit(Pictures(do="pictures", kind="sweep"))
    state = until(session, lambda s: s["job"] is None and "nobody knows how good" in str(s["log"]))
    session.submit(Pictures(do="pictures", kind="stereo"))
    until(session, lambda s: "the lens of c" in str(s["log"]))
