"""One calibration of a history, read from its folder.

Which rig a calibration belongs to: the serial number in calibration.json; without it the serial
number on the certificate beside it; without either the name of the dataset. When: the date of
calibration on the certificate (that of issue where none is stated); without a certificate the
date in run.toml.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import tomllib
import unicodedata
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import from_json

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.core.limited import read_limited
from calib.core.seal import is_edited
from calib.core.unit_diagonal import unit_diagonal
from calib.geometry.parameters import INDEX
from calib.instrument.calibration_file import FILE_LIMIT_BYTES
from calib.stages.manifest import AGAIN, Listing, refuse_broken
from calib.stages.run_folder import MANIFEST

RESULT, CERTIFICATE, RUN = "calibration.json", "certificate.xml", "run.toml"

ROUNDING = 1e-6
"""Of correlations."""

FILES = (RESULT, CERTIFICATE, RUN, MANIFEST)
"""All that is read of a folder."""

_NAMESPACE = "https://ptb.de/dcc"
_DCC = {"dcc": _NAMESPACE}
_ADMINISTRATIVE = f"{{{_NAMESPACE}}}administrativeData"
_SERIAL = etree.XPath(
    "dcc:items/dcc:item/dcc:identifications/dcc:identification"
    "[dcc:name/dcc:content='serial number']/dcc:value/text()",
    namespaces=_DCC,
)
_PERFORMED = "dcc:coreData/dcc:endPerformanceDate"

CHUNK_BYTES = 16_384
"""Of a certificate at a time: what identifies it stands first, the tables after it are not read."""

_RUN_SECTION = re.compile(r"^\[run\]\n(?:[^\[\n].*\n|\n)*", re.MULTILINE)
"""The section of run.toml that says when the run ended: all of it takes ten times as long."""


class GatesFailedError(ValueError):
    """A calibration's gates failed: it is told, and is no fault of the files."""


@dataclass(frozen=True)
class IndexEntry:
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
    dataset_sha256
        Of the dataset: two runs of one dataset are one calibration.
    finished
        When the run ended, ISO 8601 in UTC, empty where unknown: the order of calibrations on one
        day.
    has_serial
        Whether a serial number is stated, for which the dataset's name stands in otherwise.
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
    dataset_sha256: str
    finished: str
    has_serial: bool


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


def read_entry(folder: Path) -> IndexEntry:
    """Return the entry of one folder.

    Raises
    ------
    GatesFailedError
        If its calibration must not be used.
    ValueError
        If it cannot be read, was edited or is of no whole run; the text says why.
    """
    files = _Files(folder)
    content = files.whole(RESULT)
    try:
        document = _Document.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ValueError(f"{where}: {first['msg']}") from error
    failed = [gate.name for gate in document.gates if not gate.passed]
    if failed:
        raise GatesFailedError(f"must not be used: gate {', '.join(failed)} failed")
    # In the folder of a run its manifest has said already that the file is what the run wrote.
    if files.listing is None and is_edited(from_json(content)):
        raise ValueError("was edited after the run that wrote it")
    m = document.measurement
    values, covariance = np.array(m.values), np.array([list(row) for row in m.covariance])
    n = len(m.names)
    if document.format != 1:
        raise ValueError(f"format {document.format} is not known")
    if values.shape != (n,) or covariance.shape != (n, n) or not set(m.names) <= set(INDEX):
        raise ValueError("measurement: names, values and covariance do not belong together")
    _refuse_impossible(m, covariance)
    finished = _finished(files)
    serial, dated = _certified(files, document.dataset.sha256)
    stated = document.rig.serial if document.rig is not None else None
    named = one_spelling(stated) or one_spelling(serial)
    return IndexEntry(
        path=str(folder),
        sha256=hashlib.sha256(content).hexdigest(),
        rig=named or one_spelling(document.dataset.name),
        has_serial=bool(named),
        date=_iso(dated or finished[:10] or _no_date()),
        dataset=document.dataset.name,
        model=m.model,
        range_mm=m.calibrated_depth_mm,
        names=m.names,
        values=values,
        covariance=covariance,
        dataset_sha256=document.dataset.sha256,
        finished=_utc(finished),
    )


