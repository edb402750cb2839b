"""The index of calibrations. Evidence: properties, writers killed at random."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.history import entry
from calib.history.entry import IndexEntry, read_entry
from calib.history.index import history, rigs, update
from calib.history.scan import scan
from calib.history.summary import notes
from calib.stages.manifest import begin_outputs, end_outputs
from calib.stages.run_folder import ALWAYS
from tests.history.fleet import COVARIANCE, NAMES, STD, TRUTH, fleet, written


def contents(index: Path) -> list[tuple[object, ...]]:
    with sqlite3.connect(index) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return connection.execute("SELECT * FROM calibration ORDER BY path").fetchall()


def test_kept_index_equals_one_made_anew(tmp_path: Path) -> None:
    top, kept = fleet(tmp_path / "runs", of=3, each=4), tmp_path / "kept.sqlite"
    assert len(update(kept, [top]).added) == 12
    shutil.move(top / "000-01", top / "elsewhere")
    shutil.rmtree(top / "001-02")
    written(top / "new", TRUTH, rig="R9", day=date(2021, 1, 1))
    (top / "002-00" / "calibration.json").write_text("{")
    found = update(kept, [top])
    assert found.moved == ((str(top / "000-01"), str(top / "elsewhere")),)
    assert found.deleted == (str(top / "001-02"),)
    assert found.added == (str(top / "new"),)
    assert [path for path, _ in found.unreadable] == [str(top / "002-00")]
    update(tmp_path / "anew.sqlite", [top])
    assert contents(kept) == contents(tmp_path / "anew.sqlite")
    assert [number for _, number, _ in rigs(kept)] == [4, 3, 3, 1]


def test_what_changes_before_the_lock_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one writer waits, folders change and another writer has seen it."""
    top, kept = fleet(tmp_path / "runs", of=2, each=3), tmp_path / "kept.sqlite"
    update(kept, [top])
    late = []

    def scan_then_change(*given: Any) -> object:
        found = scan(*given)
        if not late:
            late.append(True)
            shutil.rmtree(top / "000-00")
            shutil.move(top / "000-01", top / "moved")
            shutil.rmtree(top / "001-00")
            written(top / "001-00", TRUTH + STD, rig="R001", day=date(2022, 1, 1))
            written(top / "new", TRUTH, rig="R9", day=date(2021, 1, 1))
            update(kept, [top])
        return found

    monkeypatch.setattr("calib.history.index.scan", scan_then_change)
    update(kept, [top])
    assert late
    update(tmp_path / "anew.sqlite", [top])
    assert contents(kept) == contents(tmp_path / "anew.sqlite")
    assert {Path(str(row[0])).name for row in contents(kept)} >= {"moved", "new", "001-00"}


def test_files_as_they_were_are_not_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is one overlooked that changed within the time that file systems tell apart."""
    top, index = fleet(tmp_path / "runs", of=2, each=3), tmp_path / "i.sqlite"
    read: list[str] = []

    def reading(folder: Path) -> IndexEntry:
        read.append(folder.name)
        return read_entry(folder)

    monkeypatch.setattr("calib.history.scan.read_entry", reading)
    update(index, [top])
    young = len(read)
    assert young >= 6
    monkeypatch.setattr("calib.history.scan.YOUNG_S", -3600.0)
    update(index, [top])
    read.clear()
    assert update(index, [top]).calibrations == 6
    assert read == []
    result = top / "000-01" / "calibration.json"
    was, text = result.stat(), result.read_text()
    result.write_text(text.replace("axis-offset", "axis-tilted"))
    os.utime(result, ns=(was.st_atime_ns, was.st_mtime_ns))
    (top / "001-01" / "run.toml").write_text('[run]\nfinished = "2030-01-01T08:00:00+00:00"\n')
    assert update(index, [top]).changed == (str(result.parent),)
    assert sorted(set(read)) == ["000-01", "001-01"]
    assert rigs(index)[1] == ("R001", 3, "2030-01-01")


def finish(run: Path) -> None:
    """Write the rest of a run, and its manifest."""
    begin_outputs(run, ALWAYS)
    for name in ("results.h5", "report.html"):
        (run / name).write_text("")
    end_outputs(run, "", (*ALWAYS, *(p.name for p in run.glob("certificate.*"))))


def test_a_link_is_of_the_run_that_its_target_lies_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.history.scan.YOUNG_S", -3600.0)
    top, index = fleet(tmp_path / "runs", of=1, each=1), tmp_path / "i.sqlite"
    run = top / "000-00"
    finish(run)
    view = tmp_path / "views" / "mine"
    view.mkdir(parents=True)
    for name in ("calibration.json", "run.toml"):
        (view / name).symlink_to(run / name)
    assert update(index, [view.parent]).calibrations == 1
    assert update(index, [view.parent]).unreadable == ()
    begin_outputs(run, ALWAYS)
    ((path, fault),) = update(index, [view.parent]).unreadable
    assert path == str(view)
    assert "did not finish" in fault


def test_files_of_two_runs_make_no_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run is made again while it is read: its calibration was of before, its date of after."""
    run = written(tmp_path / "run", TRUTH, rig="R", day=date(2021, 1, 1))
    finish(run)
    assert read_entry(run).date == "2021-01-01"
    read = entry.read_limited

    def reading(path: Path, limit: int, *, regular: bool) -> bytes:
        content = read(path, limit, regular=regular)
        if path.name == "calibration.json":
            (run / "run.toml").write_text('[run]\nfinished = "2022-02-02T08:00:00+00:00"\n')
            finish(run)
        return content

    monkeypatch.setattr(entry, "read_limited", reading)
    with pytest.raises(ValueError, match="run\\.toml is not what the run wrote"):
        read_entry(run)


