"""From the text of a table to its columns, or to all its faults at once."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset.cells import Cells, read_cells, require_columns
from calib.dataset.conventions import readings_outside
from calib.dataset.history import read_approaches, read_times
from calib.dataset.messages import shortened, shown
from calib.dataset.plausible import (
    Guess,
    check_angles,
    check_cotangents,
    check_depths,
    check_lengths,
    check_normalised,
    check_sight_lines,
)
from calib.dataset.tables import GazeTable, LengthTable, ReturnTable, SweepTable, freeze

T = TypeVar("T")
T_table = TypeVar("T_table", GazeTable, SweepTable, LengthTable, ReturnTable)

GAZE_COLUMNS = (
    "id",
    "group",
    "x1c",
    "y1c",
    "u1_px",
    "v1_px",
    "image_c1",
    "alpha2_deg",
    "ctan_alpha2",
    "u2_px",
    "image_c2",
    "z_mm",
    "u_z_mm",
    "stereo",
    "time",
    "approach",
    "depth_row",
)
REFERENCE_COLUMN = r"z_([A-Za-z0-9][A-Za-z0-9_]*)_mm"
SWEEP_COLUMNS = ("id", "placement", "image_c2", "alpha2_deg")
LENGTH_COLUMNS = ("id", "from", "to", "length_mm", "u_length_mm")


@dataclass(frozen=True)
class Scanned(Generic[T]):
    """A table and its faults; where it has any, the table serves only to look for more.

    Parameters
    ----------
    table
        Values are NaN, and names empty, where a cell has a fault.
    problems
        All faults of the table taken alone.
    """

    table: T
    problems: tuple[Problem, ...]

    def sound(self) -> T:
        """Return the table.

        Raises
        ------
        InputError
            With all its faults, if it has any.
        """
        if self.problems:
            raise InputError(self.problems)
        return self.table


def scanned(cells: Cells, table: T_table) -> Scanned[T_table]:
    """Return a finished table, frozen, with the faults that its cells were found to have."""
    freeze(table)
    return Scanned(table, shortened(cells.problems, where=cells.file))


def read_gaze(text: str, *, name: str) -> GazeTable:
    """Return calibration or validation rows, each with a reference depth; `scan_gaze` or raise."""
    return scan_gaze(text, name=name).sound()


def read_measurements(text: str, *, name: str) -> GazeTable:
    """Return rows to be measured; a reference depth may be there, to be compared.

    Parameters
    ----------
    text
        Of the CSV table.
    name
        Of its file, for messages.

    Raises
    ------
    InputError
        Listing all faults of the table.
    """
    return scan_gaze(text, name=name, reference=False).sound()


def read_sweep(text: str, *, name: str) -> SweepTable:
    """Return the rows of a yaw sweep; `scan_sweep` or raise."""
    return scan_sweep(text, name=name).sound()


def read_lengths(text: str, *, name: str, known: bool = True) -> LengthTable:
    """Return distances between measured points; `scan_lengths` or raise."""
    return scan_lengths(text, name=name, known=known).sound()


def scan_gaze(
    text: str,
    *,
    name: str,
    reference: bool = True,
    by_board: bool = False,
    is_left: bool = False,
    step_deg: float | None = None,
) -> Scanned[GazeTable]:
    """Return calibration or validation rows and their faults.

    Parameters
    ----------
    text
        Of the CSV table.
    name
        Of its file, for messages.
    reference
        Whether each row needs a reference depth.
    by_board
        Whether pictures of the board by both cameras do instead: its squares give the scale.
    is_left
        Whether C2 stands at -X of C1.
    step_deg
        One count of the encoder, if it is stated.

    Raises
    ------
    InputError
        If the text is no table at all.
    """
    cells = read_cells(text, file=name, known=GAZE_COLUMNS, pattern=REFERENCE_COLUMN)
    _check_sources(cells, reference=reference, by_board=by_board)
    ids = identities(cells)
    x1c, y1c = _pair(cells, "x1c", "y1c", alone=reference)
    u1_px, v1_px = _pair(cells, "u1_px", "v1_px", alone=False)
    check_normalised(cells, "x1c", x1c)
    check_normalised(cells, "y1c", y1c)
    z_mm, u_z_mm = _depths(cells)
    outside = partial(readings_outside, x1c=x1c, z_mm=z_mm, step_deg=step_deg, is_left=is_left)
    alpha2 = _alpha2(cells, outside)
    check_sight_lines(cells, x1c, alpha2, z_mm, is_left=is_left)
    groups = cells.names("group")
    table = GazeTable(
        file=name,
        line=cells.lines,
        ids=ids,
        groups=tuple(group or identity for group, identity in zip(groups, ids, strict=True)),
        x1c=x1c,
        y1c=y1c,
        u1_px=u1_px,
        v1_px=v1_px,
        image_c1=cells.names("image_c1"),
        alpha2_rad=alpha2,
        u2_px=cells.numbers("u2_px"),
        image_c2=cells.names("image_c2"),
        z_mm=z_mm,
        u_z_mm=u_z_mm,
        stereo=cells.names("stereo"),
        references=_references(cells),
        depth_row=_depth_rows(cells, ids),
        time_s=read_times(cells),
        approach=read_approaches(cells),
    )
    return scanned(cells, table)


def _check_sources(cells: Cells, *, reference: bool, by_board: bool) -> None:
    """Report rows without exactly one source of the coordinate, the reading and the reference."""
    pictured = np.zeros(len(cells.lines), dtype=np.bool_)
    if by_board and "image_c1" in cells and "image_c2" in cells:
        pictured = cells.present("image_c1", "image_c2")
    coordinate = ("x1c", "u1_px", "image_c1")
    reading = ("alpha2_deg", "ctan_alpha2")
    depth = ("z_mm", "stereo")
    needed = [depth] if reference and not pictured.all() else []
    require_columns(cells, (("id",), coordinate, reading, *needed))
    _one_of(cells, [("x1c", "y1c"), ("u1_px", "v1_px"), ("image_c1",)], needed=True)
    _one_of(cells, [("alpha2_deg",), ("ctan_alpha2",)], needed=True)
    _one_of(cells, [("u2_px",), ("image_c2",)], needed=False)
    _one_of(cells, [("z_mm",), ("stereo",)], needed=reference, without=pictured)


def scan_sweep(text: str, *, name: str) -> Scanned[SweepTable]:
    """Return the rows of a yaw sweep and their faults; parameters and errors as `scan_gaze`."""
    cells = read_cells(text, file=name, known=SWEEP_COLUMNS)
    require_columns(cells, [(column,) for column in SWEEP_COLUMNS])
    table = SweepTable(
        file=name,
        line=cells.lines,
        ids=identities(cells),
        placements=filled(cells, "placement"),
        image_c2=filled(cells, "image_c2"),
        alpha2_rad=_degrees(cells, needed=True),
    )
    _unique(cells, "image_c2", "each turn of the sweep needs an image of its own")
    return scanned(cells, table)


def scan_lengths(text: str, *, name: str, known: bool = True) -> Scanned[LengthTable]:
    """Return distances between measured points and their faults; errors as `scan_gaze`.

    Parameters
    ----------
    text, name
        As `scan_gaze`.
    known
        Whether the lengths must be given; if not, they are what is asked for.
    """
    cells = read_cells(text, file=name, known=LENGTH_COLUMNS)
    needed = LENGTH_COLUMNS if known else ("id", "from", "to")
    require_columns(cells, [(column,) for column in needed])
    start, end = filled(cells, "from"), filled(cells, "to")
    same = [bool(a) and a == b for a, b in zip(start, end, strict=True)]
    cells.report(same, "to", "is the same row as 'from'", "give two different rows")
    length, u_length = cells.numbers("length_mm"), cells.numbers("u_length_mm")
    if known:
        for column in ("length_mm", "u_length_mm"):
            _require_filled(cells, column, "give a value in mm")
    check_lengths(cells, length, u_length)
    table = LengthTable(name, cells.lines, identities(cells), start, end, length, u_length)
    return scanned(cells, table)


def _require_filled(cells: Cells, column: str, remedy: str = "fill it in every row") -> None:
    """Report empty cells; a missing column is reported by `require_columns`."""
    if column in cells:
        cells.report(~cells.present(column), column, "is empty", remedy)


def filled(cells: Cells, column: str) -> tuple[str, ...]:
    """Return a column of names; reports empty cells."""
    names = cells.names(column)
    _require_filled(cells, column)
    return tuple(n or "" for n in names)


def _unique(cells: Cells, column: str, remedy: str) -> None:
    """Report cells that repeat an earlier one of the column."""
    texts = cells.texts(column)
    if len(set(texts)) == len(texts):
        return
    first: dict[str, int] = {}
    bad = np.zeros(len(cells), dtype=bool)
    for i, text in enumerate(texts):
        bad[i] = text != "" and first.setdefault(text, i) != i
    cells.report(
        bad,
        column,
        lambda i: f"{shown(texts[i])} stands in line {cells.lines[first[texts[i]]]} already",
        remedy,
    )


def identities(cells: Cells) -> tuple[str, ...]:
    """Return the ids; reports empty and repeated ones."""
    ids = filled(cells, "id")
    _unique(cells, "id", "give each row an id of its own")
    return ids


def _one_of(
    cells: Cells,
    sources: list[tuple[str, ...]],
    *,
    needed: bool,
    without: BoolArray | bool = False,
) -> None:
    """Report rows that fill none, or more than one, of several sources of one quantity.

    A source the table has no column for is reported once, by `require_columns`, not row by row.

    Parameters
    ----------
    without
        Rows that need none.
    """
    names = " or ".join(" with ".join(source) for source in sources)
    if not any(column in cells for source in sources for column in source):
        return
    given_by = np.stack([cells.present(*source) for source in sources])
    count = given_by.sum(axis=0)

    def several(row: int) -> str:
        given = [source[0] for source, f in zip(sources, given_by[:, row], strict=True) if f]
        return f"{' and '.join(given)} are given"

    cells.report(count > 1, None, several, f"give one of {names}")
    if needed:
        cells.report(
            (count == 0) & ~np.asarray(without),
            None,
            f"none of {names} is given",
            "fill one of them",
        )


def _pair(cells: Cells, first: str, second: str, *, alone: bool) -> tuple[FloatArray, FloatArray]:
    """Return two columns that belong together; reports rows with only one of them.

    If `alone`, the table may do without the second column altogether.
    """
    has_first, has_second = cells.present(first), cells.present(second)
    if not (alone and second not in cells):
        remedy = f"give both {first} and {second}"
        cells.report(has_second & ~has_first, first, "is empty", remedy)
        if second in cells or not has_first.any():
            cells.report(has_first & ~has_second, second, "is empty", remedy)
        else:
            cells.suspect(first, f"has no column {second} beside it", remedy)
    return cells.numbers(first), cells.numbers(second)


def _degrees(cells: Cells, outside: Guess = lambda _: None, *, needed: bool) -> FloatArray:
    """Return alpha2_deg in rad; reports what is outside (0, 180) or looks like radians."""
    degrees = cells.numbers("alpha2_deg")
    if needed:
        _require_filled(cells, "alpha2_deg")
    return np.deg2rad(check_angles(cells, degrees, outside))


def _alpha2(cells: Cells, outside: Guess) -> FloatArray:
    """Return encoder readings, rad, shape (n,), from either column."""
    radians = _degrees(cells, outside, needed=False)
    cotangents = cells.numbers("ctan_alpha2")
    check_cotangents(cells, cotangents)
    # arccot on (0, pi), continuous through 90 degrees.
    return np.where(np.isnan(cotangents), radians, np.arctan2(1.0, cotangents))


def _depths(cells: Cells) -> tuple[FloatArray, FloatArray]:
    """Return reference depths and their standard uncertainties, mm, shape (n,) each."""
    z_mm, u_z_mm = cells.numbers("z_mm"), cells.numbers("u_z_mm")
    check_depths(cells, "z_mm", z_mm)
    cells.report(u_z_mm < 0, "u_z_mm", lambda i: f"{u_z_mm[i]:g} is negative", "give it positive")
    cells.report(
        u_z_mm >= z_mm,
        "u_z_mm",
        lambda i: f"{u_z_mm[i]:g} is not smaller than z_mm = {z_mm[i]:g}",
        "give the standard uncertainty of z_mm, in mm",
    )
    orphan: BoolArray = cells.present("u_z_mm") & ~cells.present("z_mm")
    cells.report(orphan, "u_z_mm", "is given without z_mm", "leave it empty in this row")
    return z_mm, u_z_mm


def _references(cells: Cells) -> dict[str, FloatArray]:
    """Return the further references, mm, by name."""
    names = [c for c in cells.columns if re.fullmatch(REFERENCE_COLUMN, c)]
    references = {column[2:-3]: cells.numbers(column) for column in names}
    for column, values in zip(names, references.values(), strict=True):
        check_depths(cells, column, values)
    return references


def _depth_rows(cells: Cells, ids: tuple[str, ...]) -> tuple[str | None, ...]:
    """Return the rows whose depth is used; reports unknown ones and chains."""
    rows = cells.names("depth_row")
    own = {identity: row in (None, identity) for identity, row in zip(ids, rows, strict=True)}
    cells.report(
        [row is not None and row not in own for row in rows],
        "depth_row",
        lambda i: f"{shown(rows[i])} is not the id of a row of this table",
        "name the row whose depth this one uses",
    )
    cells.report(
        [row is not None and not own.get(row, True) for row in rows],
        "depth_row",
        lambda i: f"{shown(rows[i])} takes its own depth from another row",
        "name a row that measures its depth itself",
    )
    return rows
