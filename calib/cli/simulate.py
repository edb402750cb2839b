"""`calib simulate`: a dataset with known truth."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from functools import partial

from calib.cli.arguments import add_output, natural, whole
from calib.cli.voice import add_voice
from calib.core.errors import UsageError, harmless
from calib.stages.output_guard import NEW_FOLDER

MOST_ROWS = 1_000_000
"""What a table of a dataset may hold."""

LARGEST_SETTING = 1e6
"""Of a parameter: a kilometre of baseline, or as many radians, is a slip of the keyboard."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    rows = partial(whole, least=0, most=MOST_ROWS)
    add_output(parser, "out", kind=NEW_FOLDER, metavar="OUT", help="folder to make")
    parser.add_argument("--seed", type=natural, required=True, metavar="N")
    parser.add_argument("--images", action="store_true", help="render the whole rig's pictures")
    parser.add_argument(
        "--c2", choices=("right", "left"), default="right", help="side of C1; default: right"
    )
    parser.add_argument(
        "--c1-field",
        type=float,
        metavar="DEG",
        help="wide (equidistant) lens of C1 with this field along the diagonal, with --images",
    )
    parser.add_argument("--model", default="axis-offset", help="default: axis-offset")
    parser.add_argument("--rows", type=rows, default=14, metavar="N", help="default: 14")
    parser.add_argument("--validation-rows", type=rows, default=10, metavar="N", help="default: 10")
    parser.add_argument(
        "--outliers", type=float, default=0.0, metavar="SHARE", help="of rows with gross errors"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[=VALUE]",
        help="make a mistake that the diagnosis should find: docs/troubleshooting.md has them",
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="fix a parameter"
    )
    add_voice(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the dataset and say so."""
    from calib.cli.console import Console
    from calib.simulate.contents import SimulationOptions
    from calib.simulate.dataset import simulate_dataset

    options = SimulationOptions(
        seed=arguments.seed,
        model=arguments.model,
        rows=arguments.rows,
        validation_rows=arguments.validation_rows,
        images=arguments.images,
        is_left=arguments.c2 == "left",
        c1_field_deg=arguments.c1_field,
        outlier_share=arguments.outliers,
        faults=dict(_fault(text) for text in arguments.fault),
        fixed=_each_once(map(_assignment, arguments.set)),
    )
    console = Console(quiet=arguments.quiet)
    try:
        simulate_dataset(arguments.out, options, progress=partial(console.progress, "images"))
    finally:
        console.close()
    if arguments.quiet:
        return 0
    print(f"{harmless(str(arguments.out))}: written, with its truth in truth.json")
    return 0


def _each_once(assignments: Iterable[tuple[str, float]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in assignments:
        if name in found:
            raise UsageError(f"--set {name}: is given twice; give it once")
        found[name] = value
    return found


def _fault(text: str) -> tuple[str, float | None]:
    name, given, value = text.partition("=")
    try:
        return name, float(value) if given else None
    except ValueError:
        raise UsageError(f"--fault {text}: give NAME or NAME=VALUE, as reading-step=0.2") from None


def _assignment(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise UsageError(f"--set {text}: give NAME=VALUE, for example axis_z_mm=-20") from None
    if math.isfinite(number) and abs(number) > LARGEST_SETTING:
        raise UsageError(f"--set {text}: lengths are in mm, angles in rad; give it in these units")
    return name, number
