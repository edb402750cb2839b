"""Which files belong to which run: lets a second run on unchanged input stop at once."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from calib.core.mrcal_python import mrcal_identity
from calib.stages.fingerprint import digest, whole_code
from calib.stages.provenance import direct_packages

LEDGER = Path(".stages") / "outputs.json"


def run_fingerprint(dataset_sha256: str, options: Mapping[str, Any]) -> str:
    """Return what all outputs of a run depend on: data, options, code, package versions."""
    return digest(dataset_sha256, dict(options), whole_code(), direct_packages(), mrcal_identity())


def finished_before(out: Path, fingerprint: str) -> bool:
    """Return whether the folder holds all files of a run with this fingerprint, untouched."""
    try:
        ledger = json.loads((out / LEDGER).read_text(encoding="utf-8"))
        known: Mapping[str, str] = ledger["files"]
        return bool(ledger["fingerprint"] == fingerprint) and all(
            _hash(out / name) == value for name, value in known.items()
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def ledger_text(out: Path, fingerprint: str, names: Iterable[str]) -> str:
    """Return the ledger of the files `names` in `out`."""
    files = {name: _hash(out / name) for name in names}
    return json.dumps({"fingerprint": fingerprint, "files": files}, indent=1)


def _hash(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()
