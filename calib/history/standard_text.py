"""The record of a check standard, as text and as a page."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.special import chdtrc

from calib.history.causes import likely_causes
from calib.history.drawing import chart_rows
from calib.history.standard import Checked, degrees_of_freedom, first_alarm
from calib.report.plain_page import Block, Cell, Drawing, Paragraph, PlainTable, State, plain_page

GENERATOR = "calib history check"

FITS = 0.01
"""A cause is named while changes as large as what it leaves over are no rarer by chance."""

HEAD = ["quantity", "certified", "last", "u", "deviation / U", "Shewhart", "EWMA", "CUSUM"]


def table(checked: Checked, *, accepted: int) -> list[list[str]]:
    """Return a line a quantity, the head first."""
    rows = [HEAD]
    last = checked.normalised[-1]
    for k, one in enumerate(checked.series()):
        _, found = first_alarm(one, accepted) if len(one.values) > accepted else (None, ())
        states = [
            f"{chart.statistic[-1]:+.1f}"
            if chart.first_alarm is None
            else f"ALARM {one.dates[accepted + chart.first_alarm]}"
            for chart in found
        ] or ["-"] * 3
        agrees = f"{last[k]:+.2f}" + (" OUTSIDE" if abs(last[k]) > 1 else "")
        rows.append([
            f"{one.name}, mm", f"{checked.certified[k]:.6g}", f"{one.values[-1]:.6g}",
            f"{checked.std[-1, k]:.2g}", agrees, *states,
        ])  # fmt: skip
    return rows


def alarm(checked: Checked, *, accepted: int) -> int | None:
    """Return the first session at which any chart is outside its limits."""
    if len(checked.dates) <= accepted:
        return None
    found = [first_alarm(one, accepted)[0] for one in checked.series()]
    return min((at for at in found if at is not None), default=None)


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
    outside = [
        name
        for name, ratio in zip(checked.names, checked.normalised[-1], strict=True)
        if abs(ratio) > 1
    ]
    if outside:
        said.append(
            f"{', '.join(outside)}: differs from the certificate by more than the 95 % "
            "uncertainties together"
        )
    return said


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
    blocks: list[Block] = [Paragraph(f"{text[:1].upper()}{text[1:]}.") for text in said]
    if not said:
        blocks.append(Paragraph("All charts are in control, and the last session agrees."))
    blocks.append(PlainTable("", head, [_states(row) for row in rows]))
    if len(checked.dates) > accepted:
        blocks.append(Drawing("Charts", chart_rows(checked.series(), accepted=accepted)))
    lines = [
        [date, *(f"{value:.6g}" for value in values)]
        for date, values in zip(checked.dates, checked.values, strict=True)
    ]
    blocks.append(PlainTable("Sessions", ["date", *checked.names], lines[::-1]))
    return plain_page(title, blocks, generator=GENERATOR)


def _states(row: Sequence[str]) -> list[Cell]:
    return [
        State(cell, good=False) if cell.startswith("ALARM") or cell.endswith("OUTSIDE") else cell
        for cell in row
    ]
