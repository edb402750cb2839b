"""The page of calibration.json, and from where depths count. Evidence: property."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
PAGES = [
    PROJECT / "README.md",
    PROJECT / "datasets" / "README.md",
    *(PROJECT / "docs").glob("*.md"),
]
TELLS_OF_TABLES = [
    page for page in PAGES if "`z_mm`" in page.read_text() or ",z_mm" in page.read_text()
]


def test_the_page_of_calibration_json_is_that_of_its_schema() -> None:
    """If this fails: tools/schema_page.py writes it anew."""
    spec = importlib.util.spec_from_file_location("page", PROJECT / "tools" / "schema_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = module.page()
    assert (PROJECT / "docs" / "calibration-json.md").read_text() == page
    for key in ("depth_uncertainty", "q97.5", "low95_mm", "transform_12"):
        assert f"`{key}`" in page


@pytest.mark.parametrize("page", TELLS_OF_TABLES, ids=lambda page: page.name)
def test_pages_that_tell_of_the_table_say_from_where_depth_counts(page: Path) -> None:
    text = " ".join(page.read_text().split())
    assert "optical centre" in text
    assert "z_from" in text


def test_every_key_says_what_it_means() -> None:
    page = (PROJECT / "docs" / "calibration-json.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 200
    assert [row for row in rows if row.endswith("|  |")] == []
