"""`calib plan`: where to put the next targets."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.acceptance import DONE, GATE_FAILED, accept_failed, warn_of_failed
from calib.cli.arguments import add_input, add_output, depth, natural, number, run_folder, whole
from calib.cli.streams import say
from calib.cli.voice import add_voice, print_json
from calib.core.errors import harmless
from calib.stages.output_guard import RUN_FOLDER, OutputKind

if TYPE_CHECKING:
    from calib.dataset.contents import Dataset
    from calib.plan.prior_knowledge import PriorKnowledge


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "dataset", metavar="DATASET", help="folder with dataset.toml")
    parser.add_argument(
        "--depth", type=depth, nargs="+", required=True, metavar="Z",
        help="depths, mm, at which u(z) matters",
    )  # fmt: skip
    parser.add_argument(
        "--rows",
        type=partial(whole, least=1, most=MOST_ROWS),
        default=6,
        metavar="N",
        help="targets to come; default: 6",
    )
    parser.add_argument(
        "--targets", type=depth, nargs=2, metavar=("NEAR", "FAR"),
        help="depths, mm, at which targets can be put; default: from the nearest to the farthest "
        "of the rows and the asked depths",
    )  # fmt: skip
    parser.add_argument(
        "--yaw", type=_angle, nargs=2, default=(40.0, 140.0), metavar=("LOW", "HIGH"),
        help="reachable readings, deg; default: 40 140",
    )  # fmt: skip
    parser.add_argument(
        "--model", default="axis-offset", help="model to learn; default: axis-offset"
    )
    parser.add_argument(
        "--seed", type=natural, default=0, metavar="N",
        help="of the random targets beside the advice; default: 0",
    )  # fmt: skip
    add_output(
        parser, "--run", kind=RUN_FOLDER, metavar="DIR", dest="folder",
        help="with images: folder of `calib calibrate`, whose finished stages are used and kept "
        "up to date; default: reports/NAME",
    )  # fmt: skip
    add_output(
        parser, "--out", kind=PICTURE, metavar="FILE", help="picture, .svg or .png; default: none"
    )
    accept_failed(parser, "plan from rows or pictures whose gates failed")
    add_voice(parser, json_help="print targets and uncertainties as JSON")


SMALL_MM = 50.0
"""Depths below it were meant in metres."""


def _angle(text: str) -> float:
    return number(text, below=180.0, wanted="an angle between 0 and 180 deg")


PICTURE = OutputKind(is_folder=False, marks=(b"calib plan",))
"""Known by the creator in its metadata."""

MOST_ROWS = 100
"""Beyond them nobody walks, and the search takes minutes."""


def run(arguments: argparse.Namespace) -> int:
    """Print the advice, write its picture, return the exit status."""
    import numpy as np

    from calib.dataset.load import load_dataset
    from calib.plan.advise import advise
    from calib.plan.output import document, picture, picture_format, text
    from calib.plan.prepare import prepare
    from calib.stages.files import write_bytes

    kind = None if arguments.out is None else picture_format(arguments.out)
    dataset = load_dataset(arguments.dataset, rows_to_come=True)
    asked = np.array(sorted(set(arguments.depth)))
    if asked.max() < SMALL_MM:
        say(f"calib: note: --depth is in mm: {asked.max():g} mm is nearer than any target stands")
    start = prepare(
        dataset,
        _prior_knowledge(dataset, arguments.folder, force=arguments.force),
        model=arguments.model,
        asked_mm=asked,
        targets_mm=None if arguments.targets is None else tuple(sorted(arguments.targets)),
        yaw_deg=tuple(sorted(arguments.yaw)),
    )
    advice = advise(
        start.knowledge,
        start.field,
        start.noise,
        np.random.default_rng(arguments.seed),
        asked_mm=asked,
        between_mm=start.between_mm,
        count=arguments.rows,
    )
    if arguments.json:
        print_json(document(advice, start))
    elif not arguments.quiet:
        sys.stdout.write(text(advice, start))
    if kind is not None:
        write_bytes(arguments.out, picture(advice, start.points_mm, kind=kind))
        if not (arguments.json or arguments.quiet):
            sys.stdout.write(f"\npicture: {arguments.out}\n")
    refused = warn_of_failed(
        dataset.root, start.failed_gates, accepted=arguments.accept_failed, told=UNRELIABLE
    )
    return GATE_FAILED if refused else DONE


UNRELIABLE = "u(z) and targets rest on what failed; mend that first, or --accept-failed"


def note_broken(out: Path) -> None:
    """Say on stderr if the outputs of a run are not whole; its stages have digests of their own."""
    from calib.stages.manifest import faults
    from calib.stages.run_folder import MANIFEST

    if (out / MANIFEST).exists() and (found := faults(out)):
        print(
            f"calib: note: {harmless(str(found[0]))}; the plan uses none of its outputs, only "
            "finished stages, each by its own digest",
            file=sys.stderr,
        )


def _prior_knowledge(dataset: Dataset, folder: Path | None, *, force: bool) -> PriorKnowledge:
    """Return what is known of the dataset, by its images where it has some."""
    from calib.cli.console import Console
    from calib.core.errors import UsageError
    from calib.plan.prior_knowledge import from_images, from_tables, needs_images
    from calib.stages.store import Store

    if not needs_images(dataset):
        if folder is not None:
            raise UsageError("--run: the dataset has no images, nothing of a run is needed")
        return from_tables(dataset)
    console = Console()
    try:
        out = run_folder(folder, dataset.root, force=force)
        note_broken(out)
        return from_images(dataset, Store(out, console.announce, console.progress))
    finally:
        console.close()
