"""`calib verify`: whether the files of a run are whole, untouched, and of one run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from calib.cli.arguments import add_input
from calib.cli.voice import add_voice, print_json
from calib.core.errors import harmless

WHOLE, BROKEN = 0, 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "folder", metavar="DIR", is_calibration=True, help="folder of a run")
    add_voice(parser, json_help="print problems and what was verified as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print what was verified, or what is wrong; return the exit status."""
    from calib.results.verify import verify

    folder: Path = arguments.folder
    found = verify(folder)
    if arguments.json:
        print_json(
            {
                "folder": str(folder),
                "whole": not found.problems,
                "files": found.files,
                "problems": [str(problem) for problem in found.problems],
                "verified": found.lines,
            }
        )
        return BROKEN if found.problems else WHOLE
    for problem in found.problems[:10]:
        print(f"calib: {harmless(str(problem))}", file=sys.stderr)
    if found.problems:
        return BROKEN
    if arguments.quiet:
        return WHOLE
    for line in found.lines:
        print(line)
    print(f"{harmless(str(folder))}: {found.files} files, whole and as the run wrote them")
    return WHOLE
