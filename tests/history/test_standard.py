"""The check standard. Evidence: simulated rigs that change in a known way, repeated simulation."""

from __future__ import annotations

import csv
import io
import re
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest

from calib.cli.main import main
from calib.core.errors import InputError
from calib.geometry.parameters import vector
from calib.geometry.plane import gaze_at
from calib.history.causes import CAUSES
from calib.history.certified import CertifiedDepth, CertifiedLength, Standard
from calib.history.read_standard import read_standard
from calib.history.standard import check_standard
from calib.history.standard_text import alarm, findings, notes
from calib.instrument.calibration_file import Measuring, read_calibration
from tests.instrument.test_python_rig import NAMES, U_ALPHA, U_X, VALUES, file

__all__ = ["file"]

TARGETS = {
    "A": np.array([-150.0, 20.0, 700.0]),
    "B": np.array([180.0, -30.0, 760.0]),
    "C": np.array([-200.0, 60.0, 1350.0]),
    "D": np.array([240.0, 0.0, 1400.0]),
}
TRUTH = dict(zip(NAMES, VALUES.tolist(), strict=True))


def standard() -> Standard:
    def distance(a: str, b: str) -> float:
        return float(np.linalg.norm(TARGETS[a] - TARGETS[b]))

    return Standard(
        format=1,
        serial="bar-3",
        length=(
            CertifiedLength(between=("A", "B"), length_mm=distance("A", "B"), u_mm=0.02),
            CertifiedLength(between=("C", "D"), length_mm=distance("C", "D"), u_mm=0.02),
        ),
        depth=tuple(
            CertifiedDepth(target=n, z_mm=TARGETS[n][2], u_mm=0.05) for n in ("A", "B", "C", "D")
        ),
    )


