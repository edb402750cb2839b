"""Options of the commands that use the rig itself, and how their devices are opened and left."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.arguments import add_input
from calib.stages.interruption import interrupt_on

if TYPE_CHECKING:
    from calib.rig.check_file import RigCheck
    from calib.rig.devices import RigDevices

HELP = "default: the embedded virtual rig"


def add_rig(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the rig."""
    add_input(parser, "--rig", metavar="RIG.toml", help=HELP)


def check_path(rig_file: Path | None) -> Path:
    """Return where the check of a rig lies: beside its rig.toml, or here for the virtual rig."""
    from calib.rig.check_file import FILE

    return Path(FILE) if rig_file is None else rig_file.with_name(FILE)


@contextmanager
def opened(rig_file: Path | None) -> Iterator[RigDevices]:
    """Open the rig; Ctrl-C and SIGTERM stop the motor before anything else."""
    from calib.rig.devices import open_rig
    from calib.rig.settings import read_settings

    interrupt_on(signal.SIGINT, signal.SIGTERM)
    with open_rig(read_settings(rig_file)) as rig:
        try:
            yield rig
        except BaseException:
            rig.axis.stop()
            raise


def last_check(rig_file: Path | None, serial: str) -> RigCheck | None:
    """Return what the last check of a rig found; None if it was never checked.

    Raises
    ------
    InputError
        If the file is damaged, or is another rig's.
    """
    from calib.rig.check_file import read_check

    return read_check(check_path(rig_file), serial=serial)
