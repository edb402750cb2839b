"""Finished rigs on disk: one JSON line each, only ever appended, so that a study can go on.

A line is written by one system call and synchronised; a line cut short by a crash is dropped when
the journal is opened again. Lines of other code, settings or seeds stay in the file unused.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from calib.core.errors import UsageError

Record = dict[str, Any]

KEY = "key"
"""What a record's outcome depends on besides its number: see `calib.study.tasks`."""


class Journal:
    """The open journal of one study."""

    def __init__(self, path: Path, handle: int) -> None:
        self._path = path
        self._handle = handle

    def add(self, record: Record) -> None:
        """Append a finished rig.

        Raises
        ------
        UsageError
            If the disk does not take it.
        """
        line = json.dumps(record, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        try:
            written = os.write(self._handle, line)
            os.fsync(self._handle)
        except OSError as error:
            raise _unusable(self._path, error) from error
        if written != len(line):
            raise UsageError(f"{self._path}: the disk is full; free space and run again")

    def records(self) -> dict[tuple[str, int], Record]:
        """Return the finished rigs by key and number."""
        found = {}
        for line in self._path.read_bytes().splitlines():
            try:
                record = json.loads(line)
                found[record[KEY], record["number"]] = record
            except (ValueError, KeyError, TypeError):
                continue
        return found


def _unusable(path: Path, error: OSError) -> UsageError:
    reason = error.strerror or str(error)
    return UsageError(f"{path}: cannot be used ({reason}); free space or choose another --out")


@contextmanager
def open_journal(path: Path) -> Iterator[Journal]:
    """Open the journal at `path` for one study at a time, without half lines.

    Raises
    ------
    UsageError
        If another study uses it, or it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError as error:
        raise _unusable(path, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UsageError(
                f"{path}: another study is writing it; wait for it or choose another --out"
            ) from error
        content = path.read_bytes()
        os.ftruncate(handle, content.rfind(b"\n") + 1)
        yield Journal(path, handle)
    finally:
        os.close(handle)
