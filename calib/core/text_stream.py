"""Text that comes in pieces: from a pipe as it is written, from a file in large ones."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import IO

from calib.core.errors import InputError

CHUNK_BYTES = 1 << 20


def read_texts(file: IO[bytes], *, name: str) -> Iterator[str]:
    """Yield the pieces of a UTF-8 text; other bytes become what `surrogateescape` makes of them.

    Parameters
    ----------
    file
        Buffered; read as soon as it has anything.
    name
        For messages.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    decoder = codecs.getincrementaldecoder("utf-8")("surrogateescape")
    while True:
        try:
            data = file.read1(CHUNK_BYTES)  # type: ignore[attr-defined] # of a buffered reader
        except OSError as error:
            what = f"cannot be read ({error.strerror or error})"
            raise InputError.single(where=name, what=what, remedy="name a CSV file") from None
        if text := decoder.decode(data, final=not data):
            yield text
        if not data:
            return
