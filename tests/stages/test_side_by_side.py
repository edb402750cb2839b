"""Stages in processes of their own: the same outcomes, and nothing lost or left behind.

Evidence: property. What is computed side by side equals, byte for byte, what is computed here.
"""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import stages_apart
from stages_apart import Numbers

import calib.stages.store
from calib.core.errors import CalibError
from calib.stages import step as step_module
from calib.stages.message import receive, send
from calib.stages.store import Step, Store, given, stage

HERE = Path(__file__).parent
PATIENCE_S = 20.0
NUMBERS = given("numbers", Numbers(np.arange(5.0)))


@pytest.fixture(autouse=True)
def workers_find_the_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    monkeypatch.setattr(step_module, "code_fingerprint", lambda _: "code")
    monkeypatch.setattr(calib.stages.store, "processors", lambda: 2)


def steps(*functions: str, count: int = 5, **settings: object) -> dict[str, Step]:
    source = given("numbers", Numbers(np.arange(float(count))))
    return {
        f"{f}{i}": Step(f"{i}/{f}", getattr(stages_apart, f), (source,), settings)
        for i, f in enumerate(functions)
    }


def test_outcomes_are_those_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = steps("draw", "draw", "draw", seed=7)
    told: list[object] = []
    apart = Store(tmp_path / "2", told.append, lambda *step: told.append(step))
    several = apart.run_all(wanted)
    monkeypatch.setattr(calib.stages.store, "processors", lambda: 1)
    alone = Store(tmp_path / "1")
    one = alone.run_all(wanted)
    for key in wanted:
        assert np.array_equal(several[key].value.values, one[key].value.values)
    files = sorted((tmp_path / "1" / ".stages").iterdir())
    assert len(files) == 3
    for file in files:
        assert (tmp_path / "2" / ".stages" / file.name).read_bytes() == file.read_bytes()
    assert set(apart.durations) == set(alone.durations) == {"0/draw", "1/draw", "2/draw"}
    assert apart.reused == alone.reused == []
    assert all(0 < seconds < PATIENCE_S for seconds in apart.durations.values())
    for name in apart.durations:
        assert [t for t in told if name in (t, t[0])] == [name, (name, 1, 2), (name, 2, 2)]
    assert len({tuple(s.value.values) for s in several.values()}) == 3, "each its own seed"
    assert capsys.readouterr().out.count("a library that speaks") == 3, "of one process only"


def test_each_processor_has_one_at_a_time(tmp_path: Path) -> None:
    done = Store(tmp_path).run_all(steps(*["place"] * 4))
    where = [staged.value.process for staged in done.values()]
    assert len(set(where)) == 2
    assert os.getpid() not in where


def test_one_missing_stage_needs_no_other_process(tmp_path: Path) -> None:
    Store(tmp_path).run_all(steps("draw", "draw", seed=1))
    store = Store(tmp_path)
    done = store.run_all(steps("draw", "draw", seed=1) | steps("place"))
    assert done["place0"].value.process == os.getpid()
    assert store.reused == ["0/draw", "1/draw"]
    assert list(store.durations) == ["0/place"]


def test_refusal_is_an_outcome(tmp_path: Path) -> None:
    done = Store(tmp_path).run_all(steps("refuse", "place"))
    assert done["refuse0"].failed == "5 numbers are too few"
    assert done["place1"].failed is None
    again = Store(tmp_path)
    assert again.run_all(steps("refuse", "place"))["refuse0"].failed == "5 numbers are too few"
    assert again.reused == ["0/refuse", "1/place"]


def test_input_that_failed_fails_what_needs_it(tmp_path: Path) -> None:
    store = Store(tmp_path)
    refused = store.run_all(steps("refuse"))["refuse0"]
    names = ("x", "y")
    after = {n: Step(n, stages_apart.place, (refused,)) for n in names}
    done = store.run_all(after | steps("place"))
    assert {done[n].failed for n in names} == {"5 numbers are too few"}
    assert done["place0"].failed is None


def test_killed_worker_is_named_and_the_rest_kept(tmp_path: Path) -> None:
    wanted = steps("draw", seed=1) | {"die1": Step("1/die", stages_apart.die, (NUMBERS,))}
    with pytest.raises(CalibError, match=r"1/die: its process was killed \(SIGKILL\), as systems"):
        Store(tmp_path).run_all(wanted)
    assert [p.name for p in (tmp_path / ".stages").iterdir()] == ["0--draw.h5"]
    assert_no_children()


def test_ended_worker_is_named_without_a_traceback(tmp_path: Path) -> None:
    wanted = steps("draw", seed=1) | {"end1": Step("1/end", stages_apart.be_ended, (NUMBERS,))}
    with pytest.raises(CalibError, match=r"1/end: .* ended from outside \(SIGTERM\); run again"):
        Store(tmp_path).run_all(wanted)
    assert [p.name for p in (tmp_path / ".stages").iterdir()] == ["0--draw.h5"]


