"""`calib verify`: whether the files of a run are whole, untouched, and of one run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from calib.cli.arguments import add_input

WHOLE, BROKEN = 0, 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "folder", metavar="DIR", help="folder of a run")


def run(arguments: argparse.Namespace) -> int:
    """Print what was verified, or what is wrong; return the exit status."""
    from calib.results.verify import verify

    folder: Path = arguments.folder
    found = verify(folder)
    for problem in found.problems[:10]:
        print(f"calib: {problem}", file=sys.stderr)
    if found.problems:
        return BROKEN
    for line in found.lines:
        print(line)
    print(f"{folder}: {found.files} files, whole and as the run wrote them")
    return WHOLE
