"""`calib export`: cameras and their pose for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from calib.cli.acceptance import DONE, GATE_FAILED, add_calibration, warn_of_failed
from calib.cli.arguments import add_output
from calib.cli.voice import add_voice, print_json
from calib.core.errors import harmless
from calib.stages.output_guard import OutputKind, files_of

MARK = "# calib export"

FORMATS = ("opencv", "mrcal", "ros", "kalibr")

ENDINGS = (".yaml", ".cameramodel")
EXPORTED = OutputKind(
    is_folder=True, files=tuple((f"*{ending}", (MARK.encode(),)) for ending in ENDINGS)
)
"""Known by a comment in its files, whose names are those that users give their own cameras."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(parser)
    parser.add_argument("--format", choices=FORMATS, required=True, help="of which tool")
    add_output(
        parser, "--out", kind=EXPORTED, metavar="DIR", required=True, help="folder for the files"
    )
    add_voice(parser, json_help="print the files written as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Write the files, name them, return the exit status."""
    from calib.instrument.calibration_file import read_cameras
    from calib.results.export import FORMATS as WRITERS
    from calib.results.export import marked
    from calib.stages.files import make_folder, write_bytes

    found = read_cameras(arguments.calibration, allow_edited=arguments.allow_edited)
    files = {n: marked(text, MARK) for n, text in WRITERS[arguments.format](found).items()}
    folder: Path = arguments.out
    make_folder(folder)
    places = files_of(folder, files, EXPORTED, option="--out", force=arguments.force)
    for name, path in places.items():
        write_bytes(path, files[name].encode())
        if not (arguments.json or arguments.quiet):
            print(harmless(str(path)))
    if arguments.json:
        written = {name: str(path) for name, path in places.items()}
        print_json({"format": arguments.format, "files": written})
    minded = warn_of_failed(
        arguments.calibration, found.failed_gates, accepted=arguments.accept_failed
    )
    return GATE_FAILED if minded else DONE
