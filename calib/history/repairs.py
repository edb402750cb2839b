"""When rigs were repaired or adjusted: a table that goes with an index."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection
from datetime import date
from pathlib import Path

from calib.core.errors import InputError, Problem
from calib.history.entry import one_spelling
from calib.instrument.measuring import table_text

RIG, DATE = "rig", "date"


def read_repairs(path: Path, *, known: Collection[str]) -> dict[str, date]:
    """Return the last repair of each rig that had one.

    Parameters
    ----------
    path
        CSV with columns rig (the serial number) and date (ISO 8601); others are notes.
    known
        Rigs of the index: one that is none of them is a mistake.

    Raises
    ------
    InputError
        Naming each row that cannot be used.
    """
    name = str(path)
    table = csv.DictReader(io.StringIO(table_text(path, name=name).removeprefix("\ufeff")))
    if missing := {RIG, DATE} - set(table.fieldnames or ()):
        raise InputError.single(
            where=name, what=f"has no column {' and '.join(sorted(missing))}",
            remedy=f"give columns {RIG} and {DATE}",
        )  # fmt: skip
    found: dict[str, date] = {}
    problems = []
    try:
        for row in table:
            serial, text = (one_spelling(row[column]) for column in (RIG, DATE))
            where = f"{name}:{table.line_num}"
            if serial not in known:
                what, remedy = f"no rig {serial!r} in the index", "calib history show lists them"
                problems.append(Problem(where, what, remedy))
                continue
            try:
                found[serial] = max(found.get(serial, date.min), date.fromisoformat(text))
            except ValueError:
                problems.append(Problem(where, f"{text!r} is no date", "write it as 2026-01-31"))
    except csv.Error as error:
        raise InputError.single(where=name, what=str(error), remedy="give a CSV table") from error
    if problems:
        raise InputError(tuple(problems))
    return found
