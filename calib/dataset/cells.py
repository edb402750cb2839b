"""A CSV table as columns of text, and its columns as numbers, with every fault in its place.

Reading is fast where the table is clean: one pass of the csv module, one conversion a column. Only
a column with a fault is gone through cell by cell, to say where it is.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset.messages import (
    LISTED_PROBLEMS,
    is_formula,
    name_fault,
    refuse_if,
    row_place,
    same_in_more,
    shown,
    suggestion,
    text_fault,
)

NAMED_ROWS = 5
"""Rows named for one fault of one column; what is wrong in all rows is seen from five."""

_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_SAVE = "save it as CSV with commas between the cells and points in the numbers"


@dataclass
class Cells:
    """The cells of a table, as text without surrounding blanks, and the faults found so far.

    Parameters
    ----------
    file
        Name for messages.
    lines
        Line of each row in the file, counted from 1.
    columns
        Text of each column, n cells each; "" where a cell is empty.
    problems
        Grows as columns are read.
    """

    file: str
    lines: tuple[int, ...]
    columns: Mapping[str, tuple[str, ...]]
    problems: list[Problem] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def texts(self, column: str) -> tuple[str, ...]:
        """Return a column's text; "" in all rows if the table has no such column."""
        return self.columns.get(column, ("",) * len(self))

    def present(self, *columns: str) -> BoolArray:
        """Return the rows in which any of these columns is filled, shape (n,)."""
        filled = np.zeros(len(self), dtype=bool)
        for column in columns:
            if column in self.columns:
                filled |= np.array(self.columns[column], dtype=object) != ""
        return filled

    def names(self, column: str) -> tuple[str | None, ...]:
        """Return a column of names, None where a cell is empty; reports unprintable ones."""
        texts = self.texts(column)
        # One look at all of them: most tables are clean.
        formulas = any(is_formula(text) for text in texts)
        if formulas or text_fault("".join(texts) or "-") is not None:
            faults = [name_fault(t) if t else None for t in texts]
            bad = np.array([f is not None for f in faults])
            self.report(bad, column, lambda i: f"{shown(texts[i])} {faults[i]}", "write plain text")
        return tuple(t or None for t in texts)

    def numbers(self, column: str) -> FloatArray:
        """Return a column as numbers, shape (n,); NaN where empty. Reports what is no number."""
        texts = self.texts(column)
        joined = "".join(texts)
        # float() also reads 1_000 and the digits of other scripts; a table may not hold them.
        if joined.isascii() and "_" not in joined:
            try:
                values = np.array([float(t) if t else np.nan for t in texts])
            except ValueError:
                pass
            else:
                if np.all(np.isfinite(values) | (np.array(texts, dtype=object) == "")):
                    return values
        parsed = [parse_number(t) for t in texts]
        bad = np.array([isinstance(p, str) for p in parsed])
        self.report(
            bad,
            column,
            lambda i: f"{shown(texts[i])} {parsed[i]}",
            "write a number such as 485.9"
            if not any(_DECIMAL_COMMA.fullmatch(t) for t in texts)
            else "write a decimal point, not a comma",
        )
        return np.array([np.nan if isinstance(p, str) else p for p in parsed])

    def where(self, row: int, column: str | None = None) -> str:
        """Return the place of a fault: file, line, id and column."""
        return row_place(self.file, self.lines[row], self.texts("id")[row], column)

    def report(
        self,
        bad: BoolArray | Sequence[bool],
        column: str | None,
        what: str | Callable[[int], str],
        remedy: str,
    ) -> None:
        """Add a problem for each row in which `bad` holds, at most `NAMED_ROWS` by name."""
        rows = np.flatnonzero(bad)
        for i in map(int, rows[:NAMED_ROWS]):
            text = what if isinstance(what, str) else what(i)
            self.problems.append(Problem(where=self.where(i, column), what=text, remedy=remedy))
        if len(rows) > NAMED_ROWS:
            place = self.file if column is None else f"{self.file}, column {column}"
            more = same_in_more(len(rows) - NAMED_ROWS)
            self.problems.append(Problem(where=place, what=more, remedy=remedy))

    def suspect(self, column: str, what: str, remedy: str) -> None:
        """Add a problem of a whole column whose values are hardly meant as they stand."""
        where = f"{self.file}, column {column}"
        self.problems.append(Problem(where=where, what=what, remedy=remedy))


def parse_number(text: str) -> float | str:
    """Return the number in a cell, or what is wrong with it."""
    if not text:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        return "is not a number"
    if not text.isascii() or "_" in text:
        return "is not a number"
    return value if np.isfinite(value) else "is not a finite number"


