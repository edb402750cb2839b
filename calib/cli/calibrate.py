"""`calib calibrate`: the whole chain on a dataset."""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.cli.arguments import add_input, add_output, depth, natural, run_folder
from calib.cli.streams import say
from calib.cli.voice import add_voice, print_json
from calib.core.errors import UsageError, harmless
from calib.stages.interruption import interrupt_on
from calib.stages.output_guard import RUN_FOLDER

if TYPE_CHECKING:
    from calib.dataset.contents import Dataset

DONE, GATE_FAILED = 0, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "dataset", metavar="DATASET", help="folder with dataset.toml")
    add_output(parser, "--out", kind=RUN_FOLDER, metavar="DIR", help="default: reports/NAME")
    parser.add_argument("--seed", type=natural, default=0, metavar="N", help="default: 0")
    add_voice(parser, json_help="print the result in short as JSON")
    parser.add_argument(
        "--depths", type=depth, nargs=2, metavar=("LOW", "HIGH"),
        help="range of the depth uncertainty table, mm; default: that of the rows",
    )  # fmt: skip
    parser.add_argument(
        "--method", choices=("rows", "adjustment"), default="rule",
        help="take the instrument from the gaze rows or from the adjustment of all pictures; "
        "default: the adjustment where its gates pass and the rows agree",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the chain and return the exit status: 3 if a gate failed."""
    from calib.cli.console import faults_only, summary, summary_json
    from calib.dataset.load import load_dataset
    from calib.stages.manifest import finished_before, run_fingerprint

    depths = tuple(arguments.depths) if arguments.depths else None
    if depths is not None and not depths[0] < depths[1]:
        raise UsageError("--depths: give two depths in mm, LOW < HIGH")
    interrupt_on(signal.SIGINT, signal.SIGTERM)
    dataset = load_dataset(arguments.dataset)
    out = run_folder(arguments.out, dataset.root, force=arguments.force)
    settings = {"seed": arguments.seed, "depths_mm": depths, "method": arguments.method}
    if finished_before(out, run_fingerprint(dataset.sha256, settings)):
        if not (arguments.quiet or arguments.json):
            print(f"{harmless(str(out))}: up to date, nothing has changed")
    else:
        _note_replaced(out, seed=arguments.seed)
        _run_chain(dataset, out, settings, quiet=arguments.quiet)
    if arguments.json:
        document, passed = summary_json(out)
        print_json(document)
        return DONE if passed else GATE_FAILED
    text, passed = faults_only(out) if arguments.quiet else summary(out)
    if text:
        print(text)
    return DONE if passed else GATE_FAILED


def _note_replaced(out: Path, *, seed: int) -> None:
    """Say where a finished run of another seed, and its certificate, will be replaced."""
    from calib.stages.run_folder import json_object

    found = json_object(out / "calibration.json")
    before = None if found is None else found.get("seed")
    if isinstance(before, int) and before != seed:
        say(
            f"calib: note: {harmless(str(out))} holds a run of seed {before}; it is replaced, with "
            "its certificate: give another --out to keep both"
        )


def _run_chain(dataset: Dataset, out: Path, settings: dict[str, Any], *, quiet: bool) -> None:
    from calib.chain.calibrate import Options, calibrate
    from calib.cli.console import Console

    console = Console(quiet=quiet)
    try:
        calibrate(
            dataset,
            out,
            Options(**settings),
            announce=console.announce,
            progress=console.progress,
            command=shlex.join(["calib", *sys.argv[1:]]),
        )
    finally:
        console.close()
