"""Files and folders of outputs: whole or not there, and by one program at a time."""

from __future__ import annotations

import fcntl
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calib.core.errors import UsageError

CACHE = ".stages"
"""Folder of the stages in that of a run."""

LOCK = ".lock"
PARTIAL = ".part"

IN_USE = "another run is writing there"
"""Says why a folder is refused that is locked."""


_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{16}\.part", re.DOTALL)
"""What `atomic_write` calls a file that is not whole yet."""


def clear_partial(folder: Path) -> None:
    """Delete from a folder what programs that were killed left half-written."""
    for left in folder.glob(f".*{PARTIAL}"):
        if _TEMPORARY.fullmatch(left.name):
            left.unlink(missing_ok=True)


@contextmanager
def opened_lock(path: Path) -> Iterator[int]:
    """Open a lock file, which is made if it is not there; nothing in it is changed.

    Raises
    ------
    UsageError
        If it cannot be opened, or a link lies in its place.
    """
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield handle
    finally:
        os.close(handle)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes that name, else it vanishes.

    Raises
    ------
    UsageError
        If the file cannot be written: no space, no permission.
    """
    try:
        temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}{PARTIAL}")
        # Created by this very call, with the permissions that the user's umask leaves.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def cannot_write(path: Path, error: OSError) -> UsageError:
    """Return what to tell where a file cannot be written."""
    reason = error.strerror or str(error)
    return UsageError(f"{path}: cannot be written ({reason}); free space or choose another folder")


def make_folder(path: Path) -> None:
    """Make a folder for outputs, and those above it.

    Raises
    ------
    UsageError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file so that its name never stands for half of it."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def is_in_use(out: Path) -> bool:
    """Return whether a run is writing into a folder now."""
    try:
        with (out / LOCK).open("r") as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False
