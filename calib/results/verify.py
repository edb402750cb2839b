"""Verifies a run's files: by its manifest, and the certificate by the calibration it states."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from calib.core.errors import InputError, Problem
from calib.core.seal import is_edited
from calib.stages.manifest import AGAIN, faults
from calib.stages.run_folder import MANIFEST

CALIBRATION = "calibration.json"
STATING = ("certificate.html", "certificate.xml")
"""Forms of the certificate that state the digest as text; the manifest vouches for the PDF."""


@dataclass(frozen=True)
class Verified:
    """What was found.

    Parameters
    ----------
    problems
        None if all is well.
    lines
        What was compared, to be printed.
    files
        Number of files in the manifest.
    """

    problems: tuple[Problem, ...]
    lines: tuple[str, ...]
    files: int


def verify(folder: Path) -> Verified:
    """Return whether the outputs in a folder are those of one run.

    Raises
    ------
    InputError
        If it is no folder of a run.
    """
    if not (folder / MANIFEST).is_file():
        remedy = "give the folder of a finished run, such as reports/NAME"
        raise InputError.single(where=str(folder), what=f"holds no {MANIFEST}", remedy=remedy)
    problems = list(faults(folder))
    if problems:
        return Verified(tuple(problems), (), 0)
    names = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["files"]
    lines = []
    data = (folder / CALIBRATION).read_bytes()
    digest = sha256(data).hexdigest()
    lines.append(f"{CALIBRATION}: SHA-256 {digest}")
    document = json.loads(data)
    if is_edited(document):
        problems.append(Problem(str(folder / CALIBRATION), "was edited", AGAIN))
    for name in STATING:
        if name not in names:
            continue
        if digest not in (folder / name).read_text(encoding="utf-8"):
            what = f"does not certify the {CALIBRATION} beside it"
            problems.append(Problem(str(folder / name), what, AGAIN))
        else:
            lines.append(f"{name}: certifies this {CALIBRATION}")
    failed = [gate["name"] for gate in document.get("gates", []) if not gate["passed"]]
    if failed:
        lines.append(f"{CALIBRATION}: gates failed ({', '.join(failed)}): must not be used")
    return Verified(tuple(problems), tuple(lines), len(names))
