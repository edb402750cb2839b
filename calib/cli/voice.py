"""How a command speaks: in words, in JSON or hardly at all; in colours on a terminal alone."""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TextIO

_COLOURS = {"red": "31", "yellow": "33", "green": "32"}


def add_voice(parser: argparse.ArgumentParser, *, json_help: str | None = None) -> None:
    """Add --quiet, and --json where a command has something to give to a program."""
    parser.add_argument(
        "-q", "--quiet", action="store_true", help="say only what is wrong, no progress"
    )
    if json_help is not None:
        parser.add_argument("--json", action="store_true", help=json_help)


def records(table: Sequence[Sequence[str]]) -> list[dict[str, str]]:
    """Return a table, heads first, as one object a row."""
    head, *rows = table
    return [dict(zip(head, row, strict=True)) for row in rows]


def painted(text: str, colour: str, stream: TextIO) -> str:
    """Return a text in a colour, if the stream is a terminal and nobody objects.

    NO_COLOR, see no-color.org, and TERM=dumb do.
    """
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    if plain or not stream.isatty():
        return text
    return f"\033[{_COLOURS[colour]}m{text}\033[0m"


def print_json(document: Mapping[str, Any]) -> None:
    """Print a document on standard output; numbers that JSON lacks become null."""
    print(json.dumps(_finite(document), ensure_ascii=False, allow_nan=False, indent=1))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return value


def as_json_lines(write: Callable[[str], None]) -> Callable[[str], None]:
    """Return a function that takes pieces of a CSV table and writes an object a row.

    Columns named after a unit are numbers: null where there is none, or no limit.
    """
    header: list[str] = []

    def written(text: str) -> None:
        records = list(csv.reader(io.StringIO(text, newline="")))
        if not header and records:
            header.extend(records.pop(0))
        write("".join(_line(header, record) for record in records))

    return written


def _line(header: list[str], record: list[str]) -> str:
    row = {name: _cell(name, cell) for name, cell in zip(header, record, strict=True)}
    return json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n"


def _cell(name: str, cell: str) -> str | float | None:
    from calib.instrument.measured_text import as_given

    if not name.endswith(("_mm", "_mm2", "_rad", "_deg")):
        return as_given(cell)
    value = float(cell) if cell else math.nan
    return value if math.isfinite(value) else None


def error_json(error: Exception) -> dict[str, Any]:
    """Return what a program is told of a refusal."""
    problems = [
        {"where": one.where, "what": one.what, "remedy": one.remedy}
        for one in getattr(error, "problems", ())
    ]
    return {"error": str(error), "problems": problems}


def warn(text: str) -> None:
    """Print a warning on standard output, as the commands that check and calibrate do."""
    print(f"{painted('warning', 'yellow', sys.stdout)}: {text}")
