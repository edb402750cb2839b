"""Standard streams as they may come: closed, full, or unable to print what they are given."""

from __future__ import annotations

import os
import sys
from typing import IO, TextIO

from calib.core.errors import UsageError

_FULL = 2


def open_streams() -> None:
    """Make all three streams usable.

    A closed one becomes the null device: its number would else go to the next file that is opened,
    and what is printed into that file. Characters that the encoding lacks are printed escaped.
    """
    for number, mode in enumerate((os.O_RDONLY, os.O_WRONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, mode)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
    sys.stdout = _usable(sys.stdout, 1)
    sys.stderr = _usable(sys.stderr, 2)


def _usable(stream: TextIO | None, number: int) -> TextIO:
    if stream is None:
        return os.fdopen(number, "w", closefd=False, encoding="utf-8", errors="backslashreplace")
    reconfigure = getattr(stream, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="backslashreplace")
    return stream


def standard_input() -> IO[bytes]:
    """Return standard input as bytes.

    Raises
    ------
    UsageError
        If it is closed.
    """
    if sys.stdin is None:
        raise UsageError("standard input is closed; name a file instead of -")
    return sys.stdin.buffer


def refused_output(error: OSError) -> int:
    """Say that an output stream took no more, return the exit status.

    Raises
    ------
    OSError
        The same, if it was not about a standard stream.
    """
    if error.filename is not None:
        raise error
    # What is left in the buffer would fail once more when the interpreter ends.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        print(
            f"calib: standard output cannot be written ({error.strerror or error}); "
            "free space, or write to a file with --out",
            file=sys.stderr,
        )
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    return _FULL
