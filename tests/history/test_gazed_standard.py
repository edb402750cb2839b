"""A check standard gazed at by the virtual rig. Evidence: simulated truth, behind the protocols."""

from __future__ import annotations

import json
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest

from calib.cli.main import main
from calib.core.errors import InputError, UsageError
from calib.gaze.measured import positions
from calib.gaze.row import GazeRow
from calib.geometry.parameters import INDEX, MODELS
from calib.history.certified import Standard
from calib.history.gazed import gaze_standard, targets_of, with_session
from calib.history.standard import check_standard
from calib.history.standard_text import alarm, findings
from calib.rig.devices import RigDevices
from calib.rig.protocols import Refused
from calib.rig.virtual.operator import Operator
from tests.gaze.true_instrument import aiming, gazer, measuring
from tests.instrument.test_python_rig import document
from tests.rig.checked_rig import CHECK, RIG
from tests.rig.virtual_rigs import virtual_rig

U_LOAD_DEG = 0.009 / np.sqrt(12)
CORNERS = {"left": "corner:0,0", "right": "corner:8,5"}


def board_standard(rig: RigDevices) -> Standard:
    """Return the board that stands before a rig, with true length and depth, as a standard."""
    assert rig.world is not None
    length = rig.world.board.square_mm * float(np.hypot(8, 5))
    depth = float(rig.world.target(rig.clock.now_ns())[2])
    return Standard.model_validate(
        {
            "format": 1, "serial": "board-1", "targets": CORNERS,
            "length": [{"between": ["left", "right"], "length_mm": length, "u_mm": 0.01}],
            "depth": [{"target": "board", "z_mm": depth, "u_mm": 0.01}],
        }
    )  # fmt: skip


def sessions(rig: RigDevices, standard: Standard, count: int, *, of: str = "") -> str:
    """Gaze so many times, a day apart in name, and return the table."""
    assert rig.world is not None
    targets = targets_of(standard, rig.world.board)
    done = of.count("left")
    for k in range(done, done + count):
        rows = gaze_standard(gazer(rig), aiming(rig), targets)
        day = (date(2026, 1, 1) + timedelta(days=k)).isoformat()
        of = with_session(of, rows, date=day, name="t")
    return of


def test_a_rig_watches_itself_and_names_what_slipped() -> None:
    with virtual_rig(seed=3) as rig:
        assert rig.world is not None
        Operator(rig.world).show_gaze()
        standard = board_standard(rig)
        instrument = measuring(rig, u_alpha2_deg=U_LOAD_DEG)
        table = sessions(rig, standard, 6)
        checked = check_standard(instrument, standard, table, name="t")
        assert np.abs(checked.normalised).max() < 1.5
        assert alarm(checked, accepted=4) is None
        # The encoder sits elsewhere on the axis: C2 stands 0.05 deg from where it is read.
        was, slip = rig.world._yaw, np.deg2rad(0.05)
        rig.world.turn_by(lambda moment: was(moment) + slip)
        table = sessions(rig, standard, 2, of=table)
        checked = check_standard(instrument, standard, table, name="t")
    assert checked.dates[-1] == "2026-01-08"
    assert alarm(checked, accepted=4) == 6
    said = findings(checked, accepted=4)
    assert "since 2026-01-07" in said[0]
    assert "the encoder's zero has slipped, by " in said[1]
    size = float(said[1].split("zero has slipped, by ")[1].split()[0])
    assert size == pytest.approx(0.05, rel=0.2)


def test_rows_in_the_table_are_worth_what_they_were_when_gazed() -> None:
    """Against `positions` of the rows themselves, the same but for the rounding of the table."""
    with virtual_rig(seed=3) as rig:
        assert rig.world is not None
        Operator(rig.world).show_gaze()
        standard = board_standard(rig)
        instrument = measuring(rig, u_alpha2_deg=U_LOAD_DEG)
        rows = gaze_standard(gazer(rig), aiming(rig), targets_of(standard, rig.world.board))
    table = with_session("", rows, date="2026-01-01", name="t")
    checked = check_standard(instrument, standard, table, name="t")
    found = positions(instrument, list(rows.values()), model="selected")
    assert list(rows) == ["left", "right", "board"]
    length, u = found.length(0, 1)
    assert checked.values[0] == pytest.approx([length, found.position_mm[2, 2]], rel=1e-7)
    assert checked.std[0] == pytest.approx([u, found.std_mm[2, 2]], rel=2e-3)
    # Without what the pictures said of themselves the usual uncertainty of tables counts.
    plain = "\n".join(",".join(line.split(",")[:6]) for line in table.splitlines())
    usual = check_standard(instrument, standard, plain, name="t")
    assert np.all(usual.std[0] > 1.5 * checked.std[0])


