"""Calibrations that should not be used, and the options by which a user takes them all the same."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.instrument.calibration_file import Measuring

NAMED_FAULTS = 10
"""Of a kind that are named."""


def add_acceptance(parser: argparse.ArgumentParser) -> None:
    """Add the options by which a user takes a calibration that should not be used."""
    parser.add_argument(
        "--accept-failed", action="store_true", help="use a calibration whose gates failed"
    )
    parser.add_argument(
        "--allow-edited", action="store_true", help="use a calibration that was edited by hand"
    )


def warn_of_failed(name: Path, measuring: Measuring, *, accepted: bool) -> bool:
    """Say on stderr which checks of a calibration failed; return whether the user minds."""
    if not measuring.failed_gates or accepted:
        return False
    for gate in measuring.failed_gates[:NAMED_FAULTS]:
        print(f"calib: {name}: gate {gate.name} FAILED: {gate.detail}", file=sys.stderr)
    print(
        f"calib: {name}: must not be used; mend what its report names, or --accept-failed",
        file=sys.stderr,
    )
    return True
