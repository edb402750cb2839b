"""Where a result comes from: versions, commit, command, times."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import requires
from pathlib import Path

from calib.core.version import __version__
from calib.stages.fingerprint import package_version

DISTRIBUTION = "active-gazing-calib"
"""Name of this package on the index; `calib` is taken there."""


@dataclass(frozen=True)
class Provenance:
    """How a run was made.

    Parameters
    ----------
    finished
        UTC, ISO 8601.
    version, commit
        Of calib; the commit is "unknown" outside a checkout and ends in "+" with local changes.
    python, system
        Interpreter and machine.
    packages
        Versions of the packages used directly, by name.
    command
        As typed.
    durations_s
        Of the stages that ran, s.
    """

    finished: str
    version: str
    commit: str
    python: str
    system: str
    packages: Mapping[str, str]
    command: str
    durations_s: Mapping[str, float]


def direct_packages() -> dict[str, str]:
    """Return the versions of the packages that calib declares, by name."""
    lines = [line for line in requires(DISTRIBUTION) or [] if "extra ==" not in line]
    names = [line.split(";")[0] for line in lines]
    bare = sorted({_bare(name) for name in names})
    return {name: version for name in bare if (version := package_version(name)) is not None}


def _bare(requirement: str) -> str:
    end = next((i for i, c in enumerate(requirement) if c in "<>=!~[ ("), len(requirement))
    return requirement[:end]


def git_commit() -> str:
    """Return the commit of the checkout that this code runs from, or "unknown"."""
    here = Path(__file__).resolve().parent
    try:
        head = _git(here, "rev-parse", "--short=12", "HEAD")
        changed = _git(here, "status", "--porcelain", "--untracked-files=no", "--", ".")
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return head + ("+" if changed else "")


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    done = subprocess.run(  # noqa: S603 - a fixed command on our own folder, no shell
        command,
        capture_output=True,
        encoding="utf-8",
        errors="backslashreplace",
        check=True,
        timeout=10,
    )
    return done.stdout.strip()


def provenance(
    *, command: str, durations_s: Mapping[str, float], beside: Mapping[str, str] | None = None
) -> Provenance:
    """Return the provenance of a run that has just finished.

    Parameters
    ----------
    beside
        Versions of what was used without being a package of this environment, by name.
    """
    return Provenance(
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        commit=git_commit(),
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        packages=dict(sorted((direct_packages() | dict(beside or {})).items())),
        command=command,
        durations_s=dict(durations_s),
    )