def read_cells(text: str, *, file: str, known: Sequence[str], pattern: str | None = None) -> Cells:
    """Return the cells of a CSV table with a header.

    Parameters
    ----------
    text
        Of the whole table; BOM removed, any line ends.
    file
        Name for messages.
    known
        Columns the table may have.
    pattern
        Regular expression of further columns it may have.

    Raises
    ------
    InputError
        If it is not a table: no header, no rows, rows of another length than the header. Unknown
        and repeated columns are left in the problems of the cells.
    """
    records, lines = _records(text.removeprefix("\ufeff"), file)
    if not records:
        raise InputError.single(
            where=file, what="is empty", remedy=f"start with a header such as {','.join(known[:4])}"
        )
    header = [name.strip() for name in records[0]]
    place = f"{file}, line {lines[0]}"
    _refuse_no_header(header, place, known)
    problems = _header_faults(header, place, known, pattern)
    if len(records) == 1:
        raise InputError.single(
            where=file, what="has a header but no rows", remedy="add a row a measurement"
        )
    _refuse_ragged(records, lines, file, problems)
    columns = {
        name: tuple(cell.strip() for cell in cells)
        for name, cells in zip(header, zip(*records[1:], strict=True), strict=True)
    }
    return Cells(file, tuple(lines[1:]), columns, problems)


def _records(text: str, file: str) -> tuple[list[list[str]], list[int]]:
    """Return the records of a CSV text and the line each ends on, blank ones left out."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    records: list[list[str]] = []
    lines: list[int] = []
    try:
        for record in reader:
            if any(record) and any(cell.strip() for cell in record):
                records.append(record)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError.single(
            where=f"{file}, line {reader.line_num}",
            what=f"is not CSV: {error}",
            remedy="close every quotation mark, or leave them out",
        ) from error
    return records, lines


def check_header(
    record: list[str], place: str, known: Sequence[str], pattern: str | None = None
) -> list[str]:
    """Return the names of the columns; for the parameters see `read_cells`.

    Raises
    ------
    InputError
        If they are no header, or hold unknown or repeated columns.
    """
    header = [name.strip() for name in record]
    _refuse_no_header(header, place, known)
    refuse_if(_header_faults(header, place, known, pattern), where=place)
    return header


def _refuse_no_header(header: list[str], place: str, known: Sequence[str]) -> None:
    """Raise if the first line is no header in cells separated by commas."""
    if header[0].lower().startswith("sep="):
        comma = header[1:] == [""]
        raise InputError.single(
            where=place,
            what=f"{shown(header[0] + ',' * comma)} is a line for spreadsheets, no header",
            remedy="delete it" if comma else f"delete it, and {_SAVE}",
        )
    if len(header) == 1 and (found := re.search(r"[;\t|]", header[0])):
        name = {";": "semicolons", "\t": "tabs", "|": "bars"}[found[0]]
        raise InputError.single(
            where=place, what=f"its cells are separated by {name}", remedy=_SAVE
        )
    if sum(map(_is_number, header)) > len(header) / 2:
        raise InputError.single(
            where=place,
            what="the first line holds numbers, not the names of the columns",
            remedy=f"start with a header: {','.join(known)}",
        )


def _header_faults(
    header: list[str], place: str, known: Sequence[str], pattern: str | None
) -> list[Problem]:
    problems: list[Problem] = []
    seen: set[str] = set()
    for i, name in enumerate(header):
        if len(problems) > LISTED_PROBLEMS:
            break
        repeated = name in seen
        seen.add(name)
        if repeated and name:
            what, remedy = f"column {shown(name)} occurs twice", "remove or rename one"
        elif not name:
            what, remedy = f"column {i + 1} has no name", "name it, or remove it"
        elif name in known or (pattern is not None and re.fullmatch(pattern, name)):
            continue
        else:
            what, remedy = f"unknown column {shown(name)}", suggestion(name, known)
        problems.append(Problem(where=place, what=what, remedy=remedy))
    return problems


def _is_number(text: str) -> bool:
    return isinstance(parse_number(text), float) and text != ""


def _refuse_ragged(
    records: list[list[str]], lines: list[int], file: str, problems: list[Problem]
) -> None:
    """Raise, adding to the header's problems, if a row has more or fewer cells than the header."""
    width = len(records[0])
    ragged = [i for i, record in enumerate(records) if len(record) != width]
    if not ragged:
        return
    remedy = "give every row as many cells as the header; decimals need a point, not a comma"
    problems += [
        Problem(
            where=f"{file}, line {lines[i]}",
            what=f"has {len(records[i])} cells, the header has {width}",
            remedy=remedy,
        )
        for i in ragged[:NAMED_ROWS]
    ]
    if len(ragged) > NAMED_ROWS:
        more = same_in_more(len(ragged) - NAMED_ROWS)
        problems.append(Problem(where=file, what=more, remedy=remedy))
    refuse_if(problems, where=file)


def require_columns(cells: Cells, choices: Iterable[Sequence[str]]) -> None:
    """Report columns that the table lacks; of each choice it needs one.

    Says nothing where the header has a fault: a misspelt column is not also a missing one.
    """
    if cells.problems:
        return
    for choice in choices:
        if not any(name in cells for name in choice):
            what = f"column {' or '.join(choice)} is missing"
            cells.problems.append(Problem(where=cells.file, what=what, remedy="add it"))
