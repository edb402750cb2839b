"""What is charted and shown of the index. Evidence: simulated rigs, central differences."""

from __future__ import annotations

import shutil
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from calib.cli.main import main
from calib.core.errors import InputError
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import gaze_at
from calib.history.index import history, update
from calib.history.page import page_name
from calib.history.quantities import series
from calib.history.summary import due, notes, show, since
from tests.history.fleet import STD, TRUTH, fleet, written


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


def test_repairs_count_on_the_page_of_all_rigs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of three rigs in alarm one was repaired when its zero moved, one is not calibrated since."""
    index = tmp_path / "h.sqlite"
    update(index, [fleet(tmp_path / "runs", of=3, each=12, step=5e-3)])
    moved = history(index, "R000")[6].date
    repairs, out = tmp_path / "repairs.csv", tmp_path / "pages"
    command = ["history", "page", "--index", str(index), "--out", str(out), "--tolerance", "20"]
    command += ["--repairs", str(repairs)]
    repairs.write_text(f"date,rig,note\n2020-01-02,R000,\n{moved},R000,belt\n2025-01-01,R001,\n")
    assert main(command) == 0
    text = (out / "index.html").read_text()
    order = [text.index(f"R{number:03d}.html") for number in (2, 1, 0)]
    assert order == sorted(order)
    assert "Not calibrated since its repair on 2025-01-01" in text
    assert text.count("in control") == 1
    assert text.count("overdue 20") == 2
    assert "All charts are in control" in (out / "R000.html").read_text()
    assert "what follows is of before" in (out / "R001.html").read_text()
    assert "Next calibration" not in (out / "R001.html").read_text()
    repairs.write_text("date,rig\n2020-01-02,R0\nlately,R001\n")
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "repairs.csv:2: no rig 'R0'" in said
    assert "repairs.csv:3: 'lately'" in said
    repairs.write_text("when,rig\n")
    assert main(command) == 2
    assert "no column date" in capsys.readouterr().err


@pytest.mark.parametrize(
    "serial", ["../../etc", "a/b", "index", "", ".", "a b", "\N{GREEK SMALL LETTER ALPHA}"]
)
def test_a_page_of_any_serial_stays_in_its_folder(serial: str) -> None:
    name = page_name(serial)
    assert Path(name).name == name
    assert not name.startswith((".", "index.html"))
    assert name != page_name(serial + "x")


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


def test_a_date_far_ahead_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for year in (1, 5000, 9999):
        written(tmp_path / "runs" / str(year), TRUTH, rig="R", day=date(year, 12, 31))
    update(tmp_path / "i.sqlite", [tmp_path / "runs"])
    entries = history(tmp_path / "i.sqlite", "R")
    assert any("in the future" in note for note in notes(entries))
    command = ["history", "due", "R", "--tolerance", "1e6", "--index", str(tmp_path / "i.sqlite")]
    assert main(command) == 0
    assert "in the future" in capsys.readouterr().out
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
