"""The journal of a study. Evidence: properties under damage and competition."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib.core.errors import UsageError
from calib.study.journal import open_journal


def record(number: int) -> dict[str, object]:
    return {"key": "k", "number": number, "value": 0.1 * number}


def test_half_a_line_is_dropped_and_the_rest_kept(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "rigs.jsonl"
    with open_journal(path) as journal:
        journal.add(record(0))
        journal.add(record(1))
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"key":"k","number":2,"val')
    with open_journal(path) as journal:
        assert sorted(journal.records()) == [("k", 0), ("k", 1)]
        journal.add(record(2))
        assert journal.records()["k", 2]["value"] == pytest.approx(0.2)
    assert [json.loads(line)["number"] for line in path.read_text().splitlines()] == [0, 1, 2]


def test_lines_of_something_else_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "rigs.jsonl"
    path.write_text('nonsense\n[1, 2]\n{"key": "k"}\n' + json.dumps(record(7)) + "\n")
    with open_journal(path) as journal:
        assert list(journal.records()) == [("k", 7)]
    assert path.read_text().startswith("nonsense\n")


def test_one_study_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "rigs.jsonl"
    with (
        open_journal(path),
        pytest.raises(UsageError, match="another study"),
        open_journal(path),
    ):
        pass
    with open_journal(path):
        pass


def test_a_place_that_takes_no_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="--out"), open_journal(tmp_path / "file" / "rigs.jsonl"):
        pass
