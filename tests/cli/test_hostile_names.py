"""Names that would act on a terminal, a spreadsheet or a reader are told or made harmless."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command import GOOD, call, dataset
from given_calibration import calibration

from calib.core.errors import UsageError, harmless
from calib.dataset.messages import name_fault

HOSTILE = "a\x1b[31mb\x1b]0;title\x07\u202ec"


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "{}"),
        ("check", "{}/none"),
        ("calibrate", "{}", "--out", "{}/inside"),
        ("verify", "{}"),
        ("compare", "{}", "{}"),
        ("measure", "{}/none.json", "{}/gaze.csv"),
        ("measure", "{}/gaze.csv", "{}/gaze.csv"),
        ("simulate", "{}", "--seed", "1"),
        ("simulate", "{}/new", "--seed", "1"),
        ("history", "index", "{}"),
        ("study", "--out", "{}"),
        ("{}",),
        ("check", "--{}"),
        ("measure", "a", "b", "--x{}"),
        ("export", "{}", "--format", "ros", "--out", "{}/e"),
        ("gaze", "{}/none.json"),
        ("length", "{}/none.json"),
    ],
    ids=lambda a: " ".join(a[:2]) if isinstance(a, tuple) else str(a),
)
def test_no_escape_sequence_reaches_the_terminal(
    arguments: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    dataset(Path(HOSTILE), GOOD)
    ended = call(capsys, *(a.replace("{}", HOSTILE) for a in arguments))
    said = ended.out + ended.err
    assert said
    assert all(c.isprintable() or c == "\n" for c in said), repr(said)
    assert ended.status in (0, 2)


def test_errors_escape_what_a_terminal_obeys() -> None:
    assert str(UsageError(f"{HOSTILE}\nnext")) == ("a\\x1b[31mb\\x1b]0;title\\x07\\u202ec\nnext")
    assert harmless("Stück 1 測") == "Stück 1 測"


INVISIBLE = (
    "\u115f", "\u3164", "\u2800", "a\U000e0041", "a\u034fb", "\u17b4", "\uffa0", "a\ufff9",
)  # fmt: skip


@pytest.mark.parametrize("name", INVISIBLE)
def test_what_does_not_show_is_no_name(name: str) -> None:
    assert name_fault(name) == f"holds the invisible character U+{ord(name.strip('ab')):04X}"


def test_ids_that_act_come_out_harmless(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Property: no two ids become one, and a program gets back what it gave."""
    ids = ["=1", "'=1", "''=1", "-3", "plain", "'plain", "@a"]
    (tmp_path / "c.json").write_text(json.dumps(calibration()))
    table = tmp_path / "t.csv"
    rows = [*(f"{name},0.05,0.1,87" for name in ids), '"a\x1b[31m",0.05,0.1,87']
    table.write_text("\n".join(["id,x1c,y1c,alpha2_deg", *rows]) + "\n")
    ended = call(capsys, "measure", tmp_path / "c.json", table)
    assert ended.status == 3
    said = ended.out + ended.err
    assert all(c.isprintable() or c == "\n" for c in said), repr(said)
    cells = [line.partition(",")[0] for line in ended.out.splitlines()[1:]]
    assert cells[:-1] == ["'=1", "''=1", "'''=1", "-3", "plain", "'plain", "'@a"]
    ended = call(capsys, "measure", tmp_path / "c.json", table, "--json")
    assert [json.loads(line)["id"] for line in ended.out.splitlines()][:-1] == ids


@pytest.mark.parametrize("name", ["=1+1", "@SUM(A1)", "+A1", "-1+cmd|' /C calc'!A0", "-(2)"])
def test_formulas_are_no_names(name: str) -> None:
    assert name_fault(name) == "would be a formula in a spreadsheet"


@pytest.mark.parametrize("name", ["-3", "+0.5", "-", "2-5", "-10mm", "a=b"])
def test_signed_numbers_are_names(name: str) -> None:
    assert name_fault(name) is None
