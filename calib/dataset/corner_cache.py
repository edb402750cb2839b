"""Corner caches in mrcal's format: text, one line a corner, ``filename x y level``.

See "corners.vnl" in mrcal's documentation of mrcal-calibrate-cameras. Lines of one image stand
together in board order; "-" marks a corner not found, and one line of dashes an image without a
board. Names with spaces are read and written, though mrcal itself cannot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.geometry.board import Board, Corners

_HEADER = "# filename x y level\n"
_MISSING = "-"


def write_cache(cameras: Sequence[Corners]) -> str:
    """Return the text of a cache of corners of any number of cameras, to 1e-4 px."""
    lines = [_HEADER]
    for corners in cameras:
        for name, view in zip(corners.images, corners.pixels, strict=True):
            found = np.isfinite(view).all(axis=-1)
            if not found.any():
                lines.append(f"{name} - - -\n")
                continue
            lines += [
                f"{name} {x:.4f} {y:.4f} 0\n" if seen else f"{name} - - -\n"
                for (x, y), seen in zip(view, found, strict=True)
            ]
    return "".join(lines)


def read_cache(text: str, board: Board, *, where: str) -> Mapping[str, FloatArray]:
    """Return the corners of each image named in a cache, px, shape (corners, 2), NaN if missing.

    The level, at which a detector found the corner, only says here whether it did.

    Parameters
    ----------
    where
        What messages call the file.

    Raises
    ------
    InputError
        With all lines that do not parse and all images with another number of corners.
    """
    rows: dict[str, list[tuple[float, float]]] = {}
    problems: list[Problem] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            name, corner = _parse(line)
        except ValueError:
            problems.append(
                Problem(
                    f"{where}, line {number}",
                    f"{line.strip()[:60]!r} is no corner",
                    "write 'filename x y level', with '-' for a corner not found",
                )
            )
            continue
        rows.setdefault(name, []).append(corner)

    found: dict[str, FloatArray] = {}
    for name, corners in rows.items():
        pixels = np.array(corners)
        if len(pixels) == 1 and np.isnan(pixels).all():
            pixels = np.full((board.corner_count, 2), np.nan)
        if len(pixels) != board.corner_count:
            problems.append(
                Problem(
                    f"{where}, image {name}",
                    f"{len(pixels)} corners, and the board has {board.columns} x {board.rows} "
                    f"= {board.corner_count}",
                    "check columns and rows of [board], or write a line for missing corners too",
                )
            )
        found[name] = pixels
    if problems:
        raise InputError(problems)
    return MappingProxyType(found)


def _parse(line: str) -> tuple[str, tuple[float, float]]:
    """Return name and corner of one line, or raise ValueError."""
    missing = (np.nan, np.nan)
    # Without a level there are three words; with one, the name may hold spaces.
    words = line.split()
    name, *fields = words if len(words) == 3 else line.strip().rsplit(maxsplit=3)
    if len(fields) not in (2, 3):
        raise ValueError(line)
    if _MISSING in fields:
        return name, missing
    numbers = [float(field) for field in fields]
    if not np.isfinite(numbers).all():
        raise ValueError(line)
    # mrcal's reader takes a negative number for "not found" too.
    return name, ((numbers[0], numbers[1]) if min(numbers) >= 0 else missing)
