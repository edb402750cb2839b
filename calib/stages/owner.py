"""Whose run a folder holds: the run of another dataset is not replaced."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from calib.core.errors import UsageError
from calib.core.limited import read_limited
from calib.core.owner import Owner
from calib.stages.files import CACHE, write_bytes

LIMIT_BYTES = 1_000_000
OWNER = Path(CACHE) / "dataset.json"


def claim(out: Path, owner: Owner) -> None:
    """Make the folder of a run that of a dataset.

    It is the same dataset if its files have not changed; or if it lies where it lay, also seen from
    the run (both were moved together), and is not of another rig: other datasets are moved, or
    mounted, to the same place.

    Parameters
    ----------
    out
        Folder of the run.
    owner
        The dataset.

    Raises
    ------
    UsageError
        If the folder holds the run of another dataset.
    """
    folder = out.resolve()
    mine = {
        "folder": str(owner.root),
        "from_here": os.path.relpath(owner.root, folder),
        "sha256": owner.sha256,
        "name": owner.name,
        "serial": owner.serial,
    }
    theirs = _owner(out / OWNER)
    if theirs and not _is_same(theirs, mine):
        other = out.with_name(f"{owner.root.parent.name}-{owner.root.name}")
        whose = ", ".join(
            f"{key} {theirs[key]}" for key in ("folder", "name", "serial") if theirs.get(key)
        )
        raise UsageError(
            f"{out}: holds the run of another dataset ({whose}), whose calibration "
            f"and certificate would be lost; choose another folder: --out {other} "
            f"(make: OUT={other}), or delete {out} first"
        )
    write_bytes(out / OWNER, (json.dumps(mine, indent=1) + "\n").encode())


def _is_same(theirs: Mapping[str, str], mine: Mapping[str, str]) -> bool:
    """Return whether two records are of one dataset; what one of them lacks decides nothing."""
    if theirs.get("sha256") == mine["sha256"]:
        return True
    for key in ("serial", "name"):
        if theirs.get(key) and mine[key]:
            if theirs[key] != mine[key]:
                return False
            break
    return any(theirs.get(key) == mine[key] for key in ("folder", "from_here"))


def _owner(path: Path) -> dict[str, str]:
    """Return what the record says; nothing if there is none that can be read."""
    try:
        found = json.loads(read_limited(path, LIMIT_BYTES, regular=True))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
