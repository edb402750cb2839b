"""The tables of docs/uncertainty.md. Evidence: property; the committed study is their source."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import pytest

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The tool, at work on a copy of the documents."""
    spec = importlib.util.spec_from_file_location("tables", PROJECT / "tools" / "study_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    docs = tmp_path / "docs"
    shutil.copytree(PROJECT / "docs" / "study", docs / "study")
    shutil.copy(PROJECT / "docs" / "uncertainty.md", docs)
    monkeypatch.setattr(module, "DOCS", docs)
    monkeypatch.setattr(module, "DOCUMENT", docs / "uncertainty.md")
    return module


def test_the_documents_tables_are_those_of_the_committed_study(tool: ModuleType) -> None:
    assert tool.main(["--check"]) == 0


def test_a_changed_score_is_noticed_and_written(tool: ModuleType) -> None:
    scores = tool.DOCS / "study" / "default" / "scores.csv"
    lines = scores.read_text().splitlines()
    wanted = "base-14,depth inside,selected,coverage95,"
    changed = [f"{wanted}0.1234,0.01,85" if line.startswith(wanted) else line for line in lines]
    assert changed != lines
    scores.write_text("\n".join(changed) + "\n")
    assert tool.main(["--check"]) == 1
    assert tool.main([]) == 0
    assert "| base | 14 | 12.3 ± 1.0 % |" in tool.DOCUMENT.read_text()
    assert tool.main(["--check"]) == 0


def test_the_words_on_mistakes_agree_with_the_scores(tool: ModuleType) -> None:
    study = tool.Study(tool.DOCS / "study" / "faults")
    keys = [(tool.MISTAKES, f"{count} rows", "", "named") for count in tool.ROW_COUNTS]
    shares = [f"{100 * float(study.value(*key, digits=4).split()[0]):.0f}" for key in keys]
    text = " ".join(tool.DOCUMENT.read_text().split())
    few, some, many = shares
    assert f"{few} % are named with 14 rows, {some} % with 24, {many} % with 60" in text
    assert max(map(float, shares)) < 90
