"""The table of a check standard's sessions: targets read at one time, and where they were then."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, time

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset.cells import parse_number
from calib.dataset.readings import ReadingBlock, read_blocks
from calib.dataset.tables import GazeTable
from calib.geometry.camera import on_centre_row
from calib.history.certified import Standard
from calib.instrument.calibration_file import Measuring
from calib.instrument.measuring import Measured, measure
from calib.instrument.rig import reading_table
from calib.rows.from_table import ImageObservations

DATE, TARGET = "date", "id"

U_COLUMNS = ("u_c1_px", "u_c2_px")
"""Standard uncertainty of a row's pixels in C1 and C2; where empty, the usual one of tables."""

SEEN_COLUMNS = (*U_COLUMNS, "v2_px")
"""What a rig that gazes knows beyond the columns of `calib measure`; v2_px where C2 saw the target
in height, without which a lens turns the residual a little."""


@dataclass(frozen=True)
class ReadingSession:
    """The targets as read at one time.

    Parameters
    ----------
    date
        ISO 8601, as the table has it.
    at
        Place of each target among the measured rows, by name.
    """

    date: str
    at: dict[str, int]


def read_sessions(
    measuring: Measuring, standard: Standard, text: str, *, name: str
) -> list[tuple[Measured, ReadingSession]]:
    """Return the sessions in time order, each with the positions that it refers to.

    Parameters and errors are those of `calib.history.standard.check_standard`.
    """
    block, own = _block(text, name)
    sessions = _sessions(block, standard, name)
    read = _measured(measuring, block, own[block.place], sessions, name)
    _refuse_one_place(read, standard, name)
    return read


def _measured(
    measuring: Measuring,
    block: ReadingBlock,
    own: FloatArray,
    sessions: Sequence[ReadingSession],
    name: str,
) -> list[tuple[Measured, ReadingSession]]:
    """Return each session with the positions that it refers to.

    Parameters
    ----------
    own
        `SEEN_COLUMNS`, shape (n, 3), NaN where not stated. A session for which uncertainties are
        is measured by itself, with the largest of them.
    """
    whole = measure(measuring, block.table)
    _refuse_faults(block, whole, name)
    found = []
    for session in sessions:
        rows = list(session.at.values())
        if np.isnan(own[rows, :2]).all():
            found.append((whole, session))
            continue
        part = _rows_of(block.table, rows)
        alone = measure(measuring, part, _seen(measuring, part, own[rows]))
        # Not to be: the same rows have been measured above. A chart of NaN would never alarm.
        if alone.faults:
            raise InputError(
                [
                    Problem(f"{name}, {session.date}, {list(session.at)[i]}", why, "read it again")
                    for i, why in sorted(alone.faults.items())
                ]
            )
        at = {target: i for i, target in enumerate(session.at)}
        found.append((alone, ReadingSession(session.date, at)))
    return found


def _rows_of(table: GazeTable, rows: Sequence[int]) -> GazeTable:
    """Return some readings of a table as one of their own."""
    columns = {
        name: getattr(table, name)[rows] for name in ("x1c", "y1c", "u1_px", "v1_px", "u2_px")
    }
    return reading_table(columns | {"alpha2_deg": np.rad2deg(table.alpha2_rad[rows])})


def _seen(measuring: Measuring, table: GazeTable, own: FloatArray) -> ImageObservations:
    """Return the pixels whose uncertainty is stated, with the largest of each camera."""
    nothing = np.full(len(table), np.nan)
    largest = [np.nanmax(u, initial=0.0) for u in own[:, :2].T]
    u_c1, u_c2 = np.isfinite(own[:, :2]).T
    lens = measuring.setup.cameras.c2
    pixel_c2 = np.full((len(table), 2), np.nan)
    if lens is not None:
        pixel_c2 = on_centre_row(lens, table.u2_px)
        pixel_c2[:, 1] = np.where(np.isnan(own[:, 2]), pixel_c2[:, 1], own[:, 2])
    return ImageObservations(
        pixel_c1=np.where(u_c1[:, None], np.stack([table.u1_px, table.v1_px], axis=1), np.nan),
        pixel_c2=np.where(u_c2[:, None], pixel_c2, np.nan),
        u_c1_px=float(largest[0]),
        u_c2_px=float(largest[1]),
        z_mm=nothing,
        u_z_mm=nothing,
        z_by_common=np.zeros((len(table), measuring.setup.shared.factor.shape[1])),
    )


