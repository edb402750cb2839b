"""Files that are read whole, within a limit that also holds where a file has no size of its own."""

from __future__ import annotations

import os
import stat
from pathlib import Path


class TooLargeError(OSError):
    """A file, device or pipe gives more bytes than may be read."""


def read_limited(path: Path, limit: int, *, regular: bool = False) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    limit
        Largest number of bytes; a device states none, and may never end.
    regular
        Whether only a plain file will do: of one that was found, and not named by the user, a pipe
        would be waited for without end.

    Raises
    ------
    TooLargeError
        If it is larger than that.
    OSError
        If it cannot be read, or is no plain file where it must be one.
    """
    if regular and not stat.S_ISREG(path.stat().st_mode):
        raise OSError(f"{path} is no plain file")
    with path.open("rb") as file:
        # What a file says of its size only saves the reading, and a buffer of the limit's size.
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise TooLargeError(f"{path} is too large")
        data = file.read(size + 1)
        if len(data) > size:
            data += file.read(limit + 1 - len(data))
    if len(data) > limit:
        raise TooLargeError(f"{path} is too large")
    return data
