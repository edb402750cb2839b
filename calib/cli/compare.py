"""`calib compare`: runs of one rig side by side."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from calib.cli.acceptance import DONE, GATE_FAILED, add_calibration, warn_of_failed
from calib.cli.arguments import add_output
from calib.cli.streams import say
from calib.cli.voice import add_voice, print_json
from calib.stages.output_guard import OutputKind

if TYPE_CHECKING:
    from calib.history.drift import ComparedRun

PAGE = OutputKind(is_folder=False, marks=(b'content="calib compare"',))
"""Known by its generator."""

INTERVALS = """\
In [ ] the 95 % interval of a normal distribution, from the standard uncertainty by which changes
are judged. `calib calibrate` prints that of the draws, which need not be symmetric.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(
        parser, "runs", nargs="+", metavar="RUN",
        help="folders of finished runs, or their calibration.json; the first is the reference",
    )  # fmt: skip
    add_output(parser, "--out", kind=PAGE, metavar="HTML", help="page to write; default: none")
    add_voice(parser, json_help="print runs and changes as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the comparison, write its page, return the exit status."""
    from calib.core.errors import UsageError
    from calib.history.drift import accepted, drifts
    from calib.history.output import document, html, tables, text, verdicts
    from calib.history.read import read_run
    from calib.stages.files import write_bytes

    if len(arguments.runs) < 2:
        raise UsageError("compare takes two runs or more")
    runs = [read_run(path, allow_edited=arguments.allow_edited) for path in arguments.runs]
    if arguments.accept_failed:
        runs = [accepted(run) for run in runs]
    changes = drifts(runs)
    found = tables(runs, changes)
    if arguments.json:
        print_json(document(runs, changes))
    else:
        sys.stdout.write(verdicts(changes) if arguments.quiet else f"{text(found)}\n{INTERVALS}")
    if arguments.out is not None:
        write_bytes(arguments.out, html(found).encode())
        if not (arguments.json or arguments.quiet):
            sys.stdout.write(f"\npage: {arguments.out}\n")
    if told := _of_more_rigs(runs):
        say(told)
    minded = [
        warn_of_failed(path, run.measuring.failed_gates, accepted=False)
        for path, run in zip(arguments.runs, runs, strict=True)
    ]
    return GATE_FAILED if any(minded) else DONE


def _of_more_rigs(runs: Sequence[ComparedRun]) -> str | None:
    """Return a warning where runs do not say that they are of one rig, or say that they are not."""
    serials = [run.measuring.serial for run in runs]
    known = list(dict.fromkeys(serial for serial in serials if serial is not None))
    if len(known) > 1:
        names = " and ".join(known)
        return f"calib: these runs are of different rigs ({names}): differences are no changes"
    if known and None in serials:
        silent = ", ".join(run.name for run, one in zip(runs, serials, strict=True) if one is None)
        return (
            f"calib: {silent}: no [rig] serial in its dataset; only if it is {known[0]} "
            "are differences changes of one rig"
        )
    if not known and len({run.dataset_sha256 for run in runs}) > 1:
        return (
            "calib: no [rig] serial in these datasets: nothing shows that they are of one rig, and "
            "only then are differences changes"
        )
    return None
