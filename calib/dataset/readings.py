"""Readings to be measured, block by block: one bad row spoils no other.

A table of calibration rows is refused if a row has a fault (`calib.dataset.readers`), for a fit
must not quietly go without it. Readings are independent of each other: each that can be measured
is, and each that cannot says why.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import InputError
from calib.dataset.cells import check_header, parse_number
from calib.dataset.csv_lines import LONGEST_ROW, lines_end, parse_lines
from calib.dataset.messages import shown, text_fault
from calib.dataset.readers import GAZE_COLUMNS, REFERENCE_COLUMN
from calib.dataset.reading_values import value_faults
from calib.dataset.tables import GazeTable, freeze

NUMBERS = ("x1c", "y1c", "u1_px", "v1_px", "alpha2_deg", "ctan_alpha2", "u2_px")


@dataclass(frozen=True)
class ReadingBlock:
    """Some rows of a table, in order.

    Parameters
    ----------
    ids, lines
        Of all rows, n of them.
    table
        The rows without fault, m of them.
    place
        Their places among all rows, shape (m,).
    faults
        Why a row cannot be measured, by its place.
    """

    ids: tuple[str, ...]
    lines: tuple[int, ...]
    table: GazeTable
    place: IntArray
    faults: dict[int, str]

    def __len__(self) -> int:
        return len(self.ids)


WHOLE_LIMIT = 200_000_000
"""Characters of a table whose rows refer to each other and which is held whole."""


def read_blocks(texts: Iterator[str], *, name: str, whole: bool = False) -> Iterator[ReadingBlock]:
    """Yield the rows of a table as its text comes in.

    Parameters
    ----------
    texts
        Pieces of the text.
    name
        Of the table, for messages.
    whole
        Whether all rows are wanted in one block, as they are anyway where they use each other's
        depth (column depth_row).

    Raises
    ------
    InputError
        If the text is no table, or too large to be held whole.
    """
    reader, held, size = ReadingsReader(name), [], 0
    for piece in texts:
        block, text = None, piece
        if not reader.has_header:
            # The header alone: it says whether the rows may be taken one by one.
            held.append(text)
            joined = "".join(held)
            end = lines_end(joined)
            if end == 0 and len(joined) <= LONGEST_ROW:
                continue
            first = joined.find("\n") + 1 or end
            reader.feed(joined[:first])
            text, held = joined[first:], []
            whole = whole or "depth_row" in reader.columns
        if not whole:
            block = reader.feed(text)
        else:
            held.append(text)
            size += len(text)
            if size > WHOLE_LIMIT:
                remedy = "split it, or leave depth_row and lengths out"
                raise InputError.single(where=name, what="is larger than 200 MB", remedy=remedy)
        if block is not None:
            yield block
    block = reader.feed("".join(held), last=True)
    if not reader.has_header:
        remedy = "start with a header such as id,x1c,y1c,alpha2_deg"
        raise InputError.single(where=name, what="is empty", remedy=remedy)
    if block is not None:
        yield block
    elif whole and not reader.rows:
        remedy = "add a row for each reading"
        raise InputError.single(where=name, what="has a header but no rows", remedy=remedy)


@dataclass
class ReadingsReader:
    """Takes the text of a table in pieces, gives its rows in blocks.

    Parameters
    ----------
    name
        Of the table, for messages.
    """

    name: str
    _header: list[str] | None = None
    _rest: str = ""
    _line: int = 0
    _first: bool = True
    _empty: list[int] = field(default_factory=list)
    rows: int = 0

    def feed(self, text: str, *, last: bool = False) -> ReadingBlock | None:
        """Return the rows that are complete with this piece; None if there are none.

        A row is a line: no cell of a reading has a line break, and a quotation mark that is not
        closed spoils its own row alone.

        Raises
        ------
        InputError
            If the header is none, or lacks a column.
        """
        if self._first and text:
            text, self._first = text.removeprefix("\ufeff"), False
        text = self._rest + text
        end = len(text) if last else lines_end(text)
        text, self._rest = text[:end], text[end:][: LONGEST_ROW + 1]
        records, lines, faults = self._records(text)
        if self._header is None and records:
            if 0 in faults:
                where, remedy = f"{self.name}, line {lines[0]}", "save the table as CSV in UTF-8"
                raise InputError.single(where=where, what=f"header {faults[0]}", remedy=remedy)
            self._header = check_header(
                records[0], f"{self.name}, line {lines[0]}", GAZE_COLUMNS, REFERENCE_COLUMN
            )
            _require_sources(self._header, self.name)
            records, lines = records[1:], lines[1:]
            faults = {i - 1: fault for i, fault in faults.items()}
        return self._block(records, lines, faults) if records else None

    @property
    def has_header(self) -> bool:
        """Whether the header has been read."""
        return self._header is not None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns; none before the header has been read."""
        return tuple(self._header or ())

    def _records(self, text: str) -> tuple[list[list[str]], list[int], dict[int, str]]:
        """Return the rows of a text, the line of each, and what is wrong with the form of which.

        Blank lines are left out, and rows of nothing but commas where no other follows, as
        spreadsheets leave them at the end.
        """
        cells, wrong = parse_lines(text)
        first, self._line = self._line + 1, self._line + len(cells)
        records: list[list[str]] = []
        lines: list[int] = []
        faults: dict[int, str] = {}
        for i, record in enumerate(cells):
            if any(record) and any(cell.strip() for cell in record):
                if self._empty:
                    records += [[] for _ in self._empty]
                    lines += self._empty
                    self._empty = []
                if i in wrong:
                    faults[len(records)] = wrong[i]
                records.append(record)
                lines.append(first + i)
            elif len(record) > 1 and self._header is not None:
                self._empty.append(first + i)
        return records, lines, faults

    def _block(
        self, records: list[list[str]], lines: list[int], faults: dict[int, str]
    ) -> ReadingBlock:
        header = self._header or []
        width = len(header)
        for i, record in enumerate(records):
            if len(record) != width:
                cells = "1 cell" if len(record) == 1 else f"{len(record)} cells"
                count = f"has {cells}, the header has {width}"
                faults.setdefault(i, count if record else "is empty")
                records[i] = (record + [""] * width)[:width]
        columns = {
            name: tuple(map(str.strip, cells))
            for name, cells in zip(header, zip(*records, strict=True), strict=True)
        }
        self.rows += len(records)
        rows = _Rows(columns, len(records), faults)
        return rows.block(self.name, tuple(lines))


