"""`calib capture`: rows into a dataset, crash-safe, resumable."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack

from calib.cli import guided_capture
from calib.cli.arguments import add_output, depth, natural, positive
from calib.cli.gaze import add_target, make_gazer
from calib.cli.guided_capture import DATASET
from calib.cli.rig_options import add_rig, opened
from calib.cli.voice import add_voice, print_json
from calib.core.errors import harmless
from calib.core.words import counted

DONE, NOT_ALL = 0, 3


DEFAULT_COUNT = 15
EVERY = 10
SOURCES = ("hand", "squares", "pairs")
DEFAULT_U_Z_MM = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own commands."""
    commands = parser.add_subparsers(dest="capture_command", required=True, metavar="WHAT")
    for kind, purpose in (
        ("gaze", "rows to calibrate with"),
        ("validation", "rows that are never used to fit"),
    ):
        add = commands.add_parser(kind, help=purpose)
        add_output(add, "dataset", kind=DATASET, metavar="DATASET", help="folder to add to")
        add_rig(add)
        add.add_argument(
            "--count", type=positive, default=DEFAULT_COUNT, metavar="N",
            help=f"rows that the table then has; default: {DEFAULT_COUNT}",
        )  # fmt: skip
        add_target(add)
        add_voice(add, json_help="print how many rows there are as JSON")
        add.add_argument(
            "--u-z-mm", type=depth, default=DEFAULT_U_Z_MM, metavar="MM",
            help=f"standard uncertainty of depths typed in; default: {DEFAULT_U_Z_MM:g}",
        )  # fmt: skip
        add.add_argument(
            "--reference", choices=SOURCES, default=None,
            help="where depths come from: typed in; the squares of a board that both cameras see; "
            "pairs of pictures, C2 held; default: as the table was begun, or by hand",
        )  # fmt: skip
        add.add_argument(
            "--returns", type=natural, default=EVERY, metavar="N",
            help="rows between two returns to the first target, which tell whether the zero stands "
            f"still; 0 for none; default: {EVERY}",
        )  # fmt: skip
        add.set_defaults(run=_run)
    guided_capture.add_commands(commands)


def _run(arguments: argparse.Namespace) -> int:
    """Capture and return the exit status: 3 if the rows did not come together."""
    from calib.capture.description import describe, read_manifest, refuse_other
    from calib.capture.ready import (
        lens,
        lens_c2,
        reading_uncertainty,
        return_uncertainty,
    )
    from calib.capture.references import ByHand, described, held_reading, reference_for, source_of
    from calib.capture.rows import Capture, capture_rows, targets_before
    from calib.capture.writer import growing
    from calib.gaze.placing import placing_for

    with ExitStack() as stack:
        rig = stack.enter_context(opened(arguments.rig))
        known = describe(rig, u_alpha2_deg=reading_uncertainty(rig, arguments.rig))
        folder = stack.enter_context(growing(arguments.dataset))
        manifest = read_manifest(folder)
        if manifest is not None:
            refuse_other(manifest, known)
        source = source_of(manifest, arguments.capture_command, arguments.reference)
        held = held_reading(rig, manifest) if source == "pairs" else None
        gazer = make_gazer(arguments, rig, lens_c2(known, manifest, folder))
        hand = placing_for(rig, _tell, held_rad=held, before=targets_before(folder))
        capture = Capture(
            gazer=gazer,
            hand=hand,
            reference=reference_for(
                source,
                by_hand=lambda: ByHand(hand, arguments.u_z_mm),
                gazer=gazer,
                known=known,
                lens_c1=None if source == "hand" else lens("c1", known, manifest, folder),
                held_rad=held,
                folder=folder,
            ),
            folder=folder,
            known=described(known, source),
            kind=arguments.capture_command,
            announce=_tell,
            u_return_rad=return_uncertainty(rig, arguments.rig),
            returns_every=arguments.returns,
        )
        ended = capture_rows(capture, count=arguments.count)
    if arguments.json:
        told = {"table": capture.table, "rows": ended.rows, "refused": ended.refused}
        print_json({"dataset": str(arguments.dataset), **told})
    elif not arguments.quiet:
        print(
            f"{harmless(str(arguments.dataset))}: {counted(ended.rows, 'row')} in {capture.table}"
        )
    if ended.rows < arguments.count:
        _tell(f"calib: {ended.refused} targets were refused, the last ones in a row: see above")
        return NOT_ALL
    return DONE


def _tell(line: str) -> None:
    print(harmless(line), file=sys.stderr, flush=True)
