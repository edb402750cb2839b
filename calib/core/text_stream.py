"""Text that comes in pieces: from a pipe as it is written, from a file in large ones."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import IO

from calib.core.errors import InputError

CHUNK_BYTES = 1 << 20


def read_texts(file: IO[bytes], *, name: str) -> Iterator[str]:
    """Yield the pieces of a UTF-8 text.

    Parameters
    ----------
    file
        Buffered; read as soon as it has anything.
    name
        For messages.

    Raises
    ------
    InputError
        If it is not UTF-8 text, or cannot be read.
    """
    decoder, remedy = codecs.getincrementaldecoder("utf-8")(), "save it as CSV, plain text in UTF-8"
    while True:
        try:
            data = file.read1(CHUNK_BYTES)  # type: ignore[attr-defined] # of a buffered reader
            text = decoder.decode(data, final=not data)
        except UnicodeDecodeError as error:
            what = f"is not UTF-8: byte 0x{error.object[error.start]:02X}"
            raise InputError.single(where=name, what=what, remedy=remedy) from None
        except OSError as error:
            what = f"cannot be read ({error.strerror or error})"
            raise InputError.single(where=name, what=what, remedy="name a CSV file") from None
        if "\x00" in text:
            raise InputError.single(where=name, what="holds NUL bytes", remedy=remedy)
        if text:
            yield text
        if not data:
            return
