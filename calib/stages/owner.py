"""Whose run a folder holds: the run of another dataset is not replaced."""

from __future__ import annotations

import json
import os
from pathlib import Path

from calib.core.errors import UsageError
from calib.stages.store import CACHE, write_bytes

OWNER = Path(CACHE) / "dataset.json"


def claim(out: Path, *, root: Path, sha256: str) -> None:
    """Make the folder of a run that of a dataset.

    It is the same dataset if it lies where it lay, also seen from the run (both were moved
    together), or if its files have not changed.

    Parameters
    ----------
    out
        Folder of the run.
    root, sha256
        Folder of the dataset and the digest of its files.

    Raises
    ------
    UsageError
        If the folder holds the run of another dataset.
    """
    folder = out.resolve()
    mine = {
        "folder": str(root),
        "from_here": os.path.relpath(root, folder),
        "sha256": sha256,
    }
    theirs = _owner(out / OWNER)
    if theirs and not any(theirs.get(key) == value for key, value in mine.items()):
        other = out.with_name(f"{root.parent.name}-{root.name}")
        raise UsageError(
            f"{out}: holds the run of another dataset ({theirs.get('folder')}), whose calibration "
            f"and certificate would be lost; choose another folder: --out {other} "
            f"(make: OUT={other}), or delete {out} first"
        )
    write_bytes(out / OWNER, (json.dumps(mine, indent=1) + "\n").encode())


def _owner(path: Path) -> dict[str, str]:
    """Return what the record says; nothing if there is none that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
