"""The growing folder. Evidence: property."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from calib.capture.rows import next_name
from calib.capture.writer import growing
from calib.core.errors import InputError, UsageError


def test_what_a_killed_capture_left_is_cleared_and_its_journal_ended(tmp_path):
    with growing(tmp_path / "mine") as folder:
        folder.note("row", id="g01")
        folder.picture("gaze/c1/g01.png", np.zeros((4, 6), np.uint8))
    journal = tmp_path / "mine" / "session.jsonl"
    journal.write_text(journal.read_text() + '{"event": "ro')
    left = tmp_path / "mine" / "gaze" / "c1" / ".g02.png.0123456789abcdef.part"
    left.write_bytes(b"half")
    with growing(tmp_path / "mine") as folder:
        assert not left.exists()
        folder.note("row", id="g02")
        assert [entry["id"] for entry in folder.events("row")] == ["g01", "g02"]
    assert all(json.loads(line) for line in journal.read_text().splitlines())


def test_a_journal_of_one_torn_line_is_emptied(tmp_path):
    with growing(tmp_path / "mine"):
        (tmp_path / "mine" / "session.jsonl").write_text('{"event"')
    with growing(tmp_path / "mine") as folder:
        assert folder.events("row") == []
        folder.note("start")
    assert (tmp_path / "mine" / "session.jsonl").read_text() == '{"event": "start"}\n'


def test_rows_of_other_columns_and_a_second_capture_are_refused(tmp_path):
    with growing(tmp_path / "mine") as folder:
        folder.add_row("gaze.csv", ["id", "z_mm"], {"id": "a,b", "z_mm": "1"})
        folder.add_row("gaze.csv", ["id", "z_mm"], {"id": "2", "z_mm": "3"})
        with pytest.raises(InputError, match="has the columns id, z_mm; the capture writes id"):
            folder.add_row("gaze.csv", ["id"], {"id": "4"})
        with pytest.raises(UsageError, match="another capture is writing"), growing(folder.root):
            pass
    with (tmp_path / "mine" / "gaze.csv").open() as file:
        assert [row["id"] for row in csv.DictReader(file)] == ["a,b", "2"]


def test_tables_and_links_of_others_are_spared(tmp_path):
    with growing(tmp_path / "mine") as folder:
        (folder.root / "gaze.csv").write_text("my own table\n")
        with pytest.raises(InputError, match="has the columns my own table"):
            folder.add_row("gaze.csv", ["id", "z_mm"], {"id": "1", "z_mm": "1"})
        (tmp_path / "elsewhere.csv").write_text("id,z_mm\n")
        (folder.root / "validation.csv").symlink_to(tmp_path / "elsewhere.csv")
        with pytest.raises(UsageError, match="is a link"):
            folder.add_row("validation.csv", ["id", "z_mm"], {"id": "1", "z_mm": "1"})
    assert (tmp_path / "mine" / "gaze.csv").read_text() == "my own table\n"
    assert (tmp_path / "elsewhere.csv").read_text() == "id,z_mm\n"


def test_an_id_is_used_once_and_no_picture_twice(tmp_path):
    """Property: of struck rows, pictures of others, and what a killed capture left."""
    with growing(tmp_path / "mine") as folder:
        capture = SimpleNamespace(folder=folder, table="gaze.csv", kind="gaze")
        assert next_name(capture) == "g01"
        folder.note("begun", table="gaze.csv", id="g01")
        folder.picture("gaze/c1/g01.png", np.zeros((4, 6), np.uint8))
        assert next_name(capture) == "g01"  # killed before its row
        folder.add_row("gaze.csv", ["id"], {"id": "g01"})
        assert next_name(capture) == "g02"
        folder.note("row", table="gaze.csv", id="g01")
        folder.write_text("gaze.csv", "id\n")  # struck
        assert next_name(capture) == "g02"
        folder.picture("gaze/c2/g02.png", np.zeros((4, 6), np.uint8))  # somebody's
        assert next_name(capture) == "g03"


@pytest.mark.parametrize("row", ["g02,1,2", "g02"])
def test_a_row_with_other_cells_than_the_header_is_named(tmp_path, row):
    with growing(tmp_path / "mine") as folder:
        folder.write_text("gaze.csv", f"id,z_mm\ng01,1\n{row}\n")
        with pytest.raises(InputError, match=r"gaze.csv, line 3: does not have the 2 cells"):
            folder.add_row("gaze.csv", ["id", "z_mm"], {"id": "g03", "z_mm": "3"})
