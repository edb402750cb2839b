"""Standard streams as they may come: closed, full, or unable to print what they are given."""

from __future__ import annotations

import io
import os
import sys
from typing import IO, TextIO

from calib.core.errors import UsageError, harmless

_FULL = 2


def open_streams() -> None:
    """Make all three streams usable.

    A closed one becomes the null device: its number would else go to the next file that is opened,
    and what is printed into that file. Of standard output it is open for reading alone, so that who
    prints a result there is told that it is lost. Characters that the encoding lacks are printed
    escaped.
    """
    for number, mode in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, mode)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
    sys.stdout = _usable(sys.stdout, 1)
    sys.stderr = _usable(sys.stderr, 2)
    error = sys.stderr
    if error is sys.__stderr__ and isinstance(error, io.TextIOWrapper):
        sys.stderr = _Unminded(
            error.buffer, error.encoding, "backslashreplace", line_buffering=True
        )


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


def settled(status: int) -> int:
    """Return the exit status once all that was printed is out: that of a refusal if it cannot be.

    The interpreter would else find out at its end, and say so in words of its own.
    """
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        discard(sys.stdout)
    except OSError as error:
        status = refused_output(error)
    try:
        sys.stderr.flush()
    except OSError:
        discard(sys.stderr)
    return status


class _Unminded(io.TextIOWrapper):
    """Standard error that is full or gone: what is said is lost, and the work goes on."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:
            discard(self)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError:
            discard(self)


def say(line: str) -> None:
    """Print a line on stderr, escaped: names in it may hold what a terminal would obey."""
    tell(harmless(line))


def tell(line: str) -> None:
    """Print a line on stderr, if it takes one."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        discard(sys.stderr)


def discard(stream: TextIO) -> None:
    """Let what is left in a stream's buffer, and what still comes, go nowhere."""
    handle = os.open(os.devnull, os.O_WRONLY)
    os.dup2(handle, stream.fileno())
    os.close(handle)


def refused_output(error: OSError) -> int:
    """Say that an output stream took no more, return the exit status.

    Raises
    ------
    OSError
        The same, if it was not about a standard stream.
    """
    if error.filename is not None:
        raise error
    discard(sys.stdout)
    tell(
        f"calib: standard output cannot be written ({error.strerror or error}); "
        "free space, or write to a file with --out"
    )
    return _FULL
