"""`calib rig check`: what would spoil the rows of a rig, by pictures of a board."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.arguments import add_input, add_output
from calib.cli.rig_options import HELP, check_path, opened
from calib.cli.voice import add_voice
from calib.core.errors import UsageError, harmless
from calib.stages.output_guard import OutputKind, guarded

if TYPE_CHECKING:
    from calib.rig.check_file import RigCheck
    from calib.rig.devices import RigDevices

DONE, NOT_FIT = 0, 3

CHECK = OutputKind(is_folder=False, marks=(b'"kind": "calib rig check"',))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own commands."""
    commands = parser.add_subparsers(dest="rig_command", required=True, metavar="COMMAND")
    add = commands.add_parser(
        "check", help="direction, step, play, tremor, frame age and repeatability, by a board"
    )
    add_input(add, "rig", nargs="?", metavar="RIG.toml", help=HELP)
    add_output(
        add, "--out", kind=CHECK, metavar="FILE", help="default: rig-check.json beside RIG.toml"
    )
    add_voice(add, json_help="print what is written as JSON too")
    add.set_defaults(run=_run_check)


def _run_check(arguments: argparse.Namespace) -> int:
    """Check the rig and return the exit status: 3 if something would spoil rows."""
    from calib.rig.check import check_rig
    from calib.rig.check_file import check_text
    from calib.rig.known import known_board, known_lens
    from calib.stages.files import write_bytes

    out = arguments.out
    if out is None:
        given = [] if arguments.rig is None else [arguments.rig]
        out = guarded(
            check_path(arguments.rig), CHECK, option="--out", inputs=given, force=arguments.force
        )
    with opened(arguments.rig) as rig:
        board = known_board(rig)
        if board is None:
            raise UsageError(
                f"{arguments.rig}: has no [board]; add the board that C2 is to look at"
            )
        _show_board(rig)
        found = check_rig(
            rig, board, lens_c2=known_lens(rig, "c2"), announce=lambda what: _tell(f"{what} ...")
        )
    write_bytes(out, check_text(found).encode())
    if arguments.json:
        sys.stdout.write(check_text(found))
    elif arguments.quiet:
        for check in found.checks:
            if not check.passed:
                print(f"{check.name}: {check.detail}")
    else:
        print(_text(found, out))
    return NOT_FIT if found.failed else DONE


def _show_board(rig: RigDevices) -> None:
    """Put the board before a virtual rig, as a hand would."""
    from calib.rig.virtual.operator import Operator

    if rig.world is not None:
        Operator(rig.world).show_gaze()


def _tell(line: str) -> None:
    if sys.stderr.isatty():
        print(f"  {line}", file=sys.stderr)


def _text(found: RigCheck, out: Path) -> str:
    lines = [f"rig {harmless(found.serial)}: {found.reads}, {found.devices.axis}"]
    for check in found.checks:
        word = "ok" if check.passed else "FAILED"
        lines.append(f"  {check.name:<18} {word:<7} {check.detail}")
    where = " at whole steps of the motor" if found.whole_steps else ""
    lines += [
        f"  play {found.backlash_deg:.4f} deg ({found.backlash_steps:.1f} steps)",
        f"  frames {found.frame_age_ms.c1:.0f} ms (C1) and {found.frame_age_ms.c2:.0f} ms (C2) old",
        f"  returns within {found.repeatability_deg:.4f} deg",
        f"  u_alpha2_deg = {found.u_alpha2_deg:.6f}{where}",
        f"written: {harmless(str(out))}",
    ]
    return "\n".join(lines)
