"""The command line as a user has it: in a process of its own, or called here to be quick."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from calib.cli.main import main

CALIB = Path(sys.executable).with_name("calib")
DATASETS = Path(__file__).parents[2] / "datasets"

GOOD = {
    "dataset.toml": """\
format = 1
name = "rig"
[encoder]
resolution_deg = 0.05625
[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = 0.0002
u_z_rel = 0.002
""",
    "gaze.csv": """\
id,x1c,y1c,alpha2_deg,z_mm
1,0.1018,0.0100,86.150,485.9
2,0.2635,0.0100,95.006,486.5
3,0.2353,0.0100,96.950,796.4
4,0.0229,0.0100,85.210,805.9
5,0.0162,0.0100,85.859,1008.5
6,0.1624,0.0100,94.033,998.5
""",
}


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int
    out: str
    err: str


def process(*arguments: object, env: Mapping[str, str] | None = None, text: str = "") -> Ended:
    """Run calib in a process of its own."""
    done = subprocess.run(
        [CALIB, *map(str, arguments)],
        env=os.environ | dict(env or {}),
        input=text,
        capture_output=True,
        text=True,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield every command of a parser, and the commands of commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield command
                yield from commands(command)


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> Ended:
    """Run calib in this process."""
    capsys.readouterr()
    try:
        status = main([str(a) for a in arguments])
    except SystemExit as ended:  # argparse
        status = int(ended.code or 0)
    said = capsys.readouterr()
    return Ended(status, said.out, said.err)


def dataset(folder: Path, files: Mapping[str, str | bytes] = GOOD) -> Path:
    """Write a dataset."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        data = text.encode() if isinstance(text, str) else text
        (folder / name).write_bytes(data)
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    """Return every file under a folder with its bytes."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }
