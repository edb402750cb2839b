"""What the folder of a run holds, and how to know that a run wrote it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calib.core.limited import read_limited

MANIFEST = "manifest.json"
LIMIT_BYTES = 1_000_000

RECORD = ".stages/dataset.json"
"""Whose run it is, written when a run begins."""

FORMER = ".stages/outputs.json"
"""Where versions before the manifest kept their digests: what they wrote is taken as it is."""

ALWAYS = ("calibration.json", "results.h5", "report.html", "run.toml")
"""What every run writes."""

SOMETIMES = (
    "certificate.html", "certificate.pdf", "certificate.xml", "corners.vnl",
    "c1.yaml", "c2.yaml", "c1.cameramodel", "c2.cameramodel",
)  # fmt: skip
"""What a run writes if its dataset allows."""


def json_object(path: Path) -> dict[str, Any] | None:
    """Return a JSON object; None if there is none that can be read."""
    try:
        document = json.loads(read_limited(path, LIMIT_BYTES, regular=True).decode("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def wrote_run(folder: Path) -> bool:
    """Return whether a run wrote the outputs in a folder, or has begun and written none.

    The manifest is written before the first output, so one that no manifest knows is not the run's.
    """
    document = json_object(folder / MANIFEST)
    if document is not None and "complete" in document:
        return True
    former, record = json_object(folder / FORMER), json_object(folder / RECORD)
    if former is None and (record is None or "from_here" not in record):
        return False
    files = (former or {}).get("files")
    known = files if isinstance(files, dict) else {}
    names = (name for name in (MANIFEST, *ALWAYS, *SOMETIMES) if name not in known)
    return not any((folder / name).exists() or (folder / name).is_symlink() for name in names)
