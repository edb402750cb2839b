"""Index of calibrations by rig: a SQLite file made from the folders, which remain the truth.

The index can be deleted and made again at any time. Each update is one transaction in write-ahead
logging, so that writers at work together wait for each other and a killed one leaves the index as
it was. Folders are read before the transaction, which may take long, and looked at once more
within it, where only those that have changed meanwhile are read again: what is written is how
the folders were under the lock, whoever else writes.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.errors import InputError, UsageError
from calib.history.entry import RESULT, IndexEntry, one_spelling
from calib.history.scan import FolderSeen, refuse_missing, scan

WAIT_S = 60.0
"""For another writer; a transaction of 10,000 calibrations takes a tenth of it."""

LAYOUT = 4
"""Version of the tables; an index of another is made anew."""

APPLICATION = 0x43414C49
"""Marks a database as such an index (``PRAGMA application_id``): "CALI" in ASCII."""

_TABLE = """
CREATE TABLE IF NOT EXISTS calibration (
  path TEXT PRIMARY KEY, sha256 TEXT NOT NULL, rig TEXT NOT NULL, date TEXT NOT NULL,
  dataset TEXT NOT NULL, model TEXT NOT NULL, near_mm REAL NOT NULL, far_mm REAL NOT NULL,
  parameters TEXT NOT NULL, dataset_sha256 TEXT NOT NULL, finished TEXT NOT NULL,
  has_serial INTEGER NOT NULL) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS by_rig ON calibration (rig, date);
