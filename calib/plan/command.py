"""`calib plan`: where to put the next targets."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder with dataset.toml")
    parser.add_argument(
        "--depth", type=_positive, nargs="+", required=True, metavar="Z",
        help="depths, mm, at which u(z) matters",
    )  # fmt: skip
    parser.add_argument(
        "--rows", type=_count, default=6, metavar="N", help="targets to come; default: 6"
    )
    parser.add_argument(
        "--targets", type=_positive, nargs=2, metavar=("NEAR", "FAR"),
        help="depths, mm, at which targets can be put; default: from the nearest to the farthest "
        "of the rows and the asked depths",
    )  # fmt: skip
    parser.add_argument(
        "--yaw", type=_positive, nargs=2, default=(40.0, 140.0), metavar=("LOW", "HIGH"),
        help="reachable readings, deg; default: 40 140",
    )  # fmt: skip
    parser.add_argument(
        "--model", default="axis-offset", help="model to learn; default: axis-offset"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the random targets")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="picture, .svg or .png; default: none"
    )


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 100:
        raise ValueError
    return value


def run(arguments: argparse.Namespace) -> int:
    """Print the advice, write its picture, return the exit status."""
    import numpy as np

    from calib.dataset.load import load_dataset
    from calib.plan.advise import advise
    from calib.plan.output import picture, picture_format, text
    from calib.plan.prepare import prepare
    from calib.store import write_bytes

    kind = None if arguments.out is None else picture_format(arguments.out)
    dataset = load_dataset(arguments.dataset)
    asked = np.array(sorted(set(arguments.depth)))
    start = prepare(
        dataset,
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
    sys.stdout.write(text(advice))
    if kind is not None:
        write_bytes(arguments.out, picture(advice, start.points_mm, kind=kind))
        sys.stdout.write(f"picture: {arguments.out}\n")
    return 0