def readings(
    rng: np.random.Generator,
    days: int,
    *,
    since: int = 10**6,
    change: dict[str, float] | None = None,
    lens: float = 0.0,
) -> str:
    """Return a table: from day `since` on the rig has other parameters, or another focal length."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["date", "id", "x1c", "y1c", "alpha2_deg"])
    for day in range(days):
        changed = day >= since
        rig = TRUTH | ({n: TRUTH[n] + by for n, by in (change or {}).items()} if changed else {})
        gaze = gaze_at(vector(rig), np.stack(list(TARGETS.values())))
        for k, name in enumerate(TARGETS):
            scale = 1 + lens * changed
            x, y = gaze.x1c[k] * scale + U_X * rng.standard_normal(), gaze.y1c[k] * scale
            reading = np.rad2deg(gaze.alpha2[k] + U_ALPHA * rng.standard_normal())
            writer.writerow([date(2020, 1, 1) + timedelta(days=day), name, x, y, reading])
    return text.getvalue()


@pytest.fixture
def measuring(file: Path) -> Measuring:
    return read_calibration(file)


def test_an_unchanged_rig_agrees_and_is_in_control(measuring: Measuring) -> None:
    """On one day each of 18 charts is outside by chance once in 370: of 60 records up to 3 are."""
    rng = np.random.default_rng(1)
    alarms, squares = 0, []
    for _ in range(60):
        checked = check_standard(measuring, standard(), readings(rng, 25), name="t")
        alarms += alarm(checked, accepted=5) is not None
        first = checked.values - checked.certified
        std = np.sqrt(np.diagonal(checked.readings, axis1=1, axis2=2))
        squares.append(np.mean((first / std) ** 2))
    # The calibration is true here: deviations are those of the readings alone.
    assert np.mean(squares) == pytest.approx(1.0, abs=5 / np.sqrt(60 * 25))
    assert alarms <= 9


PLANTED = [
    ({"delta2_rad": 6e-4}, 0.0, 0),
    ({"baseline_mm": 1.5}, 0.0, 1),
    ({"axis_z_mm": 40.0}, 0.0, 2),
    (None, 0.01, 3),
]


@pytest.mark.parametrize(("change", "lens", "which"), PLANTED)
def test_a_change_is_found_and_its_cause_named(
    measuring: Measuring, change: dict[str, float] | None, lens: float, which: int
) -> None:
    rng = np.random.default_rng(which)
    text = readings(rng, 30, since=15, change=change, lens=lens)
    checked = check_standard(measuring, standard(), text, name="t")
    at = alarm(checked, accepted=10)
    assert at is not None
    assert 15 <= at <= 22
    said = findings(checked, accepted=10)
    assert "the rig has changed" in said[0]
    assert f"since 2020-01-{at + 1:02d}" in said[0]
    assert said[1].startswith("likely cause")
    assert CAUSES[which].name in said[1]
    size = float(said[1].split(CAUSES[which].name + ", by ")[1].split()[0])
    planted = [np.rad2deg(6e-4), 100 * 1.5 / 120, 40.0, 1.0][which]
    assert size == pytest.approx(planted, rel=0.15)


def test_one_depth_tells_a_change_and_no_cause(measuring: Measuring) -> None:
    one = Standard(format=1, serial="s", depth=standard().depth[:1])
    text = readings(np.random.default_rng(0), 30, since=15, lens=0.01)
    said = findings(check_standard(measuring, one, text, name="t"), accepted=10)
    assert "one quantity does not tell the cause" in said[1]


STANDARD = """\
format = 1
serial = "bar-3"
[[length]]
between = ["A", "B"]
length_mm = 338.96
u_mm = 0.02
[[depth]]
target = "C"
z_mm = 1350
u_mm = 0.1
"""


def test_command(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    (tmp_path / "s.toml").write_text(STANDARD)
    table, page = tmp_path / "r.csv", tmp_path / "check.html"
    table.write_text(readings(np.random.default_rng(3), 8))
    command = ["history", "check", str(file), str(tmp_path / "s.toml"), str(table)]
    assert main([*command, "--out", str(page)]) == 0
    out = capsys.readouterr().out
    assert "Check standard bar-3: 8 sessions, 2020-01-01 to 2020-01-08" in out
    assert "ALARM" not in out
    assert "in control" in page.read_text()
    assert page.read_text().count("<svg") == 6
    few = tmp_path / "few.csv"
    few.write_text(readings(np.random.default_rng(3), 2))
    assert main([*command[:-1], str(few), "--out", str(page)]) == 0
    assert "no chart yet" in page.read_text()
    assert "in control" not in page.read_text()
    capsys.readouterr()
    table.write_text(readings(np.random.default_rng(3), 12, since=8, change={"delta2_rad": 2e-3}))
    assert main([*command, "--out", str(page)]) == 3
    assert "the encoder's zero has slipped" in capsys.readouterr().out
    assert "ALARM 2020-01-09" in page.read_text()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("2020-01-02,A", "2020-13-02,A"), "line 6, column date"),
        (("2020-01-02,A", "2020-01-02T08:00+01:00,A"), "local time"),
        (("2020-01-02,A", "2020-01-02,E"), "A is not read"),
        (("2020-01-02,A", "2020-01-02,B"), "B is read twice|A is not read|twice"),
        (("date,", "day,"), "no column date"),
        (("2020-01-02,B", "20200102T0000,A"), "A is read twice at 2020-01-02"),
        (("2020-01-02,A", f"2020-01-02,{'A' * 200_000}"), "is no table"),
    ],
)
def test_bad_tables_are_refused_by_place(
    measuring: Measuring, change: tuple[str, str], told: str
) -> None:
    text = readings(np.random.default_rng(0), 3).replace(*change, 1)
    with pytest.raises(InputError, match=told):
        check_standard(measuring, standard(), text, name="r.csv")


def test_a_time_after_a_blank_is_a_time(measuring: Measuring) -> None:
    text = readings(np.random.default_rng(0), 3).replace("2020-01-02,", "2020-01-02 08:00,")
    assert check_standard(measuring, standard(), text, name="r.csv").dates == (
        "2020-01-01", "2020-01-02T08:00:00", "2020-01-03",
    )  # fmt: skip


def test_two_targets_at_one_place_are_refused(measuring: Measuring) -> None:
    """A length of 0 has no u, and charts of nan never alarm."""
    rows = readings(np.random.default_rng(0), 3).splitlines()
    rows[2] = rows[1].replace(",A,", ",B,")
    with pytest.raises(InputError, match="2020-01-01: A and B have the same readings"):
        check_standard(measuring, standard(), "\n".join(rows), name="r.csv")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("338.96", "-1"), "length.0.length_mm"),
        (('"B"]', '"A"]'), "has one end"),
        (("format = 1", "format = 2"), "format"),
        (("u_mm = 0.1", "u_mm = nan"), "u_mm"),
        (("serial", "serials"), "serial"),
        (("[[length]]", "[[length"), "is no TOML"),
        (("[[length]]", '[targets]\nE = "blob"\n[[length]]'), "E is in no length"),
    ],
)
def test_bad_standards_are_refused(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    path = tmp_path / "s.toml"
    path.write_text(STANDARD.replace(*change))
    with pytest.raises(InputError, match=told):
        read_standard(path)


@pytest.mark.parametrize(
    ("u", "told"),
    [("0", "no uncertainty"), ("-1", "no uncertainty"), ("x", "no uncertainty"),
     ("0.1", "without u1_px")],
)  # fmt: skip
def test_uncertainties_of_pixels_that_are_none_are_refused(
    measuring: Measuring, u: str, told: str
) -> None:
    lines = readings(np.random.default_rng(0), 3).splitlines()
    text = "\n".join([lines[0] + ",u_c1_px", lines[1] + f",{u}", *(one + "," for one in lines[2:])])
    with pytest.raises(InputError, match=rf"r\.csv, line 2: u_c1_px .*{told}"):
        check_standard(measuring, standard(), text, name="r.csv")


def test_a_year_of_mornings(measuring: Measuring) -> None:
    """Chance puts a chart outside now and then; that hides no change, nor is it taken for one."""
    rng = np.random.default_rng(3)
    sound = check_standard(measuring, standard(), readings(rng, 365), name="t")
    assert alarm(sound, accepted=10) is None
    assert findings(sound, accepted=10) == []
    (note,) = notes(sound, accepted=10)
    times, expected = (int(number) for number in re.findall(r"\d+", note))
    assert 1 <= times <= 2 * expected
    text = readings(np.random.default_rng(3), 365, since=350, change={"delta2_rad": 6e-4})
    changed = check_standard(measuring, standard(), text, name="t")
    assert alarm(changed, accepted=10) in (350, 351, 352)
    assert findings(changed, accepted=10)[1].startswith("likely cause: the encoder's zero")


def test_a_knock_that_was_undone_is_an_alarm(measuring: Measuring) -> None:
    """One morning far off, and all well since."""
    lines = readings(np.random.default_rng(5), 60).splitlines()
    other = readings(
        np.random.default_rng(5), 60, since=0, change={"delta2_rad": 2e-3}
    ).splitlines()
    day = slice(1 + 4 * 30, 1 + 4 * 31)
    lines[day] = other[day]
    checked = check_standard(measuring, standard(), "\n".join(lines), name="t")
    said = findings(checked, accepted=10)
    assert any("2020-01-31 a deviation was larger than chance" in one for one in said)


def test_a_certificate_in_another_unit_and_a_date_to_come_are_named(measuring: Measuring) -> None:
    text = readings(np.random.default_rng(3), 2)
    for unit, factor in (("cm", 10.0), ("inches", 25.4), ("mm", 1.0), ("nothing", 12.0)):
        made = standard().model_dump(by_alias=True)
        for kind, key in (("length", "length_mm"), ("depth", "z_mm")):
            for one in made[kind]:
                one[key] /= factor
        checked = check_standard(measuring, Standard(**made), text, name="t")
        said = " ".join(findings(checked, accepted=5))
        assert ("differs from the certificate" in said) == (unit != "mm")
        assert ("seem to be in" in said) == (unit in ("cm", "inches"))
        assert unit not in ("cm", "inches") or f"in {unit}: write them in mm" in said
    ahead = check_standard(measuring, standard(), text.replace("2020-", "9020-"), name="t")
    assert any("in the future" in note for note in notes(ahead, accepted=5))