CREATE TABLE IF NOT EXISTS stamp (path TEXT PRIMARY KEY, stamp TEXT NOT NULL) WITHOUT ROWID;
"""
"""`stamp` spares reading files again that are as they were; it says nothing of calibrations."""


@dataclass(frozen=True)
class Indexed:
    """What indexing has found.

    Parameters
    ----------
    calibrations
        Number in the folders.
    added, changed, deleted
        Paths.
    moved
        Old and new path.
    unreadable
        Path and reason.
    failed
        Path and reason of those that must not be used.
    """

    calibrations: int
    added: tuple[str, ...]
    changed: tuple[str, ...]
    deleted: tuple[str, ...]
    moved: tuple[tuple[str, str], ...]
    unreadable: tuple[tuple[str, str], ...]
    failed: tuple[tuple[str, str], ...] = ()


@contextmanager
def _opened(index: Path, *, options: str = "") -> Iterator[sqlite3.Connection]:
    try:
        name = f"{index.absolute().as_uri()}{options}"
        with closing(
            sqlite3.connect(name, timeout=WAIT_S, isolation_level=None, uri=True)
        ) as connection:
            yield connection
    except sqlite3.DatabaseError as error:
        raise UsageError(
            f"{index}: cannot be used ({error}); name another file with --index: an index is made "
            "anew from the folders of the runs"
        ) from error


@contextmanager
def _reading(index: Path) -> Iterator[sqlite3.Connection]:
    """Open an index that is there, also one that may only be read."""
    if not index.is_file():
        raise InputError.single(
            where=str(index), what="is not there", remedy="make it with calib history index DIR"
        )
    # Write-ahead logging has readers write beside the file, unless nothing is in the log and they
    # say that nobody else writes.
    log = Path(f"{index}-wal")
    shared = os.access(index.absolute().parent, os.W_OK) or (log.exists() and log.stat().st_size)
    with _opened(index, options="" if shared else "?immutable=1") as connection:
        yield connection


def _refuse_foreign(connection: sqlite3.Connection, index: Path) -> None:
    """Raise if a database is not empty and is no index of calibrations."""
    (mark,) = connection.execute("PRAGMA application_id").fetchone()
    (objects,) = connection.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()
    if mark != APPLICATION and (mark or objects):
        raise UsageError(
            f"{index}: is a database of another origin; name another file with --index"
        )


def _prepare(connection: sqlite3.Connection) -> None:
    connection.execute(f"PRAGMA application_id={APPLICATION}")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")


def update(index: Path, roots: Sequence[Path]) -> Indexed:
    """Bring the index up to what the folders hold, and return what has changed.

    Entries of folders outside `roots` are kept, as these may be on a disk that is not mounted,
    unless their calibration has moved into `roots`.

    Raises
    ------
    InputError
        If one of `roots` is not a folder.
    """
    refuse_missing(roots)
    with _opened(index) as connection:
        _refuse_foreign(connection, index)
        _prepare(connection)
        first = scan(roots, _known(connection))
        connection.execute("BEGIN IMMEDIATE")
        _make_tables(connection)
        # Another writer may have read the folders later than this one did and been faster.
        known = _known(connection)
        seen = scan(roots, known | {p: s for p, s in first.items() if s.entry or s.fault})
        before = dict(connection.execute("SELECT path, sha256 FROM calibration"))
        entries = [s.entry for s in seen.values() if s.entry is not None]
        bad = {path for path, s in seen.items() if s.fault}
        failed = [(p, s.fault) for p, s in seen.items() if s.fault and s.has_failed]
        unreadable = [(p, s.fault) for p, s in seen.items() if s.fault and not s.has_failed]
        now = {p: before[p] for p, s in seen.items() if not (s.entry or s.fault)}
        now |= {e.path: e.sha256 for e in entries}
        closed = [Path(path) for path, s in seen.items() if s.is_closed]
        bad |= {p for p in before if any(Path(p).is_relative_to(c) for c in closed)}
        gone = _gone(before, roots, now) | (bad & set(before))
        connection.executemany("DELETE FROM calibration WHERE path=?", [(p,) for p in gone])
        connection.executemany("DELETE FROM stamp WHERE path=?", [(p,) for p in gone])
        connection.executemany(
            "INSERT OR REPLACE INTO calibration VALUES (?,?,?,?,?,?,?,?,?,?,?,?)",
            map(_row, entries),
        )
        connection.executemany(
            "INSERT OR REPLACE INTO stamp VALUES (?,?)",
            [(e.path, seen[e.path].stamp) for e in entries],
        )
        connection.execute("COMMIT")
    found = _differences(before, now, gone - bad, unreadable)
    return replace(found, failed=tuple(failed))


def _make_tables(connection: sqlite3.Connection) -> None:
    if not _is_current(connection):
        connection.execute("DROP TABLE IF EXISTS calibration")
        connection.execute("DROP TABLE IF EXISTS stamp")
        connection.execute(f"PRAGMA user_version={LAYOUT}")
    for statement in _TABLE.split(";\n"):
        connection.execute(statement)


def _is_current(connection: sqlite3.Connection) -> bool:
    (layout,) = connection.execute("PRAGMA user_version").fetchone()
    return bool(layout == LAYOUT)


def _known(connection: sqlite3.Connection) -> dict[str, FolderSeen]:
    """Return the folders that are in the index as they were when their stamp was taken."""
    if not _is_current(connection):
        return {}
    rows = connection.execute("SELECT path, stamp FROM stamp JOIN calibration USING (path)")
    return {path: FolderSeen(stamp, None) for path, stamp in rows}


def _gone(before: dict[str, str], roots: Sequence[Path], now: dict[str, str]) -> set[str]:
    """Return the paths whose calibration is no longer there."""
    tops, here = [root.resolve() for root in roots], set(now.values())
    missing = [p for p in before if p not in now and not _may_be_there(Path(p) / RESULT)]
    return {p for p in missing if before[p] in here or any(Path(p).is_relative_to(t) for t in tops)}


def _may_be_there(file: Path) -> bool:
    try:
        return file.is_file()
    except OSError:  # nobody may look
        return True


def _row(e: IndexEntry) -> tuple[str | float, ...]:
    parameters = json.dumps([e.names, e.values.tolist(), e.covariance.tolist()])
    head = (e.path, e.sha256, e.rig, e.date, e.dataset, e.model, *e.range_mm)
    return *head, parameters, e.dataset_sha256, e.finished, e.has_serial


def _differences(
    before: dict[str, str],
    now: dict[str, str],
    gone: set[str],
    unreadable: Sequence[tuple[str, str]],
) -> Indexed:
    new = {now[path]: path for path in now if path not in before}
    moved = {p: new[before[p]] for p in gone if before[p] in new}
    arrived = set(moved.values())
    return Indexed(
        calibrations=len(now),
        added=tuple(sorted(p for p in now if p not in before and p not in arrived)),
        changed=tuple(sorted(p for p, sha256 in now.items() if before.get(p, sha256) != sha256)),
        deleted=tuple(sorted(gone - set(moved))),
        moved=tuple(sorted(moved.items())),
        unreadable=tuple(unreadable),
    )


def rigs(index: Path) -> list[tuple[str, int, str]]:
    """Return each rig's serial number, number of calibrations and date of the last, sorted."""
    with _reading(index) as connection:
        return connection.execute(
            "SELECT rig, COUNT(DISTINCT dataset_sha256), MAX(date) FROM calibration "
            "GROUP BY rig ORDER BY rig"
        ).fetchall()


def history(index: Path, rig: str) -> list[IndexEntry]:
    """Return a rig's calibrations in time order; of runs of one dataset the one finished last.

    A dataset calibrated again, with another seed or version, tells nothing new of the rig.

    Raises
    ------
    InputError
        If the rig is not in the index.
    """
    with _reading(index) as connection:
        rows = connection.execute(
            "SELECT * FROM calibration WHERE rig=? ORDER BY date, finished, path",
            (one_spelling(rig),),
        ).fetchall()
    if not rows:
        raise InputError.single(
            where=str(index), what=f"has no rig {rig!r}",
            remedy="list the rigs with calib history show",
        )  # fmt: skip
    last: dict[str, IndexEntry] = {}
    for e in sorted(map(_entry, rows), key=lambda e: (e.finished, e.path)):
        last[e.dataset_sha256] = e
    return sorted(last.values(), key=lambda e: (e.date, e.finished, e.path))


def _entry(row: tuple[Any, ...]) -> IndexEntry:
    path, sha256, rig, day, dataset, model, near, far, parameters, of, finished, named = row
    names, values, covariance = json.loads(parameters)
    return IndexEntry(
        path=path,
        sha256=sha256,
        rig=rig,
        date=day,
        dataset=dataset,
        model=model,
        range_mm=(near, far),
        names=tuple(names),
        values=np.array(values),
        covariance=np.array(covariance),
        dataset_sha256=of,
        finished=finished,
        has_serial=bool(named),
    )
