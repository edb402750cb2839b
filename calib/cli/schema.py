"""`calib schema`: the JSON Schema of a file, for editors and programs."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

FILES = ("dataset", "calibration", "rig")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "of", metavar="WHAT", choices=FILES, help="dataset.toml, calibration.json or rig.toml"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the schema."""
    sys.stdout.write(json.dumps(_schema(arguments.of), indent=1) + "\n")
    return 0


def _schema(file: str) -> dict[str, Any]:
    if file == "dataset":
        from calib.dataset.manifest import Manifest

        schema = Manifest.model_json_schema()
    elif file == "rig":
        from calib.rig.settings import rig_schema

        schema = rig_schema()
    else:
        from calib.document.calibration import Document

        schema = Document.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema
