"""Folders of finished runs as they are now, read only where their files have changed.

A file's stamp is its device, inode, size and times; whoever writes it, or puts another in its
place, changes the stamp. One that is so young that a later change might show the same time is not
relied on (as git does: "racily clean").
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from calib.core.errors import InputError
from calib.history.entry import FILES, RESULT, GatesFailedError, IndexEntry, read_entry
from calib.stages.run_folder import MANIFEST

YOUNG_S = 2.5
"""File systems in use keep times to within 2 s."""

Stamp: TypeAlias = str
"""Of the files of a folder, as text; empty where it cannot be relied on."""


@dataclass(frozen=True)
class FolderSeen:
    """What a folder held.

    Parameters
    ----------
    stamp
        Of its files before they were read.
    entry
        The calibration; None if it cannot be read, or is in the index as it is.
    fault
        Why it is not taken; empty if it is.
    has_failed
        Whether that is because its gates failed, and no fault of its files.
    is_closed
        Whether it cannot even be listed: what is below it is not known.
    """

    stamp: Stamp
    entry: IndexEntry | None
    fault: str = ""
    has_failed: bool = False
    is_closed: bool = False


def refuse_missing(roots: Sequence[Path]) -> None:
    """Raise if one of them is not a folder: nothing below it would be called deleted."""
    for root in roots:
        if not root.is_dir():
            raise InputError.single(
                where=str(root), what="is not a folder", remedy="give folders with finished runs"
            )


def calibrations_below(roots: Sequence[Path]) -> tuple[list[Path], dict[str, str]]:
    """Return the folders with a calibration.json at or below `roots`, sorted, each once.

    Beside them the folders that cannot be listed, each with the reason.
    """
    found: set[Path] = set()
    closed: dict[str, str] = {}

    def note(error: OSError) -> None:
        closed[str(error.filename)] = f"cannot be listed ({error.strerror or error})"

    for root in roots:
        for at, folders, files in os.walk(root.resolve(), onerror=note):
            folders[:] = [name for name in folders if not name.startswith(".")]
            if RESULT in files:
                found.add(Path(at))
    return sorted(found), closed


def scan(
    roots: Sequence[Path],
    known: Mapping[str, FolderSeen],
    *,
    now: Callable[[], float] = time.time,
) -> dict[str, FolderSeen]:
    """Return what the folders with calibrations at or below `roots` hold, by path.

    Parameters
    ----------
    known
        What was seen before; a folder whose stamp is the same is not read again.
    """
    folders, closed = calibrations_below(roots)
    found = {
        path: FolderSeen("", None, why, is_closed=True) for path, why in sorted(closed.items())
    }
    for folder in folders:
        path = str(folder)
        try:
            path.encode()
        except UnicodeEncodeError:  # the index states paths, as text
            found[path] = FolderSeen("", None, "is no name in UTF-8: rename it")
            continue
        stamp = _stamp(folder, now())
        before = known.get(path)
        found[path] = before if before and stamp and before.stamp == stamp else _read(folder, stamp)
    return found


def _read(folder: Path, stamp: Stamp) -> FolderSeen:
    try:
        return FolderSeen(stamp, read_entry(folder))
    except ValueError as error:
        return FolderSeen(stamp, None, str(error), isinstance(error, GatesFailedError))


def _stamp(folder: Path, now: float) -> Stamp:
    parts = []
    for file in _files(folder):
        try:
            s = file.stat()
        except OSError:
            parts.append("-")
            continue
        if max(s.st_mtime, s.st_ctime) > now - YOUNG_S:
            return ""
        parts.append(f"{s.st_dev}.{s.st_ino}.{s.st_size}.{s.st_mtime_ns}.{s.st_ctime_ns}")
    return " ".join(parts)


def _files(folder: Path) -> list[Path]:
    """Return what decides whether a folder is taken: where a file is a link, its run's manifest."""
    own = [folder / name for name in FILES]
    elsewhere = {file.resolve().parent / MANIFEST for file in own if file.is_symlink()}
    return own + sorted(elsewhere - set(own))