def _require_sources(header: Sequence[str], name: str) -> None:
    for choice in (("id",), ("x1c", "u1_px", "image_c1"), ("alpha2_deg", "ctan_alpha2")):
        if not any(column in header for column in choice):
            what = f"column {' or '.join(choice)} is missing"
            raise InputError.single(where=name, what=what, remedy="add it")
    pairs = (("x1c", "y1c"), ("u1_px", "v1_px"))
    if any(one in header and two in header for one, two in pairs):
        return
    for one, two in (*pairs, *(pair[::-1] for pair in pairs)):
        if one in header and two not in header:
            what = f"column {two} is missing: a position needs {one} and {two}"
            raise InputError.single(where=f"{name}, line 1", what=what, remedy=f"add {two}")


@dataclass
class _Rows:
    """Cells of some rows, and what is wrong with which."""

    columns: dict[str, tuple[str, ...]]
    count: int
    faults: dict[int, str]

    def block(self, name: str, lines: tuple[int, ...]) -> ReadingBlock:
        ids = self.texts("id")
        self._check_names()
        values = {column: self.numbers(column) for column in NUMBERS}
        self._check_sources()
        for i, fault in value_faults(values).items():
            self.faults.setdefault(i, fault)
        good = np.array([i for i in range(self.count) if i not in self.faults], dtype=np.int64)
        if len(good) == self.count:
            table = self._table(name, lines, ids, values)
        else:
            table = self._table(
                name,
                tuple(lines[i] for i in good),
                tuple(ids[i] for i in good),
                {column: array[good] for column, array in values.items()},
                good,
            )
        freeze(table)
        return ReadingBlock(ids, lines, table, good, self.faults)

    def _table(
        self,
        name: str,
        lines: tuple[int, ...],
        ids: tuple[str, ...],
        values: dict[str, FloatArray],
        good: IntArray | None = None,
    ) -> GazeTable:
        count = len(ids)
        nothing, unnamed = np.full(count, np.nan), (None,) * count
        depth_row = self.texts("depth_row")
        kept = depth_row if good is None else tuple(depth_row[i] for i in good)
        cotangent = values["ctan_alpha2"]
        return GazeTable(
            file=name,
            line=lines,
            ids=ids,
            groups=ids,
            x1c=values["x1c"],
            y1c=values["y1c"],
            u1_px=values["u1_px"],
            v1_px=values["v1_px"],
            image_c1=unnamed,
            # arccot on (0, pi), continuous through 90 degrees.
            alpha2_rad=np.where(
                np.isnan(cotangent), np.deg2rad(values["alpha2_deg"]), np.arctan2(1.0, cotangent)
            ),
            u2_px=values["u2_px"],
            image_c2=unnamed,
            z_mm=nothing,
            u_z_mm=nothing,
            stereo=unnamed,
            references={},
            depth_row=tuple(row or None for row in kept),
        )

    def texts(self, column: str) -> tuple[str, ...]:
        return self.columns.get(column, ("",) * self.count)

    def filled(self, column: str) -> BoolArray:
        if column not in self.columns:
            return np.zeros(self.count, dtype=np.bool_)
        return np.fromiter(map(bool, self.columns[column]), np.bool_, self.count)

    def mark(self, bad: BoolArray, fault: str) -> None:
        """Give rows a fault; the first one counts."""
        for i in map(int, np.flatnonzero(bad)):
            self.faults.setdefault(i, fault)

    def numbers(self, column: str) -> FloatArray:
        """Return a column as numbers, NaN where empty or faulty."""
        if column not in self.columns:
            return np.full(self.count, np.nan)
        texts = self.columns[column]
        joined = "".join(texts)
        if joined.isascii() and "_" not in joined:
            try:
                values = np.array([float(t) if t else np.nan for t in texts])
            except ValueError:
                pass
            else:
                if not np.isinf(values).any() and "a" not in joined.lower():
                    return values
        parsed = [parse_number(t) for t in texts]
        for i, value in enumerate(parsed):
            if isinstance(value, str):
                self.faults.setdefault(i, f"{column} {shown(texts[i])} {value}")
        return np.array([np.nan if isinstance(v, str) else v for v in parsed])

    def _check_names(self) -> None:
        for column in ("id", "depth_row"):
            texts = self.texts(column)
            if text_fault("".join(texts) or "-") is None:
                continue
            for i, text in enumerate(texts):
                fault = text_fault(text) if text else None
                if fault is not None:
                    self.faults.setdefault(i, f"{column} {fault}")
        if "" in self.texts("id"):
            self.mark(~self.filled("id"), "id is empty")

    def _check_sources(self) -> None:
        image = self.filled("image_c1") | self.filled("image_c2")
        self.mark(image, "names an image: measure takes coordinates")
        x, y = self.filled("x1c"), self.filled("y1c")
        u, v = self.filled("u1_px"), self.filled("v1_px")
        self.mark((x | y) & (u | v), "x1c and u1_px are given: give one of them")
        self.mark(~(x | y | u | v), "none of x1c with y1c, or u1_px with v1_px, is given")
        self.mark((x != y) & (x | y), "x1c or y1c is empty: give both")
        self.mark((u != v) & (u | v), "u1_px or v1_px is empty: give both")
        degrees, cotangent = self.filled("alpha2_deg"), self.filled("ctan_alpha2")
        self.mark(degrees & cotangent, "alpha2_deg and ctan_alpha2 are given: give one of them")
        self.mark(~(degrees | cotangent), "alpha2_deg is empty")
