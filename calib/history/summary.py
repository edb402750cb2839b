"""A rig's history as text: its charts, the test of its uncertainties, its next calibration."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, timedelta

import numpy as np

from calib.core.errors import InputError
from calib.core.words import counted
from calib.history.due import LONGEST, Due, next_due
from calib.history.entry import IndexEntry
from calib.history.quantities import Series, series
from calib.uncertainty.charts import UNCERTAINTY_RISK, charts, reference, scatter_test

ACCEPTED = 3
"""Calibrations at acceptance: their weighted mean is the reference. With fewer its error hides
what the charts look for; with more a rig calibrated yearly has no chart for years."""

GUIDE = "ILAC-G24:2022 / OIML D 10"


def show(entries: Sequence[IndexEntry], *, accepted: int = ACCEPTED) -> list[list[str]]:
    """Return a table, its head first: each quantity with its charts' state and its scatter."""
    rows = [["quantity", "reference", "last", "u", "Shewhart", "EWMA", "CUSUM", "chi2/dof", ""]]
    return rows + [_line(s, accepted) for s in series(entries)]


def _line(s: Series, accepted: int) -> list[str]:
    at = reference(s.values[:accepted], s.std[:accepted])
    figures = [f"{s.name}, {s.unit}", f"{at.value:.6g}", f"{s.values[-1]:.6g}", f"{s.std[-1]:.2g}"]
    if len(s.values) <= accepted:
        states = ["-"] * 3
    else:
        found = charts(s.values[accepted:], s.std[accepted:], at)
        states = [
            f"{chart.statistic[-1]:+.1f}"
            if chart.first_alarm is None
            else f"ALARM {s.dates[accepted + chart.first_alarm]}"
            for chart in found
        ]
    if len(s.values) < 2:
        return [*figures, *states, "-", ""]
    ratio, p = scatter_test(s.values, s.std)
    note = ""
    if p < UNCERTAINTY_RISK:
        note = f"scatter exceeds stated u (p = {p:.1g}): u too small, or the rig has changed"
    elif p > 1 - UNCERTAINTY_RISK:
        note = "scatter below stated u: part of u is common to all, or from the prior"
    return [*figures, *states, f"{ratio:.2f}", note]


def notes(entries: Sequence[IndexEntry], *, accepted: int = ACCEPTED) -> list[str]:
    """Return what a reader of the table must know of this history."""
    found = []
    if len(entries) <= accepted:
        found.append(
            f"{len(entries)} of {counted(accepted, 'calibration')} at acceptance: no chart yet"
        )
    days = len({e.date for e in entries})
    if days < len(entries):
        made = f"{counted(len(entries), 'calibration')} on {counted(days, 'day')}"
        found.append(
            f"{made}: if these are the days of computing, state date under [certificate] in each "
            "dataset.toml"
        )
    if not all(e.has_serial for e in entries):
        found.append(
            "no serial number is stated: the name of the dataset stands in for it, and two rigs "
            "of one name would be taken for one; state serial under [rig] in each dataset.toml"
        )
    if _day(entries[-1].date) > date.today():
        found.append(f"the last calibration is dated in the future: {entries[-1].date}")
    models = sorted({e.model for e in entries})
    if len(models) > 1:
        found.append(
            f"models {', '.join(models)} were selected: delta2 and axis_z are compared for "
            f"{entries[0].model} only, and depths may differ by model"
        )
    return found


def since(entries: Sequence[IndexEntry], repaired: date | None) -> Sequence[IndexEntry]:
    """Return the calibrations that count: those before a repair are of another rig.

    Raises
    ------
    InputError
        If there are none.
    """
    kept = [e for e in entries if repaired is None or _day(e.date) >= repaired]
    if not kept:
        raise InputError.single(
            where=entries[0].rig,
            what=f"was not calibrated since it was repaired on {repaired}",
            remedy="calibrate it, or give another --repaired",
        )
    return kept


def due(entries: Sequence[IndexEntry], *, tolerance_mm: float) -> tuple[date, Due, Series] | None:
    """Return the earliest due date over the depths charted; None if there is no interval yet.

    Of calibrations on one day the last counts.
    """
    by_day = {e.date: e for e in entries}
    if len(by_day) < 2:
        return None
    days = np.array([float(_day(text).toordinal()) for text in by_day])
    found = [
        (next_due(days, s.values, s.std, tolerance=tolerance_mm), s)
        for s in series(list(by_day.values()))
        if s.name.startswith("depth")
    ]
    first, where = min(found, key=lambda pair: (pair[0].interval, -(pair[0].risk or 0)))
    # Whole days, rounded down: the date is not to be later than what was computed.
    latest = _day(list(by_day)[-1])
    left = (date.max - latest).days
    return latest + timedelta(days=min(int(first.interval), left)), first, where


def due_text(found: tuple[date, Due, Series]) -> list[str]:
    """Return a due date in words: the date, the method, the risk, and whether it is capped."""
    day, result, where = found
    when = f"due on {day}" if result.interval > 0 else "due at once"
    if result.interval > 0 and day < date.today():
        when += ", overdue"
    said = [f"{when}, decided by the {where.name}", f"{GUIDE}, {result.method}"]
    if result.risk is not None:
        said.append(f"probability of being out of tolerance then: {100 * result.risk:.1f} %")
    if result.capped:
        said.append(f"capped at {LONGEST} times the last interval")
    return said


def _day(text: str) -> date:
    return date.fromisoformat(text)
