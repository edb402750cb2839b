"""A check standard gazed at by the rig itself: one session, and its rows in the table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from calib.core.errors import InputError
from calib.gaze.aim import Aiming
from calib.gaze.gazing import Gazer
from calib.gaze.row import GazeRow, refuse_moved
from calib.gaze.target import Target, target
from calib.geometry.board import Board
from calib.history.certified import Standard
from calib.history.sessions import DATE, SEEN_COLUMNS, TARGET

COLUMNS = (DATE, TARGET, "u1_px", "v1_px", "u2_px", "alpha2_deg", *SEEN_COLUMNS)
"""Of a table that is begun; one that is there keeps its own and gets those that it lacks."""


def targets_of(standard: Standard, board: Board | None) -> dict[str, Target]:
    """Return what the rig looks for, by the standard's names; `[targets]` or the names say it.

    Parameters
    ----------
    board
        Of the rig, None without.

    Raises
    ------
    UsageError
        If a name is no target of `calib gaze`, or needs a board and there is none.
    """
    return {name: target(standard.gazed_as(name), board) for name in standard.targets}


def gaze_standard(
    gazer: Gazer, aiming: Aiming, targets: Mapping[str, Target]
) -> dict[str, GazeRow]:
    """Gaze at each target once; the first is looked at again at the end.

    A standard that moved meanwhile has other lengths than its certificate says.

    Raises
    ------
    RigError
        If one cannot be gazed at, or moved; the message says why.
    """
    eyes = {name: replace(gazer, target=one) for name, one in targets.items()}
    rows = {name: eye.gaze(aiming) for name, eye in eyes.items()}
    first = next(iter(eyes))
    again = eyes[first].find_in_c1()
    refuse_moved(f"C1, {first}:", rows[first].c1, [again], eyes[first].noise_c1)
    return rows


def with_session(text: str, rows: Mapping[str, GazeRow], *, date: str, name: str) -> str:
    """Return the table of sessions with one more.

    Parameters
    ----------
    text
        The table so far, empty for none; its rows stay as they are.
    date
        Of the session, local time, ISO 8601.
    name
        Of the table, for messages.

    Raises
    ------
    InputError
        If the text is no CSV.
    """
    header, records = _records(text, name)
    columns = [*header, *(column for column in COLUMNS if column not in header)]
    blank = [""] * (len(columns) - len(header))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        [*record, *blank] if len(record) == len(header) else record for record in records
    )
    for target_name, row in rows.items():
        cells = {DATE: date, TARGET: target_name, **_cells(row)}
        writer.writerow([cells.get(column, "") for column in columns])
    return out.getvalue()


def _records(text: str, name: str) -> tuple[list[str], list[list[str]]]:
    """Return the header, blanks around its names left out, and the other records."""
    try:
        records = [r for r in csv.reader(io.StringIO(text.removeprefix("\ufeff"))) if any(r)]
    except csv.Error as error:
        raise InputError.single(
            where=name, what=f"is no table ({error})", remedy="save it as CSV UTF-8"
        ) from None
    return ([cell.strip() for cell in records[0]], records[1:]) if records else ([], [])


def has_sessions(text: str, *, name: str) -> bool:
    """Return whether a table holds more than a header.

    Raises
    ------
    InputError
        If the text is no CSV.
    """
    return bool(_records(text, name)[1])


def _cells(row: GazeRow) -> dict[str, str]:
    names = ("u1_px", "v1_px", "u2_px", "v2_px")
    pixels: Sequence[float] = (*row.pixel_c1, *row.pixel_c2)
    cells = dict(zip(names, (f"{p:.5f}" for p in pixels), strict=True))
    # Rounded up: an uncertainty of 0 would be none.
    stated = (("u_c1_px", row.u_c1_px), ("u_c2_px", row.u_c2_px))
    u = {name: f"{math.ceil(1e5 * value) / 1e5:.5f}" for name, value in stated}
    reading = f"{math.degrees(row.standstill.reading_rad):.9f}"
    return cells | {"alpha2_deg": reading} | u
