"""A rig's history, and that of all rigs, as pages."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

from calib.core.errors import CalibError, InputError
from calib.core.words import counted
from calib.history.drawing import chart_rows, legend
from calib.history.drift import drifts
from calib.history.entry import IndexEntry
from calib.history.output import changes_tables
from calib.history.quantities import series
from calib.history.read import read_run
from calib.history.summary import due, due_text, notes, show, since
from calib.report.plain_page import (
    Block,
    Cell,
    FigureRow,
    Link,
    PlainTable,
    StateCell,
    Text,
    plain_page,
)
from calib.uncertainty.charts import charts, reference

GENERATOR = "calib history page"

REPORT = "report.html"


def rig_page(
    history: Sequence[IndexEntry],
    *,
    accepted: int,
    tolerance_mm: float | None,
    repaired: date | None = None,
) -> str:
    """Return the page of one rig.

    Parameters
    ----------
    history
        Its calibrations in time order.
    accepted
        Calibrations that make the reference.
    tolerance_mm
        Largest tolerated error of a depth by drift; without it no due date is given.
    repaired
        Its last repair; calibrations before it do not count.
    """
    entries, unknown = _counting(history, repaired)
    head, *rows = show(entries, accepted=accepted)
    said = [*_state(entries, accepted), *notes(entries, accepted=accepted)]
    # Calibrations of before the repair tell nothing of when the next one is due.
    said = [f"{unknown}: what follows is of before."] if unknown else said
    said += [] if unknown else _due(entries, tolerance_mm)
    if repaired is not None and not unknown:
        said.append(f"Repaired on {repaired}: calibrations before do not count.")
    blocks: list[Block] = [Text(text) for text in said]
    # A note below its line: beside it, it would squeeze the figures.
    lines = [cells for row in rows for cells in (_states(row[:-1]), [row[-1]]) if cells != [""]]
    blocks.append(PlainTable("Control charts", head[:-1], lines))
    if len(entries) > accepted:
        drawn = chart_rows(series(entries), accepted=accepted)
        blocks.append(FigureRow("Charts", drawn, legend(accepted=accepted, of="calibrations")))
    blocks += _last_change(entries)
    blocks.append(_calibrations(entries))
    return plain_page(f"Rig {entries[0].rig}", blocks, generator=GENERATOR)


def fleet_page(
    rigs: Sequence[Sequence[IndexEntry]],
    *,
    accepted: int,
    tolerance_mm: float | None,
    repairs: Mapping[str, date] | None = None,
) -> str:
    """Return the page of all rigs, those with alarms first; each leads to its own page."""
    rows: list[tuple[int, str, list[Cell]]] = []
    for history in rigs:
        entries, unknown = _counting(history, (repairs or {}).get(history[0].rig))
        alarms = [unknown] if unknown else _alarms(entries, accepted)
        state = (
            StateCell("; ".join(alarms), good=False)
            if alarms
            else StateCell("in control", good=True)
        )
        charted: Cell = state if alarms or len(entries) > accepted else "no chart yet"
        day = "" if unknown or tolerance_mm is None else _day(entries, tolerance_mm)
        serial = entries[0].rig
        row: list[Cell] = [
            Link(serial, page_name(serial)), str(len(entries)), entries[-1].date, charted,
        ]  # fmt: skip
        rows.append((-len(alarms), serial, [*row, *([] if tolerance_mm is None else [day])]))
    head = ["rig", "calibrations", "last", "charts", *([] if tolerance_mm is None else ["due"])]
    table = PlainTable("", head, [row for _, _, row in sorted(rows, key=lambda r: r[:2])])
    number = sum(alarms < 0 for alarms, _, _ in rows)
    said = f"{counted(len(rows), 'rig')}, {number or 'none'} with an alarm."
    return plain_page("All rigs", [Text(said), table], generator=GENERATOR)


def page_name(serial: str) -> str:
    """Return the file name of a rig's page: readable, harmless, and of this rig alone."""
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", serial)[:60].lstrip(".-") or "rig"
    if plain == serial and plain != "index":
        return f"{plain}.html"
    return f"{plain}-{hashlib.sha256(serial.encode()).hexdigest()[:8]}.html"


def _alarms(entries: Sequence[IndexEntry], accepted: int) -> list[str]:
    found: list[str] = []
    if len(entries) <= accepted:
        return found
    for one in series(entries):
        at = reference(one.values[:accepted], one.std[:accepted])
        names = [
            chart.name
            for chart in charts(one.values[accepted:], one.std[accepted:], at)
            if chart.first_alarm is not None
        ]
        if names:
            found.append(f"{one.name} ({', '.join(names)})")
    return found


def _state(entries: Sequence[IndexEntry], accepted: int) -> list[str]:
    """Return whether the rig is in control, in words; nothing where there is no chart yet."""
    if len(entries) <= accepted:
        return []
    alarms = _alarms(entries, accepted)
    return [f"Alarm: {'; '.join(alarms)}." if alarms else "All charts are in control."]


def _states(row: Sequence[str]) -> list[Cell]:
    return [StateCell(cell, good=False) if cell.startswith("ALARM") else cell for cell in row]


def _counting(
    history: Sequence[IndexEntry], repaired: date | None
) -> tuple[Sequence[IndexEntry], str | None]:
    """Return the calibrations that count, or all of them and why none does."""
    try:
        return since(history, repaired), None
    except InputError:
        return history, f"Not calibrated since its repair on {repaired}"


def _day(entries: Sequence[IndexEntry], tolerance_mm: float) -> Cell:
    found = due(entries, tolerance_mm=tolerance_mm)
    if found is None:
        return ""
    day = found[0].isoformat()
    return StateCell(f"overdue {day}", good=False) if found[0] < date.today() else day


def _due(entries: Sequence[IndexEntry], tolerance_mm: float | None) -> list[str]:
    if tolerance_mm is None:
        return []
    found = due(entries, tolerance_mm=tolerance_mm)
    if found is None:
        return ["No due date: there is no interval between two calibrations yet."]
    return [f"Next calibration, for {tolerance_mm:g} mm: {'; '.join(due_text(found))}."]


def _last_change(entries: Sequence[IndexEntry]) -> list[Block]:
    """Return what changed last, if both calibrations are still there."""
    if len(entries) < 2:
        return []
    try:
        runs = [read_run(Path(entry.path)) for entry in entries[-2:]]
    except CalibError as error:
        return [Text(f"The last two calibrations cannot be compared: {error}")]
    return [
        PlainTable(f"What changed last. {title}", head, rows)
        for title, (head, *rows) in changes_tables(drifts(runs))
    ]


def _calibrations(entries: Sequence[IndexEntry]) -> PlainTable:
    rows: list[list[Cell]] = [
        [e.date, e.dataset, e.model, Link(e.path, (Path(e.path) / REPORT).as_uri())]
        for e in reversed(entries)
    ]
    return PlainTable("Calibrations", ["date", "dataset", "model", "report"], rows)
