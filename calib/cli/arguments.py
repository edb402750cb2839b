"""Arguments that several commands take, and the roles of paths.

A path argument is added by one of the functions below, never by a bare `type=Path`: its role
decides what the guard of `calib.stages.output_guard` holds it against, before the command begins.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.stages.output_guard import RUN_FOLDER, OutputKind, guarded

COMPLETE_FILES = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}
"""What shtab puts into its scripts for a file or folder: its `shtab.FILE`."""

STREAM = "-"
"""Stands for standard input where a command takes it."""


@dataclass(frozen=True)
class PathRole:
    """What a command does with a path: reads it (`writes` is None), or writes it.

    Parameters
    ----------
    is_calibration
        Whether it reads calibrations there, which may be edited, mixed or failed.
    """

    option: str
    dest: str
    writes: OutputKind | None = None
    is_calibration: bool = False


def roles(parser: argparse.ArgumentParser) -> list[PathRole]:
    """Return the roles of a command's paths."""
    return list(parser.get_default("path_roles") or ())


def path(text: str) -> Path:
    """Return a path; an empty one, of an unset variable, would be the working directory."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: give a name")
    try:
        text.encode()
    except UnicodeEncodeError:  # results state paths, as text
        raise argparse.ArgumentTypeError("is no name in UTF-8: rename it") from None
    return Path(text)


def add_input(
    parser: argparse.ArgumentParser,
    *names: str,
    group: argparse._MutuallyExclusiveGroup | None = None,
    is_calibration: bool = False,
    **settings: Any,
) -> None:
    """Add a path that the command reads; the settings are those of ``add_argument``."""
    settings = {"type": path} | settings
    _add(parser, None, names, settings, group, is_calibration=is_calibration)


def add_output(
    parser: argparse.ArgumentParser, *names: str, kind: OutputKind, **settings: Any
) -> None:
    """Add a path that the command writes, and the option that lets it replace a foreign file.

    What is made anew has no such option.
    """
    _add(parser, kind, names, {"type": path} | settings)
    if not kind.is_new and "--force" not in parser._option_string_actions:
        parser.add_argument(
            "--force", action="store_true", help="replace files that another tool wrote"
        )


def _add(
    parser: argparse.ArgumentParser,
    kind: OutputKind | None,
    names: Sequence[str],
    settings: dict[str, Any],
    group: argparse._MutuallyExclusiveGroup | None = None,
    *,
    is_calibration: bool = False,
) -> None:
    action = (group or parser).add_argument(*names, **settings)
    action.complete = COMPLETE_FILES  # type: ignore[attr-defined] # by it shtab knows a path
    option = names[0] if names[0].startswith("-") else str(settings.get("metavar", names[0]))
    role = PathRole(option, action.dest, kind, is_calibration)
    parser.set_defaults(path_roles=[*roles(parser), role])


def inputs_of(parsed: argparse.Namespace) -> list[Path]:
    """Return the paths that a command reads."""
    found: list[Path] = []
    for role in getattr(parsed, "path_roles", ()):
        value = getattr(parsed, role.dest)
        if role.writes is None and value is not None:
            found += value if isinstance(value, list) else [value]
    return [one for one in found if str(one) != STREAM]


def guard_outputs(parsed: argparse.Namespace) -> None:
    """Hold the outputs that were asked for against everything else; they become real paths.

    Raises
    ------
    UsageError
        If one may not be written.
    """
    for role in getattr(parsed, "path_roles", ()):
        value = getattr(parsed, role.dest)
        if role.writes is not None and value is not None:
            real = guarded(
                value, role.writes,
                option=role.option, inputs=inputs_of(parsed),
                force=getattr(parsed, "force", False),
            )  # fmt: skip
            setattr(parsed, role.dest, real)


def run_folder(out: Path | None, root: Path, *, force: bool) -> Path:
    """Return the folder of a dataset's run: `out`, which is guarded already, or ``reports/NAME``.

    Raises
    ------
    UsageError
        If the default may not be written.
    """
    if out is not None:
        return out
    default = Path("reports") / root.name
    guarded(default, RUN_FOLDER, option="--out", inputs=[root], force=force)
    return default


MOST = 2**63 - 1
"""Largest seed."""


def natural(text: str) -> int:
    """Return a whole number from 0."""
    return whole(text, least=0)


def positive(text: str) -> int:
    """Return a whole number from 1."""
    return whole(text, least=1)


MOST_JOBS = 1024
"""Processes on one machine."""


def jobs(text: str) -> int:
    """Return a number of processes."""
    return whole(text, least=1, most=MOST_JOBS)


def whole(text: str, *, least: int, most: int = MOST) -> int:
    """Return a whole number within bounds."""
    digits = text.isascii() and text.isdigit() and len(text) <= len(str(MOST))
    if not (digits and least <= int(text) <= most):
        limit = "2**63 - 1" if most == MOST else str(most)
        raise argparse.ArgumentTypeError(f"{text!r}: give a whole number from {least} to {limit}")
    return int(text)


def number(text: str, *, below: float, wanted: str, above: float = 0.0) -> float:
    """Return a number between `above` and `below`."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not above < value < below:
        raise argparse.ArgumentTypeError(f"{text!r}: give {wanted}")
    return value


LARGEST_DEPTH_MM = 1e7
"""Ten kilometres: no gaze angle measures them, and squares of larger numbers soon overflow."""


LEAST_DEPTH_MM = 1e-3
"""A micrometre before the camera there is no target; squares of far smaller numbers are 0."""


def depth(text: str) -> float:
    """Return a depth in mm."""
    wanted = "a depth in mm, above 1 um and below 10 km"
    return number(text, above=LEAST_DEPTH_MM, below=LARGEST_DEPTH_MM, wanted=wanted)
