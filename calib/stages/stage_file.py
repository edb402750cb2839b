"""A stage's outcome as bytes: a seal, then HDF5.

An outcome is a frozen dataclass. Its numbers, texts and structure go into one JSON document, its
arrays into HDF5 datasets beside it; reading checks every type against the dataclass. Nothing read
is ever evaluated.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError

from calib.core.errors import CalibError
from calib.core.hdf5 import hdf5_arrays, hdf5_bytes
from calib.stages.serialise import deserialise, serialise

DOCUMENT = "document"

SEAL_BYTES = 512
"""Before the HDF5 part of a stage file stands its seal; HDF5 allows for 512 bytes."""

_SEAL = "calib stage 1\n{fingerprint}\n{sha256}\n"

_UNREADABLE = (
    OSError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    RecursionError,
    BaseValidationError,
    ForbiddenExtraKeysError,
)


@dataclass(frozen=True)
class Failure:
    """The outcome of a stage that has no answer on its data."""

    reason: str


def pack(outcome: Any) -> bytes:
    """Return a dataclass, or a failure, as bytes."""
    document, arrays = serialise(outcome)
    text = json.dumps([isinstance(outcome, Failure), document], ensure_ascii=False).encode()

    def fill(file: h5py.File) -> None:
        for key, array in arrays.items():
            file.create_dataset(key, data=array)
        file.create_dataset(DOCUMENT, data=np.frombuffer(text, np.uint8))

    return hdf5_bytes(fill)


def unpack(content: bytes, kind: Any) -> Any:
    """Return what was packed: a dataclass of type `kind`, or a failure.

    Raises
    ------
    ValueError
        If the bytes are damaged or of another type.
    """
    try:
        arrays = dict(hdf5_arrays(content))
        failed, document = json.loads(arrays.pop(DOCUMENT).tobytes().decode())
        return deserialise(document, arrays, Failure if failed is True else kind)
    except _UNREADABLE as error:
        raise ValueError(str(error)) from error


def with_header(fingerprint: str, content: bytes) -> bytes:
    """Return the bytes of a stage file."""
    return _seal(fingerprint, content) + content


def is_intact(path: Path, fingerprint: str) -> bool:
    """Return whether a stage file is there, has this fingerprint and is as it was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return content[:SEAL_BYTES] == _seal(fingerprint, content[SEAL_BYTES:])


def read(path: Path, kind: Any) -> Any:
    """Return the outcome in a stage file.

    Raises
    ------
    CalibError
        If the file is damaged.
    """
    try:
        return unpack(path.read_bytes()[SEAL_BYTES:], kind)
    except (OSError, ValueError) as error:
        raise CalibError(f"{path}: damaged ({error}); delete it and run again") from error


def _seal(fingerprint: str, content: bytes) -> bytes:
    text = _SEAL.format(fingerprint=fingerprint, sha256=sha256(content).hexdigest())
    return text.encode().ljust(SEAL_BYTES, b"\0")