def _block(text: str, name: str) -> tuple[ReadingBlock, FloatArray]:
    """Return the rows, each with an id of its own, target and date, and the u of their pixels."""
    try:
        records = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"))))
    except csv.Error as error:
        raise InputError.single(
            where=name, what=f"is no table ({error})", remedy="save it as CSV UTF-8"
        ) from None
    header = [cell.strip() for cell in records[0]] if records else []
    for column in (DATE, TARGET):
        if header.count(column) != 1:
            raise InputError.single(
                where=name, what=f"has no column {column}", remedy=f"add {column} to its header"
            )
    date, target = header.index(DATE), header.index(TARGET)
    here = {date, *(k for k, column in enumerate(header) if column in SEEN_COLUMNS)}
    problems, out, own = [], io.StringIO(), []
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([cell for k, cell in enumerate(header) if k not in here])
    for line, cells in enumerate(records[1:], 2):
        record = cells
        if any(cell.strip() for cell in cells):
            own.append((math.nan,) * len(SEEN_COLUMNS))
        if len(record) == len(header):
            given, one = record[date].strip(), record[target].strip()
            day = _one_spelling(given)
            if day is None:
                problems.append(
                    Problem(
                        f"{name}, line {line}, column {DATE}",
                        f"{given!r} is no date", "write 2026-01-31 or 2026-01-31T08:00, local time",
                    )
                )  # fmt: skip
            cells_of = dict(zip(header, record, strict=True))
            own[-1] = _seen_cells(cells_of, f"{name}, line {line}", problems)
            named = [*record[:target], f"{one} {day}", *record[target + 1 :]]
            record = [cell for k, cell in enumerate(named) if k not in here]
        writer.writerow(record)
    if "depth_row" in header:
        raise InputError.single(
            where=name,
            what="has the column depth_row",
            remedy="leave it out: targets have depths of their own",
        )
    if problems:
        raise InputError(problems)
    (block,) = read_blocks(iter([out.getvalue()]), name=name, whole=True)
    return block, np.array(own)


def _seen_cells(cells: Mapping[str, str], where: str, problems: list[Problem]) -> tuple[float, ...]:
    """Return a row's `SEEN_COLUMNS`, NaN where there are none."""
    found = []
    for column, pixel in zip(SEEN_COLUMNS, ("u1_px", "u2_px", "u2_px"), strict=True):
        text = cells.get(column, "").strip()
        value = parse_number(text) if text else math.nan
        if isinstance(value, str) or (value <= 0 and column in U_COLUMNS):
            what = f"{column} {text} is no {'uncertainty' if column in U_COLUMNS else 'number'}"
            problems.append(Problem(where, what, "write one above 0, or leave it out"))
            value = math.nan
        elif text and not cells.get(pixel, "").strip():
            problems.append(Problem(where, f"{column} is given without {pixel}", "give both"))
        found.append(value)
    return tuple(found)


def _one_spelling(text: str) -> str | None:
    """Return a date, or date and time, as this program writes it; None if it is neither.

    The same time spelt in two ways is one session, not two.
    """
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        return None
    if at.tzinfo is not None:
        return None
    midnight = at.time() == time.min
    return at.date().isoformat() if midnight else at.isoformat()


def _sessions(block: ReadingBlock, standard: Standard, name: str) -> tuple[ReadingSession, ...]:
    by_date: dict[str, dict[str, int]] = {}
    problems = []
    for row, place in enumerate(block.place.tolist()):
        target, _, date = block.ids[place].rpartition(" ")
        session = by_date.setdefault(date, {})
        if target in session:
            where = f"{name}, line {block.lines[place]}"
            what = f"{target} is read twice at {date}"
            problems.append(Problem(where, what, "give each session a time, as 2026-01-31T08:00"))
        session[target] = row
    problems += [
        Problem(f"{name}, {date}", f"{target} is not read", "read it, or leave out the session")
        for date, at in by_date.items()
        for target in standard.targets
        if target not in at
    ]
    if problems:
        raise InputError(problems)
    ordered = sorted(by_date, key=datetime.fromisoformat)
    return tuple(ReadingSession(date, by_date[date]) for date in ordered)


def _refuse_faults(block: ReadingBlock, measured: Measured, name: str) -> None:
    faults = block.faults | {int(block.place[i]): why for i, why in measured.faults.items()}
    if faults:
        raise InputError(
            [
                Problem(f"{name}, line {block.lines[i]} ({block.ids[i]})", why, "read it again")
                for i, why in sorted(faults.items())
            ]
        )


def _refuse_one_place(
    read: Sequence[tuple[Measured, ReadingSession]], standard: Standard, name: str
) -> None:
    """Raise if both ends of a length were read at one place: it has no direction, and no u."""
    problems = [
        Problem(
            f"{name}, {session.date}",
            f"{' and '.join(one.between)} have the same readings",
            "read each of them, or leave out the session",
        )
        for measured, session in read
        for one in standard.length
        if np.array_equal(*(measured.position_mm[session.at[end]] for end in one.between))
    ]
    if problems:
        raise InputError(problems)
