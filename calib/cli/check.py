"""`calib check`: every problem of a dataset."""

from __future__ import annotations

import argparse

from calib.cli.arguments import add_input


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(parser, "dataset", metavar="DATASET", help="folder with dataset.toml")


def run(arguments: argparse.Namespace) -> int:
    """Print what the dataset holds; its problems are raised."""
    from calib.dataset.load import load_dataset

    dataset = load_dataset(arguments.dataset)
    for warning in dataset.warnings:
        print(f"warning: {warning}")
    parts = {
        "gaze rows": dataset.gaze,
        "validation rows": dataset.validation,
        "sweep images": dataset.sweep,
        "lengths": dataset.lengths,
        "stereo pairs": dataset.stereo_pairs,
        "images of C1": dataset.images.get("c1"),
        "images of C2": dataset.images.get("c2"),
    }
    found = ", ".join(f"{len(part)} {name}" for name, part in parts.items() if part)
    print(f"{dataset.manifest.name}: no problems; {found or 'no rows and no images'}")
    return 0