def test_misspelt_setting_is_found_before_anything_runs() -> None:
    with pytest.raises(TypeError, match="'seed'"):
        stage("draw", stages_apart.draw, NUMBERS, sed=1)


def test_defect_shows_its_traceback(tmp_path: Path) -> None:
    wanted = steps("break_down", "place")
    with pytest.raises(RuntimeError, match=r"(?s)0/break_down failed.*KeyError: 'nothing'"):
        Store(tmp_path).run_all(wanted)
    assert_no_children()


def test_refused_input_keeps_its_words(tmp_path: Path) -> None:
    with pytest.raises(CalibError) as caught:
        Store(tmp_path).run_all(steps("mislead", "mislead"))
    assert str(caught.value) == "a.png: is no picture of 5; send another\nb.png: as bad; as well"
    assert caught.value.exit_status == 2
    assert_no_children()


def test_worker_that_ends_is_a_defect(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="leave: its process ended with status 7"):
        Store(tmp_path).run_all(steps("leave", "leave"))
    assert_no_children()


def test_interruption_ends_the_workers(tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    started = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        Store(tmp_path / "out", progress=interrupt).run_all(lingering(tmp_path))
    assert time.perf_counter() - started < PATIENCE_S
    assert_no_children()


def test_interruption_ends_what_a_stage_has_started(tmp_path: Path) -> None:
    notes = [tmp_path / "0", tmp_path / "1"]

    def interrupt(*_: object) -> None:
        wait_for(lambda: all(note.exists() and note.read_text() for note in notes))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Store(tmp_path / "out", progress=interrupt).run_all(
            lingering(tmp_path, "call_out", ("0", "1"))
        )
    assert_no_children()
    wait_for(lambda: not any(is_running(int(note.read_text())) for note in notes))


def test_workers_do_not_outlive_a_killed_run(tmp_path: Path) -> None:
    with run_apart(tmp_path) as (process, workers):
        # Stopped, they notice nothing and say nothing.
        for worker in workers:
            os.kill(worker, signal.SIGSTOP)
        process.kill()
        process.wait()
        wait_for(lambda: not any(map(is_running, workers)))


def test_interrupt_from_the_terminal_is_quiet(tmp_path: Path) -> None:
    """A terminal sends it to the whole group, workers too."""
    with run_apart(tmp_path) as (process, workers):
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 130
        assert err == b"interrupted\n"
        assert not any(map(is_running, workers))


def test_message_cut_short_is_none() -> None:
    whole = io.BytesIO()
    send(whole, {"name": "ä"}, b"12345")
    data = whole.getvalue()
    assert receive(io.BytesIO(data)) == ({"name": "ä", "size": 5}, b"12345")
    for length in range(len(data)):
        assert receive(io.BytesIO(data[:length])) is None


SCRIPT = """
import sys
from pathlib import Path
from test_side_by_side import linger
try:
    linger(Path(sys.argv[1]))
except KeyboardInterrupt:
    print("interrupted", file=sys.stderr)
    sys.exit(130)
"""
"""Without the guard that `multiprocessing` asks of scripts."""


def linger(folder: Path) -> None:
    """Run two stages of a minute each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(step_module, "code_fingerprint", lambda _: "code")
        patch.setattr(calib.stages.store, "processors", lambda: 2)
        Store(folder / "out").run_all(lingering(folder))


def lingering(
    folder: Path, function: str = "linger", names: tuple[str, str] = ("a", "b")
) -> dict[str, Step]:
    source = given("numbers", Numbers(np.arange(5.0)))
    target = getattr(stages_apart, function)
    return {n: Step(n, target, (source,), {"note": str(folder / n)}) for n in names}


@contextmanager
def run_apart(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], list[int]]]:
    """Give a process, leader of its group, whose two workers are at work, and their ids."""
    (folder / "script.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(folder / "script.py"), str(folder)],
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    with process:
        notes = [folder / "a", folder / "b"]
        try:
            wait_for(lambda: all(note.exists() and note.read_text() for note in notes))
            yield process, [int(note.read_text()) for note in notes]
        finally:
            if process.poll() is None:
                process.kill()


def wait_for(condition: Callable[[], bool]) -> None:
    started = time.perf_counter()
    while not condition():
        assert time.perf_counter() - started < PATIENCE_S
        time.sleep(0.02)


def is_running(pid: int) -> bool:
    """Whether a process is there, and not only its exit status."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"


def assert_no_children() -> None:
    """Fail if a worker lives; other tests of this process may have left helpers of libraries."""
    threads = Path("/proc/self/task").iterdir()
    own = [child for one in threads for child in (one / "children").read_text().split()]
    commands = [Path(f"/proc/{child}/cmdline").read_bytes() for child in own]
    assert not [c for c in commands if b"calib.stages.worker" in c or not c]