def test_a_standard_that_moved_makes_no_session() -> None:
    with virtual_rig(seed=3) as rig:
        assert rig.world is not None
        Operator(rig.world).show_gaze()
        standard = board_standard(rig)
        begun = rig.clock.now_ns()
        targets = targets_of(standard, rig.world.board)
        gaze_standard(gazer(rig), aiming(rig), targets)
        took = rig.clock.now_ns() - begun
        pose = rig.world.pose(rig.clock.now_ns())
        assert pose is not None
        moved = pose.copy()
        moved[:3, 3] += [4.0, 0.0, 0.0]
        rig.world.follow(lambda _: moved, since_ns=rig.clock.now_ns() + took // 2)
        with pytest.raises(Refused, match="moved"):
            gaze_standard(gazer(rig), aiming(rig), targets)


HAND = (
    "\ufeff id ,date,x1c,y1c,alpha2_deg\n"
    "left,2026-01-01,0.1,0.2,90\n\nright,2026-01-01,0.2,0.2,95\n"
)


def test_rows_of_the_user_stay_as_they_are() -> None:
    with virtual_rig(seed=3) as rig:
        assert rig.world is not None
        Operator(rig.world).show_gaze()
        targets = targets_of(board_standard(rig), rig.world.board)
        rows: dict[str, GazeRow] = gaze_standard(gazer(rig), aiming(rig), targets)
    lines = with_session(HAND, rows, date="2026-01-02", name="t").splitlines()
    assert lines[0] == "id,date,x1c,y1c,alpha2_deg,u1_px,v1_px,u2_px,u_c1_px,u_c2_px,v2_px"
    assert lines[1] == "left,2026-01-01,0.1,0.2,90,,,,,,"
    assert lines[3].startswith("left,2026-01-02,,,")
    assert len(lines) == 3 + len(rows)
    again = with_session("\n".join(lines), rows, date="2026-01-03", name="t").splitlines()
    assert again[: len(lines)] == lines
    with pytest.raises(InputError, match="is no table"):
        with_session("date,id\n" + "x" * 200_000, rows, date="2026-01-02", name="t")


def test_targets_that_are_none_are_refused() -> None:
    standard = Standard.model_validate(
        {"format": 1, "serial": "s", "depth": [{"target": "A", "z_mm": 1, "u_mm": 0}]}
    )
    with pytest.raises(UsageError, match="A: is no target"):
        targets_of(standard, None)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a rig that was checked, its true calibration, and a standard."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    with virtual_rig(seed=1) as rig:
        assert rig.world is not None
        true = rig.world.rig
    names = MODELS[true.model].free
    content = document()
    content["measurement"] |= {
        "model": true.model, "names": list(names),
        "values": [float(true.theta[INDEX[name]]) for name in names],
        "covariance": np.diag(np.full(len(names), 1e-12)).tolist(),
        "calibrated_depth_mm": list(true.depth_range_mm),
    }  # fmt: skip
    content["intrinsics"] = {
        role: {
            "matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist(),
            "image_size": list(camera.image_size),
        }
        for role, camera in (("c1", true.c1), ("c2", true.c2))
    }  # fmt: skip
    (tmp_path / "c.json").write_text(json.dumps(content))
    standard = (
        'format = 1\nserial = "board-1"\n[targets]\nleft = "corner:0,0"\nright = "corner:8,5"\n'
        '[[length]]\nbetween = ["left", "right"]\nlength_mm = 471.699\nu_mm = 0.01\n'
    )
    (tmp_path / "s.toml").write_text(standard)
    return tmp_path


def test_command_adds_a_session(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["history", "check", "c.json", "s.toml", "mornings.csv", "--rig", "rig.toml"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "session of" in said.err
    assert "Check standard board-1: 1 sessions" in said.out
    before = (lab / "mornings.csv").read_text()
    assert before.count("\n") == 3
    (lab / "other.csv").write_text("date,id,colour\n")
    assert main([*command[:4], "other.csv", *command[5:]]) == 2
    assert "unknown column 'colour'" in capsys.readouterr().err
    assert (lab / "other.csv").read_text() == "date,id,colour\n"
    assert main([*command[:4], "nowhere/t.csv", *command[5:]]) == 2
    assert "nowhere: is not a folder" in capsys.readouterr().err
    # What cannot be used is told before the rig moves, and stays as it is.
    (lab / "mornings.csv").write_text(before.replace("left", "Left"))
    assert main(command) == 2
    assert "left is not read" in capsys.readouterr().err
    (lab / "mornings.csv").write_text(before)
    (lab / "s.toml").write_text((lab / "s.toml").read_text().replace("8,5", "80,5"))
    assert main(command) == 2
    assert "columns 0 to" in capsys.readouterr().err
    (lab / "s.toml").write_text((lab / "s.toml").read_text().replace("corner:80,5", "cross"))
    assert main(command) == 3
    assert "does not see the target cross" in capsys.readouterr().err
    assert (lab / "mornings.csv").read_text() == before
    assert [path.name for path in lab.glob(".*")] == []
