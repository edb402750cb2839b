"""The record of a check standard, as text and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date

import numpy as np
from scipy.special import chdtrc, ndtri

from calib.core.arrays import BoolArray
from calib.history.causes import likely_causes
from calib.history.drawing import chart_rows, legend
from calib.history.standard import Checked, chart_all, degrees_of_freedom, lasting
from calib.report.plain_page import Block, Cell, FigureRow, PlainTable, StateCell, Text, plain_page
from calib.uncertainty.charts import RUN_LENGTH, Chart

GENERATOR = "calib history check"

FITS = 0.01
"""A cause is named while changes as large as what it leaves over are no rarer by chance."""

UNITS_MM = {"m": 1000.0, "cm": 10.0, "inches": 25.4, "micrometres": 1e-3}
UNIT_SLACK = 0.05
"""No rig that is off by as much as one of these factors is off by it to within this."""

HEAD = ["quantity", "certified", "last", "u", "deviation / U", "Shewhart", "EWMA", "CUSUM"]


def table(checked: Checked, *, accepted: int) -> list[list[str]]:
    """Return a line a quantity, the head first; of each chart how it is at the last session."""
    rows = [HEAD]
    last = checked.normalised[-1]
    drawn = chart_all(checked, accepted=accepted)
    for k, (name, found) in enumerate(zip(checked.names, drawn, strict=True)):
        states = [_state(chart, checked.dates[accepted:]) for chart in found] or ["-"] * 3
        agrees = f"{last[k]:+.2f}" + (" OUTSIDE" if abs(last[k]) > 1 else "")
        rows.append([
            f"{name}, mm", f"{checked.certified[k]:.6g}", f"{checked.values[-1, k]:.6g}",
            f"{checked.std[-1, k]:.2g}", agrees, *states,
        ])  # fmt: skip
    return rows


def _state(chart: Chart, dates: Sequence[str]) -> str:
    since = lasting(chart.outside)
    return f"{chart.statistic[-1]:+.1f}" if since is None else f"ALARM {dates[since]}"


def _outside(checked: Checked, accepted: int) -> BoolArray:
    """Return the sessions at which any chart is outside its limits, shape (n,)."""
    found = np.zeros(len(checked.dates), dtype=np.bool_)
    for drawn in chart_all(checked, accepted=accepted):
        for chart in drawn:
            found[accepted:] |= chart.outside
    return found


def alarm(checked: Checked, *, accepted: int) -> int | None:
    """Return since which session some chart is outside its limits up to the last; None if none is.

    Of a daily record each chart is outside about once a year by chance, and comes back: that is
    told by `earlier`, and the rig is not called changed for it for ever.
    """
    return lasting(_outside(checked, accepted))


CHANCE = 0.01
"""A single deviation that came back is none of chance if of sound records so few have one."""


def earlier(checked: Checked, *, accepted: int) -> tuple[str, bool]:
    """Return what charts showed that are inside again, empty if nothing, and if it is an alarm."""
    since = alarm(checked, accepted=accepted)
    outside = _outside(checked, accepted)[:since]
    if not outside.any():
        return "", False
    number = len(checked.dates) - accepted
    drawn = chart_all(checked, accepted=accepted)
    limit = float(-ndtri(CHANCE / 2 / (number * len(drawn))))
    far = [np.abs(found[0].statistic[: len(outside) - accepted]) for found in drawn]
    worst = int(np.argmax(np.max(far, axis=0)))
    if np.max(far) > limit:
        day = checked.dates[accepted + worst]
        return (f"on {day} a deviation was larger than chance makes any of this record", True)
    expected = number * sum(map(len, drawn)) / RUN_LENGTH
    times = int(np.count_nonzero(np.diff(outside.astype(int), prepend=0) == 1))
    words = f"charts were outside their limits {times} times before and came back; "
    return words + f"with this many charts and sessions chance gives up to {expected:.0f}", False


def findings(checked: Checked, *, accepted: int) -> list[str]:
    """Return what the record says, the gravest first; empty while all is well."""
    said = []
    at = alarm(checked, accepted=accepted)
    if at is not None:
        said.append(
            f"the rig has changed: a chart is outside its limits since {checked.dates[at]}; "
            "calibrate it again"
        )
        said += _causes(checked, accepted, at)
    words, is_alarm = earlier(checked, accepted=accepted)
    if is_alarm:
        said.append(words)
    outside = [
        name
        for name, ratio in zip(checked.names, checked.normalised[-1], strict=True)
        if abs(ratio) > 1
    ]
    if outside:
        said.append(
            f"{', '.join(outside)}: differs from the certificate by more than the 95 % "
            "uncertainties together" + _other_unit(checked)
        )
    return said


def _other_unit(checked: Checked) -> str:
    """Return that the certificate is in another unit, if all values say so; else nothing."""
    ratio = checked.values[-1] / checked.certified
    for unit, factor in UNITS_MM.items():
        if np.all(np.abs(ratio / factor - 1) < UNIT_SLACK):
            return f"; its values seem to be in {unit}: write them in mm"
    return ""


def notes(checked: Checked, *, accepted: int) -> list[str]:
    """Return what is to be known of the record beside its findings."""
    last, found = checked.dates[-1], []
    if date.fromisoformat(last[:10]) > date.today():
        found.append(f"the last session is dated in the future: {last}")
    if len(checked.dates) <= accepted:
        text = f"{len(checked.dates)} of {accepted} sessions at acceptance: no chart yet"
        return [*found, text]
    words, is_alarm = earlier(checked, accepted=accepted)
    return [*found, words] if words and not is_alarm else found


def _causes(checked: Checked, accepted: int, since: int) -> list[str]:
    freedom = degrees_of_freedom(checked) - 1
    if freedom < 1:
        return [
            "one quantity does not tell the cause: certify lengths and depths at several distances"
        ]
    found = likely_causes(checked, accepted=accepted, since=since)
    fit = [one for one in found if chdtrc(freedom, one.chi2) > FITS]
    if not fit:
        return ["no single cause explains it: more than one thing has changed, or a target moved"]
    words = [f"{one.name}, by {one.size:.3g} +- {one.std:.1g} {one.unit}" for one in fit]
    if len(fit) == 1:
        return [f"likely cause: {words[0]}"]
    return [
        f"likely causes, which these targets cannot distinguish: {'; or '.join(words)}; "
        "targets at more distances, left and right, would"
    ]


def page(title: str, checked: Checked, *, accepted: int) -> str:
    """Return the record as a page."""
    head, *rows = table(checked, accepted=accepted)
    said = findings(checked, accepted=accepted)
    blocks: list[Block] = [Text(f"{text[:1].upper()}{text[1:]}.") for text in said]
    if not said and len(checked.dates) > accepted:
        blocks.append(Text("All charts are in control, and the last session agrees."))
    blocks += [Text(f"{text[:1].upper()}{text[1:]}.") for text in notes(checked, accepted=accepted)]
    blocks.append(PlainTable("", head, [_states(row) for row in rows]))
    if len(checked.dates) > accepted:
        drawn = chart_rows(checked.series(), accepted=accepted)
        blocks.append(FigureRow("Charts", drawn, legend(accepted=accepted, of="sessions")))
    lines = [
        [day, *(f"{value:.6g}" for value in values)]
        for day, values in zip(checked.dates, checked.values, strict=True)
    ]
    blocks.append(PlainTable("Sessions", ["date", *checked.names], lines[::-1]))
    return plain_page(title, blocks, generator=GENERATOR)


def _states(row: Sequence[str]) -> list[Cell]:
    return [
        StateCell(cell, good=False)
        if cell.startswith("ALARM") or cell.endswith("OUTSIDE")
        else cell
        for cell in row
    ]