class _Files:
    """The files of one folder; the manifest that says which of them are whole is read once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.listing = Listing.of(folder)

    def whole(self, name: str) -> bytes:
        """Return the bytes of a file, which must be those that the run wrote."""
        content = self.optional(name)
        if content is None:
            raise ValueError(f"{name}: {os.strerror(errno.ENOENT)}")
        return content

    def optional(self, name: str) -> bytes | None:
        """Return the same, or None if there is no such file."""
        path = self._folder / name
        try:
            content = read_limited(path, FILE_LIMIT_BYTES, regular=True)
            if path.is_symlink():
                refuse_broken(path, content)
            elif self.listing is not None:
                self.listing.refuse_broken(name, content)
        except FileNotFoundError:
            return None
        except InputError as error:
            # No option takes it: an index is of what runs wrote.
            fault = error.problems[0]
            named = "" if fault.where == str(self._folder) else f"{Path(fault.where).name} "
            raise ValueError(f"{named}{fault.what}; {AGAIN}") from error
        except OSError as error:
            raise ValueError(f"{name}: {error.strerror or error}") from error
        return content


def _refuse_impossible(m: _Measurement, covariance: FloatArray) -> None:
    """Raise if no rig can have such a calibration: its charts would show no number, or a lie."""
    if len(set(m.names)) < len(m.names) or "baseline_mm" not in m.names:
        raise ValueError("measurement.names: baseline_mm and others, each once, are needed")
    if not np.all(np.diagonal(covariance) > 0):
        raise ValueError("measurement.covariance: a variance is not above 0")
    correlation = unit_diagonal(covariance)[1]
    if not np.abs(correlation - correlation.T).max() <= ROUNDING:
        raise ValueError("measurement.covariance: is not symmetric")
    if np.linalg.eigvalsh(correlation)[0] < -ROUNDING:
        raise ValueError("measurement.covariance: has a negative eigenvalue")
    near, far = m.calibrated_depth_mm
    if not 0 < near <= far:
        raise ValueError(f"measurement.calibrated_depth_mm: {near:g} to {far:g} is no range")


def _certified(files: _Files, dataset_sha256: str) -> tuple[str | None, str | None]:
    """Return serial number and date of the certificate beside a calibration, as far as stated."""
    if (content := files.optional(CERTIFICATE)) is None:
        return None, None
    try:
        head = _administrative_data(content)
    except etree.XMLSyntaxError:
        return None, None
    if head is None:
        return None, None
    serials: Any = _SERIAL(head)
    dated = head.findtext(_PERFORMED, namespaces=_DCC)
    found = str(serials[0]).strip() if serials else None
    # Where no serial number is stated, the certificate identifies the item by its dataset.
    return None if found in (None, "", "not stated", dataset_sha256) else found, dated


def _administrative_data(content: bytes) -> etree._Element | None:
    """Return the part of a certificate that says what it is of; None if there is none."""
    parser = etree.XMLPullParser(
        ("end",), tag=_ADMINISTRATIVE, resolve_entities=False, no_network=True
    )
    for start in range(0, len(content), CHUNK_BYTES):
        parser.feed(content[start : start + CHUNK_BYTES])
        for _, element in parser.read_events():
            return element if isinstance(element, etree._Element) else None
    return None


def _finished(files: _Files) -> str:
    """Return when a run ended, as run.toml has it; empty where it does not say."""
    if (content := files.optional(RUN)) is None:
        return ""
    try:
        text = content.decode("utf-8")
        section = _RUN_SECTION.search(text)
        run: dict[str, Any] = tomllib.loads(section.group() if section else text)
        return str(run["run"]["finished"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""


def one_spelling(text: str | None) -> str:
    """Return a serial number without what nobody sees: spaces about it, two forms of a letter."""
    return " ".join(unicodedata.normalize("NFC", text or "").split())


def _no_date() -> str:
    raise ValueError(f"no date: neither {CERTIFICATE} nor {RUN} states one")


def _utc(text: str) -> str:
    """Return a time as one that sorts, in UTC; empty for what is none."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC).isoformat()
    except (ValueError, OverflowError):
        return ""


def _iso(text: str) -> str:
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise ValueError(f"{text!r} is not a date") from None
