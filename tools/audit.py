#!/usr/bin/env python3
"""Audits the locked packages, as far as that can be done without a vulnerability service.

Usage: tools/audit.py [LOCK...]

Checks that every locked package is pinned with its hashes, is installed at that version where its
marker applies, fits what the others require, and has a license this project may be shipped with.
pip itself refuses a file whose hash is not the locked one. Known vulnerabilities need a service:
`pip-audit -r requirements.lock`, where the network has it.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LOCKS = ("requirements.lock", "requirements-dev.lock")

COPYLEFT = re.compile(r"(?<!L)\bA?GPL|(?<!Lesser )General Public License", re.IGNORECASE)
"""GNU licenses that would bind what is linked with them; the Lesser one does not."""

ALLOWED = {
    "pyphen": "GPL, LGPL or MPL, as its user chooses",
}
"""Packages that would be refused, and why they are not."""

LEFT_OUT = {
    "scs": "a solver of 150 MB that cvxpy requires, does without, and no fit calls",
    "sparsediffpy": "of cvxpy, for problems that are not convex: 39 MB",
    "highspy": "a solver of 12 MB, as scs",
    "osqp": "a solver, as scs; 2 MB, and the next two",
    "joblib": "of osqp alone: 3 MB",
    "setuptools": "of osqp alone: 8 MB",
}
"""Packages that others require and the locks leave out, and why."""


def entries(lock: str) -> Iterator[tuple[Requirement, int]]:
    """Yield each requirement of a lock file with the number of its hashes."""
    text = re.sub(r"\\\n", " ", lock)
    for line in text.splitlines():
        stripped = line.split("#")[0].strip()
        if stripped:
            yield Requirement(stripped.split(" --hash")[0]), stripped.count("--hash=sha256:")


def faults(lock: str) -> Iterator[str]:
    """Yield what is wrong with a lock file and the packages it installed."""
    for requirement, hashes in entries(lock):
        name = canonicalize_name(requirement.name)
        pinned = [s for s in requirement.specifier if s.operator == "=="]
        if len(pinned) != 1 or requirement.url:
            yield f"{name}: not pinned to one version; run make lock"
            continue
        if hashes == 0:
            yield f"{name}: no hashes; run make lock"
        if requirement.marker is None or requirement.marker.evaluate():
            yield from _installed(name, pinned[0].version)


def _installed(name: str, wanted: str) -> Iterator[str]:
    try:
        found = distribution(name)
    except PackageNotFoundError:
        yield f"{name}: not installed; run make setup-dev"
        return
    if found.version != wanted:
        yield f"{name}: {found.version} is installed, {wanted} is locked; run make setup-dev"
    license_ = license_of(found)
    if COPYLEFT.search(license_) and name not in ALLOWED:
        yield f"{name}: license {license_!r}; find another package"


def left_out(line: str) -> bool:
    """Return whether `pip check` misses a package that is left out on purpose."""
    return any(f"requires {name}, which is not installed" in line for name in LEFT_OUT)


def license_of(package: Distribution) -> str:
    """Return what a package's metadata say of its license."""
    data = package.metadata
    expression = data.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [c for c in data.get_all("Classifier") or [] if c.startswith("License ::")]
    stated = (data.get("License") or "").split("\n")[0]
    return "; ".join([*classifiers, stated] if classifiers else [stated])


def main(arguments: list[str]) -> int:
    """Print every fault; return 1 if there is one."""
    root = Path(__file__).resolve().parents[1]
    locks = [Path(a) for a in arguments] or [root / name for name in LOCKS]
    found = [f"{lock.name}: {fault}" for lock in locks for fault in faults(lock.read_text("utf-8"))]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "check"]
    fits = subprocess.run(command, capture_output=True, text=True, check=False)
    if fits.returncode:
        found += [f"pip check: {line}" for line in fits.stdout.splitlines() if not left_out(line)]
    for fault in found:
        print(f"audit: {fault}", file=sys.stderr)
    if not found:
        print(f"audit: {', '.join(lock.name for lock in locks)}: nothing found")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
