"""What an image file says of itself before anything is decoded: size, depth, whether it is whole.

A file of 2 MB can claim a billion pixels, and a decoder believes it. So the header is read first,
here, in a few hundred bytes.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import BinaryIO

LARGEST_PIXELS = 160_000_000
"""Of the largest industrial imagers, 151 million, with room; in 16 bit they decode to 0.3 GB."""

LARGEST_BYTES = 2**30
"""Three channels of 16 bit of so many pixels, not compressed."""

_HEAD = 2**20
"""Bytes from the start in which all formats but TIFF say their size, with thumbnails before it."""

_TAIL = 2**16
"""Bytes at the end in which a whole PNG or JPEG has its end mark: some cameras pad their files."""

KINDS = "PNG, JPEG, TIFF, BMP, PGM and WebP"

_CONVERT = f"save it as PNG; {KINDS} are read"
_COPY = "copy it again from the camera, or take it out of the dataset"


@dataclass(frozen=True)
class Header:
    """What an image file says of itself.

    Parameters
    ----------
    width, height
        Pixels.
    bits
        Of a sample.
    is_whole
        False if the file ends before its image does.
    samples
        A pixel, where a file may say more than four.
    """

    width: int
    height: int
    bits: int
    is_whole: bool = True
    samples: int = 1


def picture_header(file: BinaryIO) -> Header | None:
    """Return the header of an open image file; None if it is no image of a known kind."""
    head = file.read(_HEAD)
    size = file.seek(0, 2)
    try:
        if head[:4] in _TIFF:
            return _tiff(file, size)
        file.seek(max(0, size - _TAIL))
        return _by_head(head, file.read(), size)
    except (struct.error, IndexError, ValueError, OverflowError):
        return None


def header_fault(header: Header | None) -> tuple[str, str] | None:
    """Return why a file is not to be decoded, and the remedy; None if it may be."""
    if header is None:
        return "the file is truncated or no image", f"{_COPY}; or {_CONVERT}"
    size = f"{header.width} x {header.height}"
    if header.width < 1 or header.height < 1:
        return f"the file says that it has {size} px", _COPY
    if header.width * header.height > LARGEST_PIXELS:
        return (
            f"the file says that it has {size} px of {header.bits} bit, "
            f"{header.width * header.height / 1e6:.0f} million (limit {LARGEST_PIXELS / 1e6:.0f})",
            "it is no picture of a camera: take it out of the dataset",
        )
    if header.width * header.height * header.samples * header.bits > 8 * LARGEST_BYTES:
        return (
            f"the file says that it has {size} px of {header.samples} x {header.bits} bit, more "
            "than 1 GiB",
            "it is no picture of a camera: take it out of the dataset",
        )
    if not header.is_whole:
        return f"the file is truncated: {size} px, and its end is missing", _COPY
    return None


def _by_head(head: bytes, tail: bytes, size: int) -> Header | None:
    if head.startswith(b"\x89PNG\r\n\x1a\n") and head[12:16] == b"IHDR":
        width, height, bits = struct.unpack(">IIB", head[16:25])
        return Header(width, height, bits, b"IEND" in tail)
    if head.startswith(b"\xff\xd8\xff"):
        return _jpeg(head, tail)
    if head.startswith(b"BM"):
        return _bmp(head, size)
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return _webp(head, size)
    return _pnm(head, size)


_NO_FRAME = {0xC4, 0xC8, 0xCC}
"""Of the markers C0 to CF: tables and a reserved one; the others begin a frame."""

_ALONE = {0x01, *range(0xD0, 0xD8)}
"""Markers without a length."""


def _jpeg(head: bytes, tail: bytes) -> Header | None:
    at = 2
    while True:
        if head[at] != 0xFF:
            return None
        marker = head[at + 1]
        if marker == 0xFF or marker in _ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            bits, height, width = struct.unpack(">BHH", head[at + 4 : at + 9])
            return Header(width, height, bits, b"\xff\xd9" in tail)
        (length,) = struct.unpack(">H", head[at + 2 : at + 4])
        at += 2 + length


def _bmp(head: bytes, size: int) -> Header:
    (start, info) = struct.unpack("<II", head[10:18])
    if info == 12:
        width, height, _, bits = struct.unpack("<HHHH", head[18:26])
        compression = 0
    else:
        width, height, _, bits, compression = struct.unpack("<iiHHI", head[18:34])
    row = (abs(width) * bits + 31) // 32 * 4
    whole = size > start if compression else size >= start + row * abs(height)
    return Header(abs(width), abs(height), bits, whole)


def _webp(head: bytes, size: int) -> Header | None:
    (length,) = struct.unpack("<I", head[4:8])
    whole, kind = size >= length + 8, head[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack("<HH", head[26:30])
        return Header(width & 0x3FFF, height & 0x3FFF, 8, whole)
    if kind == b"VP8L":
        (both,) = struct.unpack("<I", head[21:25])
        return Header((both & 0x3FFF) + 1, (both >> 14 & 0x3FFF) + 1, 8, whole)
    if kind == b"VP8X":
        width, height = (int.from_bytes(head[a : a + 3], "little") + 1 for a in (24, 27))
        return Header(width, height, 8, whole)
    return None


_PNM = re.compile(rb"P([1-6])(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d*)")
_PLAIN = b"123"


def _pnm(head: bytes, size: int) -> Header | None:
    found = _PNM.match(head[:4096])
    if found is None:
        return None
    kind, width, height = found[1], int(found[2][:12]), int(found[3][:12])
    if kind in b"14":
        return Header(width, height, 1, size - found.start(4) >= (width + 7) // 8 * height)
    most = int(found[4][:12] or b"0")
    if not 0 < most < 2**16:
        return None
    samples = width * height * (3 if kind in b"36" else 1)
    bits = most.bit_length()
    needed = samples if kind in _PLAIN or bits <= 8 else 2 * samples
    return Header(width, height, bits, size - found.end() - 1 >= needed)


_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
_WIDTH, _HEIGHT, _BITS, _SAMPLES = 256, 257, 258, 277
_STRIPS, _STRIP_SIZES, _TILES, _TILE_SIZES = 273, 279, 324, 325
_READ = {_WIDTH, _HEIGHT, _BITS, _SAMPLES, _STRIPS, _STRIP_SIZES, _TILES, _TILE_SIZES}
_MOST_TAGS = 1000
_INTEGERS = {1: "B", 3: "H", 4: "I"}


def _tiff(file: BinaryIO, size: int) -> Header | None:
    """Return the header of the first picture of a TIFF file; strips beyond its end are missing."""
    file.seek(0)
    start = file.read(8)
    order = _TIFF[start[:4]]
    file.seek(struct.unpack(order + "I", start[4:])[0])
    (count,) = struct.unpack(order + "H", file.read(2))
    entries = [file.read(12) for _ in range(min(count, _MOST_TAGS))]
    tags: dict[int, tuple[int, ...]] = {}
    for entry in entries:
        tag, kind, number = struct.unpack(order + "HHI", entry[:8])
        if tag in tags:
            return None  # a decoder may believe the other one
        if kind in _INTEGERS and tag in _READ:
            tags[tag] = _values(file, entry, order, f"{number}{_INTEGERS[kind]}", size)
    if _WIDTH not in tags or _HEIGHT not in tags:
        return None
    starts = tags.get(_STRIPS) or tags.get(_TILES) or ()
    sizes = tags.get(_STRIP_SIZES) or tags.get(_TILE_SIZES) or ()
    ends = [a + n for a, n in zip(starts, sizes, strict=False)]
    whole = bool(ends) and max(ends) <= size
    bits, samples = max(tags.get(_BITS) or (1,)), max(tags.get(_SAMPLES) or (1,))
    return Header(tags[_WIDTH][0], tags[_HEIGHT][0], bits, whole, samples)


def _values(file: BinaryIO, entry: bytes, order: str, form: str, size: int) -> tuple[int, ...]:
    length = struct.calcsize(order + form)
    if length <= 4:
        return struct.unpack(order + form, entry[8 : 8 + length])
    if length > size:
        return ()
    file.seek(struct.unpack(order + "I", entry[8:])[0])
    return struct.unpack(order + form, file.read(length))
