"""Batches. Evidence: real runs in processes, a real Dask cluster, kills."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import distributed
import pytest

from calib.batch.run import run_batch, tasks_of
from calib.batch.summary import SummaryLine, csv_text, page
from calib.batch.task import DatasetTask, calibrate_one
from calib.core.errors import UsageError
from calib.stages.files import is_in_use
from calib.stages.store import Store
from tests.cli.command import CALIB, DATASETS, process

PAPER = DATASETS / "xu-wang-2017"


def lines(out: Path) -> list[dict[str, str]]:
    with (out / "batch.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def three(tmp_path: Path) -> Path:
    """Return a folder with a good dataset, one that is refused, and none at all."""
    top = tmp_path / "sets"
    shutil.copytree(PAPER, top / "good")
    (top / "bad").mkdir()
    (top / "bad" / "dataset.toml").write_text("format = 1\n")
    (top / "none").mkdir()
    return top


def test_a_failing_dataset_stops_none_and_a_batch_goes_on(three: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ended = process("batch", *sorted(three.iterdir()), "--out", out, "--jobs", 2)
    assert ended.status == 2, ended.err
    assert "3 datasets: 1 contradicted, 2 refused" in ended.out
    found = {Path(line["dataset"]).name: line for line in lines(out)}
    # The paper's own validation depths differ from its calibration: report and certificate say so.
    assert found["good"]["result"] == "contradicted"
    assert "contradict each other" in found["good"]["remarks"]
    assert "contradicted: " in ended.err
    assert "passed: " not in ended.err
    assert float(found["good"]["L_b + e, mm"]) == pytest.approx(76.9, abs=0.5)
    assert "name" in found["bad"]["remarks"]
    text = (out / "batch.html").read_text()
    assert text.index(">bad<") < text.index(">good<")
    assert 'href="good/report.html"' in text
    kept = (out / "good" / "calibration.json").stat().st_mtime_ns
    again = process("batch", *sorted(three.iterdir()), "--out", out)
    assert again.status == 2
    assert (out / "good" / "calibration.json").stat().st_mtime_ns == kept


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_batch_and_its_processes(
    three: Path, tmp_path: Path, sent: signal.Signals
) -> None:
    batch = subprocess.Popen(
        [CALIB, "batch", three / "good", "--out", tmp_path / "out"],
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    while not (tmp_path / "out" / "good" / ".stages").exists():
        assert batch.poll() is None
        time.sleep(0.02)
    os.kill(batch.pid, sent)
    assert batch.wait(120) == 130
    deadline = time.monotonic() + 120
    while _group(batch.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert _group(batch.pid) == []


def test_a_killed_batch_takes_its_processes_along_in_mid_work(three: Path, tmp_path: Path) -> None:
    """Property: they are stopped, so that none can notice anything or say a word."""
    batch = subprocess.Popen(
        [CALIB, "batch", three / "good", "--out", tmp_path / "out"],
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    while not (tmp_path / "out" / "good" / ".stages").exists():
        assert batch.poll() is None
        time.sleep(0.02)
    wanted = 2  # the batch and the run; the run's own workers, where it has some by now
    while len(_group(batch.pid)) < wanted:
        time.sleep(0.02)
    for child in set(_group(batch.pid)) - {batch.pid}:
        os.kill(child, signal.SIGSTOP)
    batch.kill()
    batch.wait()
    deadline = time.monotonic() + 20
    while _group(batch.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert _group(batch.pid) == []


def _group(leader: int) -> list[int]:
    """Return the processes of a session that live."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                state, _, _, session = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
            except OSError:
                continue
            if int(session) == leader and state != "Z":
                found.append(int(entry.name))
    return found


def test_on_a_cluster_as_here(three: Path, tmp_path: Path) -> None:
    tasks = tasks_of([three / "bad", three / "none"], tmp_path / "out")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        there = run_batch(tasks, scheduler=cluster.scheduler_address)
    assert there == run_batch(tasks, jobs=2)
    assert [outcome.ending for outcome in there] == ["refused", "refused"]


def test_a_run_that_crashes_is_told_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killer = tmp_path / "python"
    killer.write_text('#!/bin/sh\necho "  base/linear" >&2\nkill -9 $$\n')
    killer.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(killer))
    outcome = calibrate_one(DatasetTask(str(PAPER), str(tmp_path / "out")))
    assert outcome.ending == "crashed"
    assert outcome.said == ("  base/linear", "ended with status -9")


def test_a_folder_in_use_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch on a cluster was killed: its workers are still at what they were given."""
    out, runs = tmp_path / "out", tmp_path / "runs"
    program, code = tmp_path / "python", tmp_path / "code.py"
    # A path with a space is no interpreter of a script's first line.
    program.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{code}'\n")
    code.write_text(
        "from pathlib import Path\n"
        "from calib.core.errors import UsageError\nfrom calib.stages.store import Store\n"
        f"with Path({str(runs)!r}).open('a') as file:\n    file.write('x')\n"
        f"try:\n    with Store(Path({str(out)!r})).locked():\n        pass\n"
        "except UsageError as error:\n    raise SystemExit(f'calib: {error}') from None\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr("calib.batch.task._ENDINGS", {0: "passed", 1: "refused"})
    monkeypatch.setattr(sys, "executable", str(program))
    with ThreadPoolExecutor() as pool:
        with Store(out).locked():
            assert is_in_use(out)
            waiting = pool.submit(calibrate_one, DatasetTask(str(PAPER), str(out)))
            while not (runs.exists() or waiting.done()):
                time.sleep(0.02)
            time.sleep(2.0)
            assert not waiting.done()
        assert waiting.result().ending == "passed"
    assert not is_in_use(out)
    assert len(runs.read_text()) == 2


def test_names_of_runs(tmp_path: Path) -> None:
    sets = [tmp_path / "rig1" / "day1", tmp_path / "rig2" / "day1", tmp_path / "demo"]
    found = [Path(task.out).name for task in tasks_of(sets, tmp_path / "out")]
    assert found == ["rig1-day1", "rig2-day1", "demo"]
    with pytest.raises(UsageError, match="given twice"):
        tasks_of([sets[2], sets[2] / "." / ".." / "demo"], tmp_path)
    clash = [tmp_path / "a" / "x" / "d", tmp_path / "b" / "x" / "d"]
    with pytest.raises(UsageError, match="would both go to"):
        tasks_of(clash, tmp_path)


def test_names_do_no_harm() -> None:
    line = SummaryLine("=cmd|x", "<b>\N{RIGHT-TO-LEFT OVERRIDE}", "refused", {}, ("<script>",), ())
    assert "'=cmd|x" in csv_text([line])
    text = page([line])
    assert "<script>" not in text
    assert "\N{RIGHT-TO-LEFT OVERRIDE}" not in text
