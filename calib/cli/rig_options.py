"""Options of the commands that use the rig itself, and how their devices are opened and left."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.arguments import add_input
from calib.stages.interruption import interrupt_on

if TYPE_CHECKING:
    from calib.rig.check_file import RigCheck
    from calib.rig.devices import RigDevices

HELP = "default: the embedded virtual rig"


def add_rig(parser: argparse.ArgumentParser, *, help: str = "") -> None:  # noqa: A002 - argparse's
    """Add the option that names the rig; `help` is said before which is taken by default."""
    add_input(parser, "--rig", metavar="RIG.toml", help="; ".join(filter(None, (help, HELP))))


def check_path(rig_file: Path | None) -> Path:
    """Return where the check of a rig lies: beside its rig.toml, or here for the virtual rig."""
    from calib.rig import check_file

    return check_file.check_path(rig_file)


@contextmanager
def opened(rig_file: Path | None, *, virtual_target: str | None = None) -> Iterator[RigDevices]:
    """Open the rig; Ctrl-C and SIGTERM stop the motor before anything else.

    Parameters
    ----------
    virtual_target
        What stands before the embedded virtual rig; what rig.toml says holds for others.
    """
    from calib.rig.devices import alone, open_rig
    from calib.rig.settings import read_settings

    interrupt_on(signal.SIGINT, signal.SIGTERM)
    settings = read_settings(rig_file)
    if rig_file is None and virtual_target is not None:
        virtual = settings.virtual.model_copy(update={"target": virtual_target})
        settings = settings.model_copy(update={"virtual": virtual})
    with alone(rig_file, settings), open_rig(settings) as rig:
        try:
            yield rig
        except BaseException:
            with suppress(Exception):  # what ended the command is what is told
                rig.axis.stop()
            raise


def last_check(rig_file: Path | None, serial: str) -> RigCheck | None:
    """Return what the last check of a rig found; None if it was never checked.

    Raises
    ------
    RigError
        If it found the rig unfit.
    InputError
        If the file is damaged, or is another rig's.
    """
    from calib.rig.check_file import fit_check

    return fit_check(check_path(rig_file), serial=serial)
