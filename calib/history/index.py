"""Index of calibrations by rig: a SQLite file made from the folders, which remain the truth.

The index can be deleted and made again at any time. Each folder indexed is one transaction in
write-ahead logging, so that writers at work together wait for each other and a killed one leaves
the index as it was.

Which rig a calibration belongs to: the serial number in calibration.json; without it the serial
number on the certificate beside it; without either the name of the dataset. When: the date of
calibration on the certificate (that of issue where none is stated); without a certificate the
date in run.toml.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from pydantic import BaseModel, ConfigDict, ValidationError

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, UsageError
from calib.core.seal import is_edited
from calib.geometry.parameters import INDEX

RESULT, CERTIFICATE, RUN = "calibration.json", "certificate.xml", "run.toml"

WAIT_S = 60.0
"""For another writer; a transaction of 10,000 calibrations takes a tenth of it."""

LAYOUT = 1
"""Version of the tables; an index of another is made anew."""

APPLICATION = 0x43414C49
"""Marks a database as such an index (``PRAGMA application_id``): "CALI" in ASCII."""

_TABLE = """
CREATE TABLE IF NOT EXISTS calibration (
  path TEXT PRIMARY KEY, sha256 TEXT NOT NULL, rig TEXT NOT NULL, date TEXT NOT NULL,
  dataset TEXT NOT NULL, model TEXT NOT NULL, near_mm REAL NOT NULL, far_mm REAL NOT NULL,
  parameters TEXT NOT NULL) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS by_rig ON calibration (rig, date);
"""

_DCC = {"dcc": "https://ptb.de/dcc"}
_SERIAL = (
    "//dcc:items/dcc:item/dcc:identifications/dcc:identification"
    "[dcc:name/dcc:content='serial number']/dcc:value/text()"
)


@dataclass(frozen=True)
class Entry:
    """One calibration in the index.

    Parameters
    ----------
    path
        Of its folder, absolute.
    sha256
        Of calibration.json.
    rig, date
        Serial number or what stands in for it, and ISO 8601 date.
    dataset, model
        Names of dataset and selected model.
    range_mm
        Calibrated depths.
    names, values, covariance
        Free parameters, shapes (p,), (p,), (p, p), in the units of calibration.json.
    """

    path: str
    sha256: str
    rig: str
    date: str
    dataset: str
    model: str
    range_mm: tuple[float, float]
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray


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
    """

    calibrations: int
    added: tuple[str, ...]
    changed: tuple[str, ...]
    deleted: tuple[str, ...]
    moved: tuple[tuple[str, str], ...]
    unreadable: tuple[tuple[str, str], ...]


