"""The index of calibrations. Evidence: properties, writers killed at random, simulated rigs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from calib.cli.main import main
from calib.core.errors import InputError
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import gaze_at
from calib.history.entry import Entry, read_entry
from calib.history.index import history, rigs, update
from calib.history.page import page_name
from calib.history.quantities import series
from calib.history.scan import scan
from calib.history.summary import due, notes, show, since
from calib.stages.manifest import begin_outputs, end_outputs
from calib.stages.run_folder import ALWAYS

NAMES = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"]
TRUTH = np.array([120.0, 0.01, -20.0, 3.0])
STD = np.array([6.0, 5e-4, 1.0, 6.0])
CORRELATION = np.eye(4)
CORRELATION[0, 3] = CORRELATION[3, 0] = -0.998
COVARIANCE = CORRELATION * np.outer(STD, STD)


def written(
    folder: Path,
    values: np.ndarray,
    *,
    rig: str | None,
    day: date,
    dataset: str | None = None,
    hour: str = "08:00:00+00:00",
    measurement: dict[str, object] | None = None,
) -> Path:
    """Write what history reads of a run; `dataset` is the digest, by default of a new one."""
    folder.mkdir(parents=True)
    document = {
        "format": 1,
        "dataset": {
            "name": "my-rig",
            "sha256": dataset or sha256(str(folder).encode()).hexdigest(),
        },
        "measurement": {
            "model": "axis-offset",
            "names": NAMES,
            "values": values.tolist(),
            "covariance": COVARIANCE.tolist(),
            "calibrated_depth_mm": [600, 1400],
            **(measurement or {}),
        },
    }
    if rig is not None:
        document["rig"] = {"serial": rig}
    (folder / "calibration.json").write_text(json.dumps(document))
    (folder / "run.toml").write_text(f'[run]\nfinished = "{day}T{hour}"\n')
    return folder


def fleet(top: Path, *, of: int, each: int, step: float = 0.0) -> Path:
    """Write sound rigs; `step` is added to delta2 from the seventh calibration on."""
    rng = np.random.default_rng(0)
    for i in range(of):
        for k in range(each):
            values = rng.multivariate_normal(TRUTH, COVARIANCE)
            values[1] += step * (k >= 6)
            day = date(2020, 1, 1) + timedelta(days=90 * k)
            written(top / f"{i:03d}-{k:02d}", values, rig=f"R{i:03d}", day=day)
    return top


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

    def scan_then_change(*given: object) -> object:
        found = scan(*given)  # type: ignore[arg-type]
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

    def reading(folder: Path) -> Entry:
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


def test_a_link_is_of_the_run_that_its_target_lies_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.history.scan.YOUNG_S", -3600.0)
    top, index = fleet(tmp_path / "runs", of=1, each=1), tmp_path / "i.sqlite"
    run = top / "000-00"
    begin_outputs(run, ALWAYS)
    for name in ("results.h5", "report.html"):
        (run / name).write_text("")
    end_outputs(run, "", ALWAYS)
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


def test_a_folder_whose_name_is_no_text_is_told_and_the_others_are_taken(tmp_path: Path) -> None:
    top = fleet(tmp_path / "runs", of=1, each=2)
    (top / "000-01").rename(top / os.fsdecode(b"caf\xe9"))
    found = update(tmp_path / "i.sqlite", [top])
    assert found.added == (str(top / "000-00"),)
    ((_, fault),) = found.unreadable
    assert "UTF-8" in fault


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


def test_charted_uncertainties_are_those_of_repeated_calibrations(tmp_path: Path) -> None:
    """300 calibrations of one rig: standard deviations are known to 4.1 %."""
    update(tmp_path / "i.sqlite", [fleet(tmp_path / "runs", of=1, each=300)])
    found = series(history(tmp_path / "i.sqlite", "R000"))
    assert len(found) == 6
    for s in found:
        assert np.std(s.values) == pytest.approx(np.median(s.std), rel=4 * 0.041), s.name


def test_a_step_of_the_zero_is_charted(tmp_path: Path) -> None:
    top = fleet(tmp_path / "runs", of=1, each=14, step=6 * STD[1])
    update(tmp_path / "i.sqlite", [top])
    rows = {row[0]: row for row in show(history(tmp_path / "i.sqlite", "R000"))[1:]}
    assert rows["delta2, rad"][4] == "ALARM 2021-06-24"
    assert "scatter exceeds" in rows["delta2, rad"][-1]
    assert "ALARM" not in "".join(rows["effective baseline, mm"])


def test_due_counts_from_the_repair(tmp_path: Path) -> None:
    update(tmp_path / "i.sqlite", [fleet(tmp_path / "runs", of=1, each=8, step=0.02)])
    entries = history(tmp_path / "i.sqlite", "R000")
    drifting = due(entries, tolerance_mm=60.0)
    kept = since(entries, date.fromisoformat(entries[6].date))
    assert kept == entries[6:]
    repaired = due(kept, tolerance_mm=60.0)
    with pytest.raises(InputError, match="since it was repaired"):
        since(entries, date(2030, 1, 1))
    assert drifting is not None
    assert repaired is not None
    assert drifting[1].interval < 90
    assert repaired[1].interval == 90
    assert due(entries[:1], tolerance_mm=60.0) is None


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    index = ["--index", str(tmp_path / "i.sqlite")]
    top = fleet(tmp_path / "runs", of=2, each=5)
    assert main(["history", "show", *index]) == 2
    assert "calib history index" in capsys.readouterr().err
    assert main(["history", "index", str(top), *index]) == 0
    assert "10 calibrations found" in capsys.readouterr().out
    assert main(["history", "show", *index]) == 0
    assert "R001" in capsys.readouterr().out
    assert main(["history", "show", "R001", *index]) == 0
    assert "depth at 1000 mm" in capsys.readouterr().out
    chart = tmp_path / "chart.svg"
    assert main(["history", "chart", "R001", "--out", str(chart), *index]) == 0
    first = chart.read_bytes()
    assert first.startswith(b"<svg")
    assert main(["history", "chart", "R001", "--out", str(chart), *index]) == 0
    assert chart.read_bytes() == first
    assert main(["history", "chart", "R001", "--out", str(chart), "--accepted", "5", *index]) == 2
    capsys.readouterr()
    assert main(["history", "due", "R001", "--tolerance", "40", *index]) == 0
    assert "ILAC-G24:2022" in capsys.readouterr().out
    assert main(["history", "due", "R7", "--tolerance", "40", *index]) == 2
    assert "no rig 'R7'" in capsys.readouterr().err
    (tmp_path / "i.sqlite").write_text("no database, but long enough to be looked at" * 9)
    assert main(["history", "show", *index]) == 2


def test_pages_lead_to_all_rigs_alarms_first(tmp_path: Path) -> None:
    fleet(tmp_path / "good", of=2, each=5)
    moved = fleet(tmp_path / "moved", of=3, each=12, step=5e-3)
    for folder in moved.glob("00[01]-*"):
        shutil.rmtree(folder)
    index = tmp_path / "h.sqlite"
    update(index, [tmp_path / "good", moved])
    out = tmp_path / "pages"
    command = ["history", "page", "--index", str(index), "--out", str(out), "--tolerance", "20"]
    assert main(command) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "R000.html", "R001.html", "R002.html", "index.html",
    ]  # fmt: skip
    text = (out / "index.html").read_text()
    assert text.index("R002.html") < text.index("R000.html")
    assert "delta2 (Shewhart" in text
    one = (out / "R002.html").read_text()
    assert "ALARM 2021-06-24" in one
    assert one.count("<svg") == 18
    assert "due on 2022-" in one
    assert "ALARM" not in (out / "R000.html").read_text()


@pytest.mark.parametrize(
    "serial", ["../../etc", "a/b", "index", "", ".", "a b", "\N{GREEK SMALL LETTER ALPHA}"]
)
def test_a_page_of_any_serial_stays_in_its_folder(serial: str) -> None:
    name = page_name(serial)
    assert Path(name).name == name
    assert not name.startswith((".", "index.html"))
    assert name != page_name(serial + "x")


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
    assert any("3 calibrations on 1 days" in note for note in notes(entries))


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


def test_no_serial_obeys_or_vanishes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    index = ["--index", str(tmp_path / "i.sqlite")]
    written(tmp_path / "runs" / "a", TRUTH, rig="\x1b[31mred\n", day=date(2021, 1, 1))
    update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    assert main(["history", "show", *index]) == 0
    assert main(["history", "show", "\x1b[31mred\n", *index]) == 0
    assert "\x1b" not in capsys.readouterr().out
    out = tmp_path / "pages"
    assert main(["history", "page", "--rig", "nobody", "--out", str(out), *index]) == 2
    assert "no rig 'nobody'" in capsys.readouterr().err
    assert not out.exists()


def test_a_date_far_ahead_is_told(tmp_path: Path) -> None:
    for year in (1, 5000, 9999):
        written(tmp_path / "runs" / str(year), TRUTH, rig="R", day=date(year, 12, 31))
    update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    entries = history(tmp_path / "i.sqlite", "R")
    assert any("in the future" in note for note in notes(entries))
    found = due(entries, tolerance_mm=1e6)
    assert found is not None
    assert found[0] == date.max


def test_charted_depths_are_those_of_the_jacobian(tmp_path: Path) -> None:
    """Values and uncertainties of many calibrations at once against one by one."""
    update(tmp_path / "i.sqlite", [fleet(tmp_path / "runs", of=1, each=5)])
    entries = history(tmp_path / "i.sqlite", "R000")
    z = np.linspace(*entries[0].range_mm, 3)
    theta = [vector(dict(zip(e.names, e.values.tolist(), strict=True))) for e in entries]
    gaze = gaze_at(theta[0], np.column_stack([np.zeros((3, 2)), z]))
    for k, s in enumerate(series(entries)[-3:]):
        for i, e in enumerate(entries):
            exact = depth_jacobian(theta[i], gaze)
            slope = exact.by_theta[k, [INDEX[name] for name in e.names]]
            assert s.values[i] == pytest.approx(exact.z[k], rel=1e-12)
            assert s.std[i] == pytest.approx(np.sqrt(slope @ e.covariance @ slope), rel=1e-5)
