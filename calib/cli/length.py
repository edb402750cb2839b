"""`calib length`: the distance of two points that the rig gazes at, one after the other."""

from __future__ import annotations

import argparse

from calib.cli.acceptance import add_calibration, warn_of_failed
from calib.cli.arguments import add_output, positive
from calib.cli.gaze import make_gazer
from calib.cli.measure import writer
from calib.cli.rig_options import add_rig, opened
from calib.cli.streams import say
from calib.cli.voice import add_voice, as_json_lines
from calib.stages.output_guard import OutputKind

DONE, NOT_ALL = 0, 3

PLATE = "plate:1400,500,10"
"""Before the embedded virtual rig: the longest plate of Xu and Wang."""

LENGTHS = OutputKind(is_folder=False, marks=(b"id,from,to,length_mm,",))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(parser)
    add_rig(parser)
    parser.add_argument(
        "--from", dest="start", default="plate:left-upper", metavar="TARGET",
        help="plate:left-upper (default), another corner of a plate, or a target of calib gaze",
    )  # fmt: skip
    parser.add_argument(
        "--to", dest="end", default="plate:right-upper", metavar="TARGET",
        help="default: plate:right-upper",
    )  # fmt: skip
    parser.add_argument(
        "--count",
        type=positive,
        default=1,
        metavar="N",
        help="things to measure, one after another",
    )
    add_output(parser, "--out", kind=LENGTHS, metavar="CSV", help="default: standard output")
    add_voice(parser, json_help="write an object a row, JSON Lines")
    parser.add_argument(
        "--model", default="selected", metavar="NAME",
        help="selected (default), a fitted model, or average over all of them",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Measure lengths and return the exit status: 3 if one could not be or a gate had failed."""
    from calib.core.errors import UsageError
    from calib.gaze.length import gaze_length, header, line
    from calib.gaze.length import refused as refused_line
    from calib.gaze.measured import aiming, lenses
    from calib.gaze.placing import placing_for
    from calib.gaze.target import target
    from calib.instrument.calibration_file import read_calibration
    from calib.rig.known import known_board
    from calib.rig.protocols import RigError

    if arguments.start == arguments.end:
        raise UsageError("length: --from and --to name one and the same target")
    measuring = read_calibration(arguments.calibration, allow_edited=arguments.allow_edited)
    minded = warn_of_failed(
        arguments.calibration, measuring.failed_gates, accepted=arguments.accept_failed
    )
    refused = 0
    with opened(arguments.rig, virtual_target=PLATE) as rig, writer(arguments.out) as put:
        write = as_json_lines(put) if arguments.json else put
        known = lenses(measuring, rig, name=str(arguments.calibration))
        board = known_board(rig)
        ends = target(arguments.start, board), target(arguments.end, board)
        gazer = make_gazer(arguments, rig, known.c2, lens_c1=known.c1, at=ends[0])
        where = aiming(measuring, known.c1)
        hand = placing_for(rig, _tell)
        write(header())
        for name in (f"l{i:02d}" for i in range(1, arguments.count + 1)):
            hand.place(name)
            try:
                found = gaze_length(gazer, where, measuring, ends, model=arguments.model)
            except RigError as error:
                refused += 1
                _tell(f"calib: {name}: {error}")
                write(refused_line(name, ends, str(error)))
            else:
                write(line(name, ends, found, gate_failed=bool(minded)))
    return NOT_ALL if refused or minded else DONE


def _tell(line: str) -> None:
    say(line)