class _Lenient(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class _Measurement(_Lenient):
    model: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    calibrated_depth_mm: tuple[float, float]


class _Dataset(_Lenient):
    name: str
    sha256: str


class _Rig(_Lenient):
    serial: str | None = None


class _Gate(_Lenient):
    name: str
    passed: bool


class _Document(_Lenient):
    format: int
    gates: tuple[_Gate, ...] = ()
    dataset: _Dataset
    measurement: _Measurement
    rig: _Rig | None = None


def read_entry(folder: Path) -> Entry:
    """Return the entry of one folder.

    Raises
    ------
    ValueError
        If its calibration cannot be read; the text says why.
    """
    try:
        content = (folder / RESULT).read_bytes()
        document = _Document.model_validate_json(content)
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ValueError(f"{where}: {first['msg']}") from error
    failed = [gate.name for gate in document.gates if not gate.passed]
    if failed:
        raise ValueError(f"must not be used: gate {', '.join(failed)} failed")
    if is_edited(json.loads(content)):
        raise ValueError("was edited after the run that wrote it")
    m = document.measurement
    values, covariance = np.array(m.values), np.array([list(row) for row in m.covariance])
    n = len(m.names)
    if document.format != 1:
        raise ValueError(f"format {document.format} is not known")
    if values.shape != (n,) or covariance.shape != (n, n) or not set(m.names) <= set(INDEX):
        raise ValueError("measurement: names, values and covariance do not belong together")
    serial, dated = _certified(folder, document.dataset.sha256)
    stated = document.rig.serial if document.rig is not None else None
    return Entry(
        path=str(folder),
        sha256=hashlib.sha256(content).hexdigest(),
        rig=stated or serial or document.dataset.name,
        date=_iso(dated or _finished(folder)),
        dataset=document.dataset.name,
        model=m.model,
        range_mm=m.calibrated_depth_mm,
        names=m.names,
        values=values,
        covariance=covariance,
    )


def _certified(folder: Path, dataset_sha256: str) -> tuple[str | None, str | None]:
    """Return serial number and date of the certificate beside a calibration, as far as stated."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    try:
        root = etree.parse(folder / CERTIFICATE, parser).getroot()
    except (OSError, etree.XMLSyntaxError):
        return None, None
    serials: Any = root.xpath(_SERIAL, namespaces=_DCC)
    dated = root.findtext(".//dcc:endPerformanceDate", namespaces=_DCC)
    found = str(serials[0]).strip() if serials else None
    # Where no serial number is stated, the certificate identifies the item by its dataset.
    return None if found in (None, "", "not stated", dataset_sha256) else found, dated


def _finished(folder: Path) -> str:
    try:
        run: dict[str, Any] = tomllib.loads((folder / RUN).read_text(encoding="utf-8"))
        return str(run["run"]["finished"])[:10]
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"no date: neither {CERTIFICATE} nor {RUN} states one") from None


def _iso(text: str) -> str:
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise ValueError(f"{text!r} is not a date") from None


@contextmanager
def _opened(index: Path) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(index, timeout=WAIT_S, isolation_level=None)) as connection:
            yield connection
    except sqlite3.DatabaseError as error:
        raise UsageError(
            f"{index}: cannot be used ({error}); name another file with --index: an index is made "
            "anew from the folders of the runs"
        ) from error


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


def calibrations_below(roots: Sequence[Path]) -> list[Path]:
    """Return the folders with a calibration.json at or below `roots`, sorted, each once."""
    found: set[Path] = set()
    for root in roots:
        if not root.is_dir():
            raise InputError.single(
                where=str(root), what="is not a folder", remedy="give folders with finished runs"
            )
        for at, folders, files in os.walk(root.resolve()):
            folders[:] = [name for name in folders if not name.startswith(".")]
            if RESULT in files:
                found.add(Path(at))
    return sorted(found)


def update(index: Path, roots: Sequence[Path]) -> Indexed:
    """Bring the index up to what the folders hold, and return what has changed.

    Entries of folders outside `roots` are kept, as these may be on a disk that is not mounted,
    unless their calibration has moved into `roots`.
    """
    entries, unreadable = [], []
    for folder in calibrations_below(roots):
        try:
            entries.append(read_entry(folder))
        except ValueError as error:
            unreadable.append((str(folder), str(error)))
    with _opened(index) as connection:
        _refuse_foreign(connection, index)
        _prepare(connection)
        connection.execute("BEGIN IMMEDIATE")
        if connection.execute("PRAGMA user_version").fetchone()[0] != LAYOUT:
            connection.execute("DROP TABLE IF EXISTS calibration")
            connection.execute(f"PRAGMA user_version={LAYOUT}")
        for statement in _TABLE.split(";\n"):
            connection.execute(statement)
        before = dict(connection.execute("SELECT path, sha256 FROM calibration"))
        bad = {path for path, _ in unreadable}
        gone = _gone(before, roots, entries) | (bad & set(before))
        connection.executemany("DELETE FROM calibration WHERE path=?", [(p,) for p in gone])
        connection.executemany(
            "INSERT OR REPLACE INTO calibration VALUES (?,?,?,?,?,?,?,?,?)", map(_row, entries)
        )
        connection.execute("COMMIT")
    return _differences(before, entries, gone - bad, unreadable)


def _gone(before: dict[str, str], roots: Sequence[Path], entries: Sequence[Entry]) -> set[str]:
    """Return the paths whose calibration is no longer there."""
    tops, here = [root.resolve() for root in roots], {e.sha256 for e in entries}
    missing = [p for p in before if not (Path(p) / RESULT).is_file()]
    return {p for p in missing if before[p] in here or any(Path(p).is_relative_to(t) for t in tops)}


def _row(e: Entry) -> tuple[str | float, ...]:
    parameters = json.dumps([e.names, e.values.tolist(), e.covariance.tolist()])
    return e.path, e.sha256, e.rig, e.date, e.dataset, e.model, *e.range_mm, parameters


def _differences(
    before: dict[str, str],
    entries: Sequence[Entry],
    gone: set[str],
    unreadable: Sequence[tuple[str, str]],
) -> Indexed:
    new = {e.sha256: e.path for e in entries if e.path not in before}
    moved = {p: new[before[p]] for p in gone if before[p] in new}
    arrived = set(moved.values())
    return Indexed(
        calibrations=len(entries),
        added=tuple(
            sorted(e.path for e in entries if e.path not in before and e.path not in arrived)
        ),
        changed=tuple(e.path for e in entries if before.get(e.path, e.sha256) != e.sha256),
        deleted=tuple(sorted(gone - set(moved))),
        moved=tuple(sorted(moved.items())),
        unreadable=tuple(unreadable),
    )


def rigs(index: Path) -> list[tuple[str, int, str]]:
    """Return each rig's serial number, number of calibrations and date of the last, sorted."""
    _must_exist(index)
    with _opened(index) as connection:
        return connection.execute(
            "SELECT rig, COUNT(DISTINCT sha256), MAX(date) FROM calibration "
            "GROUP BY rig ORDER BY rig"
        ).fetchall()


def history(index: Path, rig: str) -> list[Entry]:
    """Return a rig's calibrations by date; of copies the one with the first path.

    Raises
    ------
    InputError
        If the rig is not in the index.
    """
    _must_exist(index)
    with _opened(index) as connection:
        rows = connection.execute(
            "SELECT * FROM calibration WHERE rig=? ORDER BY date, path", (rig,)
        ).fetchall()
    if not rows:
        raise InputError.single(
            where=str(index), what=f"has no rig {rig!r}",
            remedy="list the rigs with calib history show",
        )  # fmt: skip
    found: dict[str, Entry] = {}
    for row in rows:
        found.setdefault(row[1], _entry(row))
    return list(found.values())


def _entry(row: tuple[Any, ...]) -> Entry:
    path, sha256, rig, day, dataset, model, near, far, parameters = row
    names, values, covariance = json.loads(parameters)
    return Entry(
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
    )


def _must_exist(index: Path) -> None:
    if not index.is_file():
        raise InputError.single(
            where=str(index), what="is not there", remedy="make it with calib history index DIR"
        )
