"""The owner of the motor: Stop holds, whenever it comes.

Evidence: simulated truth.
"""

from __future__ import annotations

import threading

import pytest
from live_server import settings

from calib.core.errors import UsageError
from calib.live import jobs
from calib.live.bench import Places
from calib.live.commands import Calibrate, Check, Gaze
from calib.live.guarded import GuardedAxis
from calib.live.hand import PageHand
from calib.live.record import Record
from calib.live.session import WAITING_MAX, Given, Session
from calib.rig.protocols import Interrupted, Lost


class Axis:
    """An axis whose move forgets a stop that came before it began, as real ones do."""

    identity, resolution_rad, step_rad, range_rad = "axis", 1e-4, 1e-3, (0.0, 3.0)

    def __init__(self):
        self.stopped = threading.Event()
        self.begun, self.may_begin = threading.Event(), threading.Event()

    def move(self, reading_rad, *, approach=1):  # noqa: ARG002 - as the protocol has it
        self.begun.set()
        self.may_begin.wait(5)
        self.stopped.clear()
        if self.stopped.wait(5):
            raise Interrupted("the move was stopped")
        raise AssertionError("the move was not stopped")

    def stop(self):
        self.stopped.set()
        self.may_begin.set()


def test_a_stop_that_comes_as_a_move_begins_is_not_lost():
    axis = Axis()
    guarded = GuardedAxis(axis, lambda _: None)
    ended = []

    def move():
        with pytest.raises(Interrupted) as caught:
            guarded.move(1.0)
        ended.append(caught.value)

    thread = threading.Thread(target=move)
    thread.start()
    assert axis.begun.wait(5)
    guarded.stop()
    thread.join(5)
    assert len(ended) == 1


def test_after_a_stop_nothing_moves_until_the_next_job():
    axis = Axis()
    guarded = GuardedAxis(axis, lambda _: None)
    guarded.stop()
    with pytest.raises(Interrupted):
        guarded.move(1.0)
    assert not axis.begun.is_set()
    guarded.allow()
    guarded.refuse_stopped()


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    places = Places(None, tmp_path / "data", tmp_path / "run")
    with Session(Given(settings(time="simulated"), places)) as opened:
        yield opened


def check():
    return Check(do="check")


def test_stop_forgets_what_waits_and_the_queue_has_an_end(session):
    session.submit(check())
    for _ in range(WAITING_MAX - 1):
        session.submit(Gaze(do="gaze"))
    with pytest.raises(UsageError, match="8 jobs wait already"):  # noqa: PT012 - one may be at work
        session.submit(Gaze(do="gaze"))
        session.submit(Gaze(do="gaze"))
    with pytest.raises(UsageError, match="Check is at work or waits already"):
        session.submit(check())
    session.stop()
    state = session.record.snapshot()[1]
    assert state["waiting"] == []


def test_devices_are_closed_and_the_motor_stopped_when_a_session_ends(session):
    session.submit(check())
    session.__exit__()
    assert not session._thread.is_alive()
    assert session._bench.axis.is_stopped


def test_a_job_that_cannot_be_done_says_why_and_the_next_one_is_done(session):
    session.submit(Calibrate(do="calibrate"))
    for _ in range(400):
        state = session.record.snapshot()[1]
        if any("Calibrate" in line["text"] for line in state["log"]):
            break
        threading.Event().wait(0.05)
    lines = [line for line in state["log"] if "Calibrate" in line["text"]]
    assert lines[0]["kind"] == "bad"
    assert "dataset.toml" in lines[0]["text"]


def logged(session, words):
    for _ in range(400):
        lines = [line for line in session.record.snapshot()[1]["log"] if words in line["text"]]
        if lines:
            return lines[0]
        threading.Event().wait(0.05)
    raise AssertionError(session.record.snapshot()[1]["log"])


def test_a_fault_of_the_program_stops_the_motor_and_the_page_goes_on(session, monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("nothing to divide by")

    with monkeypatch.context() as patch:
        patch.setattr(jobs, "run", broken)
        session.submit(check())
        line = logged(session, "a fault of the program, ZeroDivisionError")
    assert line["kind"] == "bad"
    assert session._bench.axis.is_stopped
    assert "nothing to divide by" in capsys.readouterr().err
    session.submit(Gaze(do="gaze"))
    logged(session, "there is no calibration")


def test_an_axis_that_does_not_obey_keeps_no_question_and_no_job(session, monkeypatch):
    def lost():
        raise Lost("the controller does not answer")

    session.submit(Gaze(do="gaze"))
    with monkeypatch.context() as patch:
        patch.setattr(session._bench.axis, "stop", lost)
        with pytest.raises(Lost):
            session.stop()
        session.submit(check())
        session.owner_left()
        assert "does not obey" in logged(session, "does not answer")["text"]
    assert session.record.get("question") is None
    assert session.record.get("waiting") == []


def test_a_closed_rig_takes_no_jobs(session):
    session.__exit__()
    with pytest.raises(UsageError, match="closed"):
        session.submit(check())


def asked(hand, work):
    """Let the hand ask in a thread of its own; return the thread and what came of it."""
    came = []

    def run():
        try:
            came.append(work(hand))
        except Interrupted as error:
            came.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, came


def question(record):
    for _ in range(500):
        if (found := record.get("question")) is not None:
            return found
        threading.Event().wait(0.01)
    raise AssertionError("nothing was asked")


def test_an_operator_is_asked_until_there_is_a_depth():
    record = Record()
    thread, came = asked(PageHand(record, lambda: None), lambda hand: hand.depth_mm("g01"))
    for wrong in ("", "far", "-3", "inf"):
        assert question(record) == {"text": "g01: its depth in mm", "kind": "number"}
        record.answer(wrong)
    while len(record.snapshot()[1]["log"]) < 4:
        threading.Event().wait(0.01)
    question(record)
    record.answer("1200.5")
    thread.join(5)
    assert came == [(1200.5, None)]


def test_stop_withdraws_a_question_and_comes_before_the_next():
    record = Record()
    thread, came = asked(PageHand(record, lambda: None), lambda hand: hand.place("g01"))
    question(record)
    record.answer(None)
    thread.join(5)
    assert isinstance(came[0], Interrupted)
    assert record.get("question") is None

    def refuse():
        raise Interrupted("stopped")

    thread, came = asked(PageHand(record, refuse), lambda hand: hand.place("g01"))
    thread.join(5)
    assert isinstance(came[0], Interrupted)
