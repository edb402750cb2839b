"""A small dataset that is right, to be spoilt in one place at a time."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

from calib.core.errors import Problem
from calib.dataset.load import check_dataset
from calib.dataset.messages import text_fault

MANIFEST = """format = 1
name = "rig"
title = "A rig"

[board]
type = "chessboard"
columns = 9
rows = 7
square_mm = 25.0

[cameras.c1]
image_size = [400, 300]
matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]
distortion = [-0.3691, 0.2223, -0.0002, 0.0001, -0.1047]

[encoder]
resolution_deg = 0.05625

[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = 0.0002
u_z_rel = 0.002

[priors]
axis_z_mm = [0, 20]

[certificate]
tolerance = { depth_rel = 0.02 }
date = 2026-01-31
"""

GAZE = """id,x1c,y1c,alpha2_deg,z_mm
1,0.1018,0.0100,86.150,485.9
2,0.2635,0.0100,95.006,486.5
3,0.2353,0.0100,96.950,796.4
4,0.0229,0.0100,85.210,805.9
5,0.0162,0.0100,85.859,1008.5
6,0.1624,0.0100,94.033,998.5
"""


def png(width: int = 400, height: int = 300, *, bits: int = 8, data: bytes = b"") -> bytes:
    """Return a PNG file, black where no data are given, whatever size its header claims."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        check = zlib.crc32(kind + body)
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", check)

    rows = data or bytes((1 + width * bits // 8) * height)
    return b"".join((
        b"\x89PNG\r\n\x1a\n",
        chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)),
        chunk(b"IDAT", zlib.compress(rows)),
        chunk(b"IEND", b""),
    ))  # fmt: skip


PNG = png()


def write_dataset(folder: Path, manifest: str | bytes = MANIFEST, **files: str | bytes) -> Path:
    """Write a dataset; files are named by key, with ``__`` for a dot and ``___`` for a slash."""
    contents = {"dataset.toml": manifest, "gaze.csv": GAZE} | {
        name.replace("___", "/").replace("__", "."): text for name, text in files.items()
    }
    for name, text in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def problems_of(folder: Path) -> tuple[Problem, ...]:
    """Return the problems of a dataset, each checked to be one readable line of three parts."""
    problems = check_dataset(folder)
    for problem in problems:
        assert_readable(problem)
    return problems


def assert_readable(problem: Problem) -> None:
    """Each message names place, fault and remedy, on one line, without control characters."""
    assert problem.where
    assert problem.what
    assert problem.remedy
    assert text_fault(str(problem)) is None
    assert len(str(problem)) < 1000


def assert_problem(problems: tuple[Problem, ...], *parts: str) -> None:
    """Assert that one of the problems says all of `parts`."""
    for problem in problems:
        if all(part in str(problem) for part in parts):
            return
    listing = "\n".join(map(str, problems)) or "no problem at all"
    raise AssertionError(f"no problem says {parts}:\n{listing}")


def replaced(text: str, old: str, new: str) -> str:
    """Return `text` with the only occurrence of `old` replaced."""
    assert len(re.findall(re.escape(old), text)) == 1, f"{old!r} is not there once"
    return text.replace(old, new)
