"""CSV line for line: what is wrong with one spoils no other."""

from __future__ import annotations

import csv
import io

LONGEST_ROW = 100_000
"""Characters; what is longer is no reading, and of an endless line no more is kept."""

LONGEST_ID = 200
"""Characters of a spoilt line in which its id is looked for."""


def lines_end(text: str) -> int:
    """Return where the last complete line of a text ends."""
    return max(text.rfind("\n"), text.rfind("\r", 0, len(text) - 1)) + 1


def parse_lines(text: str) -> tuple[list[list[str]], dict[int, str]]:
    """Return the cells of each line of a text, and what is wrong with which.

    Bytes that are no UTF-8 are expected as `surrogateescape` leaves them.
    """
    texts = list(io.StringIO(text, newline=""))
    if _is_text(text) and max(map(len, texts), default=0) <= LONGEST_ROW:
        try:
            cells = list(csv.reader(texts, strict=True, skipinitialspace=True))
        except csv.Error:
            pass
        else:
            if len(cells) == len(texts):
                return cells, {}
    faults: dict[int, str] = {}
    cells = []
    for i, line in enumerate(texts):
        record, fault = _row(line)
        cells.append(record)
        if fault is not None:
            faults[i] = fault
    return cells, faults


def _row(text: str) -> tuple[list[str], str | None]:
    """Return the cells of one line, if need be as far as they can be made out, and its fault."""
    fault = None
    if len(text) > LONGEST_ROW:
        fault = f"is longer than {LONGEST_ROW:,} characters"
    elif not _is_text(text):
        fault = "is not text in UTF-8"
    else:
        try:
            for record in csv.reader([text], strict=True, skipinitialspace=True):
                return record, None
        except csv.Error:
            fault = "is not CSV: close every quotation mark, or leave them out"
    seen = text[:LONGEST_ID].encode("utf-8", "replace").decode().replace("\x00", "?")
    return [cell.strip().strip('"') for cell in seen.rstrip("\r\n").split(",")], fault


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\x00" not in text
