"""The map of the code is that of the code. Evidence: property."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from calib.chain.outputs import write_set
from calib.geometry.parameters import MODELS, NAMES

PROJECT = Path(__file__).parents[2]
PAGE = (PROJECT / "docs" / "architecture.md").read_text()
ROOMS = {path.parent.name for path in (PROJECT / "calib").glob("*/__init__.py")}


def test_every_room_is_on_the_map_once() -> None:
    table = PAGE[PAGE.index("| room |") : PAGE.index("## A stage")]
    firsts = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert sorted(re.findall(r"`(\w+)`", " ".join(firsts))) == sorted(ROOMS)


def test_every_file_that_it_names_exists() -> None:
    """A file without a folder lies in the room named before it in the same line or item."""
    named = re.findall(r"`((?:[\w.]+/)*[\w]*\.py|(?:\w+/)+)`", PAGE)
    assert len(named) > 30
    tops = (PROJECT, PROJECT / "calib")
    for name in named:
        places = [*(top / name for top in tops), *(PROJECT / "calib").glob(f"*/{name}")]
        assert any(place.exists() for place in places), name


def test_every_parameter_and_model_has_its_row_in_the_conventions() -> None:
    conventions = (PROJECT / "docs" / "conventions.md").read_text()
    rows = [line.split("|")[1] for line in conventions.splitlines() if line.startswith("| `")]
    assert {*NAMES, *MODELS} <= set(re.findall(r"`([\w-]+)`", " ".join(rows)))


def test_an_output_that_is_not_declared_is_refused(tmp_path: Path) -> None:
    """It would stay behind when a later run has none of it."""
    with pytest.raises(ValueError, match=r"note\.txt"):
        write_set(tmp_path / "out", {"note.txt": b""}, fingerprint="")
    assert not (tmp_path / "out").exists()
