"""`calib export`: cameras and their pose for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from calib.cli.acceptance import DONE, GATE_FAILED, add_acceptance, warn_of_failed
from calib.cli.arguments import add_input, add_output
from calib.stages.output_guard import OutputKind

FORMATS = ("opencv", "mrcal", "ros", "kalibr")

MARKS = ("camchain.yaml", "c1.yaml", "c1.cameramodel", "c2.yaml", "c2.cameramodel")
EXPORTED = OutputKind(is_folder=True, marks=MARKS)
"""Known by the names of its files."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "calibration", metavar="CALIBRATION.json")
    parser.add_argument("--format", choices=FORMATS, required=True, help="of which tool")
    add_output(
        parser, "--out", kind=EXPORTED, metavar="DIR", required=True, help="folder for the files"
    )
    add_acceptance(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the files, name them, return the exit status."""
    from calib.instrument.calibration_file import read_cameras
    from calib.results.export import FORMATS as WRITERS
    from calib.stages.store import make_folder, write_bytes

    found = read_cameras(arguments.calibration, allow_edited=arguments.allow_edited)
    files = WRITERS[arguments.format](found)
    folder: Path = arguments.out
    make_folder(folder)
    for name, text in files.items():
        write_bytes(folder / name, text.encode())
        print(folder / name)
    minded = warn_of_failed(
        arguments.calibration, found.failed_gates, accepted=arguments.accept_failed
    )
    return GATE_FAILED if minded else DONE
