"""Columns that say how a row was taken: when, and from which side the axis came to rest."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.cells import Cells
from calib.dataset.messages import shown


def read_times(cells: Cells) -> FloatArray:
    """Return the column ``time`` in s, shape (n,); shape (0,) without it.

    Numbers are s from any origin, everything else is a date and time of ISO 8601.
    """
    column = "time"
    if column not in cells:
        return np.zeros(0)
    texts = cells.texts(column)
    _require(cells, column, "give every row its time, or leave the column out")
    if all(_is_number(text) for text in texts if text):
        return cells.numbers(column)
    moments = [_moment(text) for text in texts]
    bad = [moment is None and text != "" for moment, text in zip(moments, texts, strict=True)]
    cells.report(
        bad,
        column,
        lambda i: f"{shown(texts[i])} is neither seconds nor a date and time",
        "write it as 2026-03-31T14:05:09, in all rows, or as seconds in all rows",
    )
    return np.array([np.nan if moment is None else moment for moment in moments])


def read_approaches(cells: Cells) -> FloatArray:
    """Return the column ``approach``, -1 or 1, shape (n,); shape (0,) without it."""
    column = "approach"
    if column not in cells:
        return np.zeros(0)
    _require(cells, column, "give every row its side, or leave the column out")
    sides = cells.numbers(column)
    cells.report(
        np.isfinite(sides) & (np.abs(sides) != 1),
        column,
        lambda i: f"{sides[i]:g} is no side",
        "write 1 where the reading grew as the axis came to rest, -1 where it fell",
    )
    return sides


def _require(cells: Cells, column: str, remedy: str) -> None:
    cells.report(~cells.present(column), column, "is empty", remedy)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _moment(text: str) -> float | None:
    """Return a date and time in s; a time without zone is taken as UTC."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return moment.timestamp()
