"""`calib plan` on the paper's data. Evidence: properties of the printed advice."""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import pytest

from calib.errors import UsageError
from calib.plan.command import add_arguments, run

ROOT = Path(__file__).parents[2]
DATA = str(ROOT / "datasets" / "xu-wang-2017")


def plan(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return run(parser.parse_args(arguments))


def test_plan_prints_ranked_targets_and_draws_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, head in (("plan.svg", b"<?xml"), ("plan.png", b"\x89PNG")):
        out = tmp_path / name
        assert plan(DATA, "--depth", "500", "1020", "--rows", "4", "--out", str(out)) == 0
        assert out.read_bytes().startswith(head)
    lines = capsys.readouterr().out.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("G-optimal"))
    table = [[float(x) for x in line.split()] for line in lines[start + 2 : start + 6]]
    assert [row[0] for row in table] == [1, 2, 3, 4]
    now = [float(x) for x in next(line for line in lines if line.startswith("now")).split()[1:]]
    assert table[0][-1] < now[-1]
    assert all(a[-1] >= b[-1] for a, b in pairwise(table))
    assert all(40 <= row[5] <= 140 for row in table)


def test_same_seed_same_picture(tmp_path: Path) -> None:
    pictures = []
    for name in ("a.svg", "b.svg"):
        plan(DATA, "--depth", "800", "--rows", "2", "--out", str(tmp_path / name))
        pictures.append((tmp_path / name).read_bytes())
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--depth", "800", "--out", "plan.gif"], "svg"),
        (["--depth", "800", "--model", "round"], "axis-offset"),
        (["--depth", "800", "--yaw", "40", "41"], "--yaw"),
    ],
)
def test_wrong_use_is_explained(arguments: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        plan(DATA, *arguments)
