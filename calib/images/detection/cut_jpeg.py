"""JPEG files whose data end before the picture does, although an end mark follows.

A decoder fills what is missing with grey, and says so on standard error at most. Whether it had
enough can be asked of it: what stands between the last block and the end mark is passed over, so
bytes put there change nothing in a whole picture; where blocks are missing they pass for them.
"""

from __future__ import annotations

from hashlib import sha256
from io import BytesIO
from threading import Lock

from PIL import ImageFile
from PIL.JpegImagePlugin import JpegImageFile

_END = b"\xff\xd9"
_BLOCKS = bytes(b for b in sha256(b"JPEG").digest() if b not in (0x00, 0xFF))
"""Codes of blocks that no decoder makes up by itself."""

_PROBE = _BLOCKS + b"".join(bytes((0xFF, 0xD0 + k)) + _BLOCKS for k in range(8))
"""With all restart marks: after one that is missing, data count from the next."""

_SWITCH = Lock()
"""Of the one below, which holds for all threads, and which WeasyPrint turns on."""


def is_cut(data: bytes) -> bool:
    """Return whether a JPEG file ends before its picture; False for what is none.

    A cut is not seen where restart marks follow on each block or two, or where the last scan of a
    progressive picture misses steps of one or two grey values.
    """
    end = data.rfind(_END)
    if end < 0 or not data.startswith(b"\xff\xd8"):
        return False
    try:
        pictures = [JpegImageFile(BytesIO(d)) for d in (data, data[:end] + _PROBE + data[end:])]
    except (OSError, SyntaxError, ValueError):
        return False
    with _SWITCH:
        lenient = ImageFile.LOAD_TRUNCATED_IMAGES
        ImageFile.LOAD_TRUNCATED_IMAGES = False
        try:
            return _pixels(pictures[0]) != _pixels(pictures[1])
        except OSError:
            return True
        finally:
            ImageFile.LOAD_TRUNCATED_IMAGES = lenient


def _pixels(picture: JpegImageFile) -> bytes:
    # An eighth of the size has the mean of each block; later scans of a progressive picture only
    # refine blocks.
    picture.draft("L", picture.size if "progressive" in picture.info else (1, 1))
    return picture.tobytes()
