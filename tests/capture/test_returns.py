"""Returns to the first target: a zero that moves while rows are captured is found and named.

Evidence: property of the charts, simulated truth of a whole capture.
"""

from __future__ import annotations

import csv
import json
import math
import tomllib

import numpy as np
import pytest

from calib.capture.returns import first_row
from calib.capture.writer import growing
from calib.checks.returns import returns_gates
from calib.cli.main import main
from calib.dataset.load import load_dataset
from calib.dataset.tables import ReturnTable
from calib.instrument.returns import control_words
from calib.uncertainty.control import Returns, control, lost_full_steps
from tests.rig.checked_rig import CHECK, RIG

U = 1e-4


def returns(*in_u, full_step_rad=None):
    changes = U * np.array(in_u)
    return Returns(changes, np.full(len(changes), U), U, full_step_rad)


@pytest.mark.parametrize(
    ("in_u", "cause"),
    [
        ((0.5, -1.0, 0.3), None),
        ((1.5, 3.0, 4.5, 6.0, 7.5), "drift"),
        ((0.1, -0.2, 0.1, 9.0), "jump"),
        ((6.0,), "change"),
    ],
)
def test_drift_and_jump_are_named_where_the_returns_tell_them(in_u, cause):
    assert control(returns(*in_u)).cause == cause


def test_lost_steps_are_named_by_the_full_step():
    full = math.radians(0.9)
    lost = returns(0.2, 4 * full / U + 0.5, full_step_rad=full)
    assert control(lost).cause == "lost steps"
    assert lost_full_steps(lost) == 4
    assert control(returns(0.2, 4 * full / U + 60, full_step_rad=full)).cause == "jump"


def test_sound_zeros_are_called_moved_as_rarely_as_the_limits_say():
    """Six returns, 60 rows: of 4,000 sound captures each chart stops about 1 in 60."""
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(4000):
        first = rng.standard_normal()
        found = control(returns(*(rng.standard_normal(6) - first)))
        alarms += found.first_alarm is not None
    # Single returns share the first row's error and are outside in up to 1.6 %, the average in 1.7.
    assert 0.01 < alarms / 4000 < 0.035


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig-check.json").write_text(json.dumps(CHECK))
    return tmp_path


def captured(lab, rig, count):
    (lab / "rig.toml").write_text(rig)
    return main(
        ["capture", "gaze", "mine", "--rig", "rig.toml", "--count", str(count), "--returns", "2"]
    )


def test_a_capture_returns_and_stops_where_the_zero_has_moved(lab, capsys):
    assert captured(lab, RIG, 2) == 0
    assert "r01: g01 again after g02" in capsys.readouterr().err
    assert captured(lab, RIG + "drift_deg_h = 60.0\n", 6) == 3
    said = capsys.readouterr().err
    assert "r02: g01 again after g04" in said
    assert "the rows after g02 up to g04 have other zeros than those before" in said
    with (lab / "mine" / "returns.csv").open() as file:
        table = list(csv.DictReader(file))
    sound, moved = (float(row["change_deg"]) for row in table)
    assert abs(sound) < 3 * float(table[0]["u_change_deg"])
    # The true change: 60 deg an hour over the simulated time between rows and return.
    assert -0.3 < moved < -0.02
    dataset = load_dataset(lab / "mine", rows_to_come=True)
    assert len(dataset.returns) == 2
    assert {f"returns/{c}/r01.png" for c in ("c1", "c2")} <= {
        str(path.relative_to(lab / "mine")) for path in (lab / "mine").rglob("*.png")
    }
    (gate,) = returns_gates(dataset)
    assert gate.name == "returns"
    assert not gate.passed
    assert "g02" in gate.detail
    assert tomllib.loads((lab / "mine" / "dataset.toml").read_text())["returns"] == {
        "table": "returns.csv"
    }


def test_captures_without_returns_have_no_gate(lab):
    (lab / "rig.toml").write_text(RIG)
    assert main(["capture", "gaze", "mine", "--rig", "rig.toml", "--count", "1"]) == 0
    assert returns_gates(load_dataset(lab / "mine", rows_to_come=True)) == ()


def test_returns_are_to_the_first_row_of_the_same_target(tmp_path):
    """Property: another target stands elsewhere, and a damaged journal gives no row."""
    where = {
        "depth_mm": 1500.0, "standstill": {"reading_deg": 80.0}, "pixel_c1": [1.0, 2.0],
        "pixel_c2": [3.0, 4.0], "u_c1_px": 0.02, "u_c2_px": 0.02,
    }  # fmt: skip
    with growing(tmp_path / "mine") as folder:
        folder.note("start", target="board")
        folder.note("row", id="g01", **where | {"standstill": "spoilt"})
        folder.note("row", id="g02", **where)
        folder.note("start", target="cross")
        folder.note("row", id="g03", **where)
        assert first_row(folder, target="board").name == "g02"
        assert first_row(folder, target="cross").name == "g03"
        assert first_row(folder, target="blob") is None


def test_of_a_zero_that_jumped_and_came_back_the_jump_is_told():
    change = np.radians([0.0001, 0.4637, -0.0009])
    u, names = np.full(3, np.radians(0.003)), ("r01", "r02", "r03")
    table = ReturnTable(
        "returns.csv", (2, 3, 4), names, ("g01",) * 3, ("g04", "g08", "g08"), change, u, u
    )
    assert "by +0.4637 deg" in control_words(table, None)
