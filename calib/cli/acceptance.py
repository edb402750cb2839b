"""Calibrations that should not be used, and the options by which a user takes them all the same."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib.cli.arguments import add_input
from calib.cli.streams import say
from calib.core.gate import Gate

DONE, GATE_FAILED = 0, 3

UNUSABLE = "must not be used; mend what its report names, or --accept-failed"

NAMED_FAULTS = 10
"""Of a kind that are named."""


def add_calibration(
    parser: argparse.ArgumentParser,
    name: str = "calibration",
    *,
    metavar: str = "CALIBRATION.json",
    **settings: Any,
) -> None:
    """Add a calibration that is read, and the options to use one that should not be used.

    The settings are those of ``add_argument``. The command says if it was edited or failed.
    """
    add_input(parser, name, metavar=metavar, is_calibration=True, **settings)
    accept_failed(parser, "use a calibration whose gates failed")
    parser.add_argument(
        "--allow-edited", action="store_true", help="use a calibration that was edited by hand"
    )


def accept_failed(parser: argparse.ArgumentParser, words: str) -> None:
    """Add the option by which a user takes what failed its checks."""
    parser.add_argument("--accept-failed", action="store_true", help=words)


def warn_of_failed(
    name: Path, failed: Sequence[Gate], *, accepted: bool, told: str = UNUSABLE
) -> bool:
    """Say on stderr which checks failed; return whether the user minds."""
    if not failed or accepted:
        return False
    for gate in failed[:NAMED_FAULTS]:
        say(f"calib: {name}: gate {gate.name} FAILED: {gate.detail}")
    say(f"calib: {name}: {told}")
    return True