def test_a_folder_whose_name_is_no_text_is_told_and_the_others_are_taken(tmp_path: Path) -> None:
    top = fleet(tmp_path / "runs", of=1, each=2)
    (top / "000-01").rename(top / os.fsdecode(b"caf\xe9"))
    found = update(tmp_path / "i.sqlite", [top])
    assert found.added == (str(top / "000-00"),)
    ((_, fault),) = found.unreadable
    assert "UTF-8" in fault


def test_what_cannot_be_listed_is_told_and_not_called_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    top, index = tmp_path / "runs", tmp_path / "i.sqlite"
    for name in ("one", "two"):
        fleet(top / name, of=1, each=2)
    assert update(index, [top]).calibrations == 4
    scandir = os.scandir

    def closed(path: str) -> object:
        if Path(path) == top / "two":
            raise PermissionError(errno.EACCES, "Permission denied", path)
        return scandir(path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "scandir", closed)
        found = update(index, [top])
    assert (found.calibrations, found.deleted) == (2, ())
    assert found.unreadable == ((str(top / "two"), "cannot be listed (Permission denied)"),)
    assert update(index, [top]).calibrations == 4


def test_an_index_that_may_only_be_read_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readers of a write-ahead log write beside it, which the owner of a share may not allow."""
    folder = tmp_path / "a ?%20#share"
    folder.mkdir()
    index = folder / "i.sqlite"
    update(index, [fleet(tmp_path / "runs", of=1, each=3)])
    index.chmod(0o444)
    folder.chmod(0o555)
    # For root, who may write anywhere.
    monkeypatch.setattr("calib.history.index.os.access", lambda *_: False)
    assert len(history(index, "R000")) == 3
    assert [path.name for path in folder.iterdir()] == ["i.sqlite"]
    monkeypatch.undo()
    folder.chmod(0o755)
    assert len(history(index, "R000")) == 3
    assert [path.name for path in folder.iterdir()] == ["i.sqlite"]


def test_calibrations_elsewhere_are_kept(tmp_path: Path) -> None:
    index = tmp_path / "i.sqlite"
    one = fleet(tmp_path / "one", of=1, each=2)
    two = tmp_path / "two"
    written(two / "run", TRUTH, rig="other", day=date(2021, 1, 1))
    update(index, [one])
    shutil.move(one, tmp_path / "unmounted")
    assert update(index, [two]).deleted == ()
    assert [rig for rig, _, _ in rigs(index)] == ["R000", "other"]


def test_the_rig_is_that_of_json_then_certificate_then_dataset(tmp_path: Path) -> None:
    index = tmp_path / "i.sqlite"
    certificate = (
        '<c xmlns="https://ptb.de/dcc"><administrativeData>'
        "<coreData><endPerformanceDate>2019-05-06</endPerformanceDate></coreData>"
        "<items><item><identifications><identification><value>{serial}</value>"
        "<name><content>serial number</content></name></identification></identifications></item>"
        "</items></administrativeData></c>"
    )
    for name, rig, serial in (("a", "A1", "C1"), ("b", None, "C1"), ("c", None, "c" * 64)):
        folder = written(
            tmp_path / "runs" / name, TRUTH, rig=rig, day=date(2021, 1, 1), dataset=name * 64
        )
        (folder / "certificate.xml").write_text(certificate.format(serial=serial))
    update(index, [tmp_path / "runs"])
    assert {(rig, day) for rig, _, day in rigs(index)} == {
        ("A1", "2019-05-06"), ("C1", "2019-05-06"), ("my-rig", "2019-05-06"),
    }  # fmt: skip


def test_what_nobody_sees_makes_no_other_rig(tmp_path: Path) -> None:
    """Spaces, and letters with an accent of their own."""
    serials = [
        "R\N{LATIN SMALL LETTER E WITH ACUTE} 1",
        " Re\N{COMBINING ACUTE ACCENT}\t1 ",
        "r1",
        " ",
    ]
    for k, serial in enumerate(serials):
        written(tmp_path / "runs" / str(k), TRUTH, rig=serial, day=date(2021, 1, 1 + k))
    index = tmp_path / "i.sqlite"
    update(index, [tmp_path / "runs"])
    assert [(rig, number) for rig, number, _ in rigs(index)] == [
        ("R\N{LATIN SMALL LETTER E WITH ACUTE} 1", 2), ("my-rig", 1), ("r1", 1),
    ]  # fmt: skip
    assert any("no serial number" in note for note in notes(history(index, "my-rig")))
    assert not any("no serial number" in note for note in notes(history(index, "r1")))


PROGRAM = "import sys; from calib.cli.main import main; sys.exit(main())"


def writer(index: Path, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "history", "index", str(folder), "--index", str(index)],
        stdout=subprocess.DEVNULL,
    )


@pytest.mark.slow
def test_two_writers_and_twenty_kills_lose_nothing(tmp_path: Path) -> None:
    index, rng = tmp_path / "i.sqlite", np.random.default_rng(0)
    tops = [fleet(tmp_path / name, of=60, each=5) for name in ("one", "two")]
    kept = written(tmp_path / "before" / "run", TRUTH, rig="kept", day=date(2021, 1, 1))
    update(index, [kept.parent])
    killed = 0
    while killed < 20:
        for process in [writer(index, top) for top in tops]:
            try:
                process.wait(timeout=rng.uniform(0.2, 2.0))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                killed += 1
        assert any(row[0] == str(kept) for row in contents(index))
    for process in [writer(index, top) for top in tops]:
        assert process.wait() == 0
    update(tmp_path / "anew.sqlite", [*tops, kept.parent])
    assert contents(index) == contents(tmp_path / "anew.sqlite")


def test_runs_of_one_dataset_are_one_calibration(tmp_path: Path) -> None:
    """Else the same rows, calibrated thrice, make a reference of u / sqrt(3)."""
    for k, hour in enumerate(("09:00:00+00:00", "12:00:00+02:00", "08:00:00+00:00")):
        folder = tmp_path / "runs" / str(k)
        values = TRUTH + 1e-3 * k * STD
        written(folder, values, rig="R", day=date(2021, 1, 1), dataset="a" * 64, hour=hour)
    update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    (only,) = history(tmp_path / "i.sqlite", "R")
    assert only.path.endswith("/1")
    assert rigs(tmp_path / "i.sqlite") == [("R", 1, "2021-01-01")]


def test_calibrations_of_one_day_are_in_order_of_time(tmp_path: Path) -> None:
    """As found before an adjustment and as left after it, whatever their folders are called."""
    day = date(2021, 1, 1)
    for name, hour in (("a", "12:00:00+00:00"), ("b", "23:00:00+14:00"), ("c", "11:00:00-02:00")):
        written(tmp_path / "runs" / name, TRUTH, rig="R", day=day, hour=hour)
    update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    entries = history(tmp_path / "i.sqlite", "R")
    assert [Path(e.path).name for e in entries] == ["b", "a", "c"]
    assert any("3 calibrations on 1 day:" in note for note in notes(entries))


@pytest.mark.parametrize(
    ("measurement", "told"),
    [
        ({"covariance": np.zeros((4, 4)).tolist()}, "not above 0"),
        ({"covariance": (-COVARIANCE).tolist()}, "not above 0"),
        ({"covariance": np.triu(COVARIANCE).tolist()}, "not symmetric"),
        ({"covariance": np.outer(STD, STD * [1, 1, -1, 1]).tolist()}, "not"),
        ({"covariance": (2 * np.diag(STD**2) - np.outer(STD, STD)).tolist()}, "negative"),
        ({"calibrated_depth_mm": [0, 0]}, "no range"),
        ({"calibrated_depth_mm": [1400, 600]}, "no range"),
        ({"names": [NAMES[0]] * 4}, "each once"),
        ({"names": ["delta2_rad"], "values": [0.0], "covariance": [[1e-6]]}, "baseline_mm"),
    ],
)
def test_impossible_calibrations_stay_out(
    tmp_path: Path, measurement: dict[str, object], told: str
) -> None:
    folder = tmp_path / "runs" / "bad"
    written(folder, TRUTH, rig="R", day=date(2021, 1, 1), measurement=measurement)
    ((path, why),) = update(tmp_path / "i.sqlite", [tmp_path / "runs"]).unreadable
    assert path == str(folder)
    assert told in why
