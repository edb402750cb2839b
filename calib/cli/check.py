"""`calib check`: every problem of a dataset."""

from __future__ import annotations

import argparse

from calib.cli.arguments import add_input
from calib.cli.voice import add_voice, print_json, warn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "dataset", metavar="DATASET", help="folder with dataset.toml")
    add_voice(parser, json_help="print problems, warnings and what was found as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print what the dataset holds; its problems are raised."""
    from calib.dataset.load import load_dataset

    dataset = load_dataset(arguments.dataset)
    parts = {
        "gaze rows": dataset.gaze,
        "validation rows": dataset.validation,
        "sweep images": dataset.sweep,
        "lengths": dataset.lengths,
        "returns": dataset.returns,
        "stereo pairs": dataset.stereo_pairs,
        "images of C1": dataset.images.get("c1"),
        "images of C2": dataset.images.get("c2"),
    }
    if arguments.json:
        print_json(
            {
                "name": dataset.manifest.name,
                "problems": [],
                "warnings": dataset.warnings,
                "found": {name: len(part) for name, part in parts.items() if part},
            }
        )
        return 0
    for warning in dataset.warnings:
        warn(warning)
    if arguments.quiet:
        return 0
    found = ", ".join(f"{len(part)} {name}" for name, part in parts.items() if part)
    print(f"{dataset.manifest.name}: no problems; {found or 'no rows and no images'}")
    return 0
