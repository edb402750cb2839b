"""`calib compare`: runs of one rig side by side."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "runs", type=Path, nargs="+", metavar="RUN",
        help="folders of finished runs, or their calibration.json; the first is the reference",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="HTML", help="page to write; default: none")


def run(arguments: argparse.Namespace) -> int:
    """Print the comparison, write its page, return the exit status."""
    from calib.core.errors import UsageError
    from calib.history.drift import drifts
    from calib.history.output import html, tables, text
    from calib.history.read import read_run
    from calib.stages.store import write_bytes

    if len(arguments.runs) < 2:
        raise UsageError("compare takes two runs or more")
    runs = [read_run(path) for path in arguments.runs]
    found = tables(runs, drifts(runs))
    sys.stdout.write(text(found))
    if arguments.out is not None:
        write_bytes(arguments.out, html(found).encode())
        sys.stdout.write(f"\npage: {arguments.out}\n")
    return 0
