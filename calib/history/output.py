"""Runs side by side as text and as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from calib.history.drift import FAMILY_RISK, ComparedRun, Drift
from calib.report.plain_page import Block, PlainTable, Text, plain_page

Table = tuple[str, list[list[str]]]
"""Title and rows of cells, the first its head; a row of one cell is a note on the table."""


def tables(runs: Sequence[ComparedRun], drifts: Sequence[Drift]) -> list[Table]:
    """Return titles with tables, the first row of each its head."""
    return [
        ("Runs", _runs(runs)),
        ("Parameters", _parameters(runs)),
        ("Predictive scores", _scores(runs)),
        ("u(z), mm", _depth_u(runs)),
        *changes_tables(drifts),
    ]


def changes_tables(drifts: Sequence[Drift]) -> list[Table]:
    """Return what changed from one run to another, a table a pair."""
    return [(_title(d), _changes(d)) for d in drifts]


def _runs(runs: Sequence[ComparedRun]) -> list[list[str]]:
    rows = [["", "run", "dataset", "model", "calibrated depths, mm", "gates"]]
    for i, run in enumerate(runs, 1):
        low, high = run.measuring.calibrated_mm
        gates = f"FAILED: {', '.join(run.failed)}" if run.failed else "passed"
        depths = f"{low:.0f} to {high:.0f}"
        rows.append([str(i), run.name, run.dataset, run.model, depths, gates])
    return rows


def _depth_u(runs: Sequence[ComparedRun]) -> list[list[str]]:
    """Return u(z) of each run at the same depths: the ends and the middle of all their ranges."""
    rows = [["at depth", *(f"run {i}" for i in range(1, len(runs) + 1))]]
    ends = [end for run in runs for end in run.measuring.calibrated_mm]
    low, high = min(ends), max(ends)
    for z in (low, (low + high) / 2, high):
        found = [run.u_at(z) for run in runs]
        rows.append([f"{z:.0f} mm", *("not covered" if u is None else f"{u:.3g}" for u in found)])
    return rows


def _parameters(runs: Sequence[ComparedRun]) -> list[list[str]]:
    """Return values with 95 % intervals, one column a run."""
    estimates = [run.estimates() for run in runs]
    names = list(dict.fromkeys(name for one in estimates for name in one))
    rows = [["", *(f"run {i}" for i in range(1, len(runs) + 1))]]
    for name in names:
        cells = []
        for one in estimates:
            value, std = one.get(name, (None, None))
            if value is None or std is None:
                cells.append("-")
            else:
                cells.append(f"{value:.5g} [{value - 1.96 * std:.5g}, {value + 1.96 * std:.5g}]")
        rows.append([name, *cells])
    return rows


def _scores(runs: Sequence[ComparedRun]) -> list[list[str]]:
    names = list(dict.fromkeys(name for run in runs for name in run.scores))
    rows = [["", *(f"run {i}" for i in range(1, len(runs) + 1))]]
    for name in names:
        values = [run.scores.get(name) for run in runs]
        rows.append([name, *("-" if v is None else f"{v:.4g}" for v in values)])
    return rows


def _title(drift: Drift) -> str:
    together = "" if drift.p_value is None else f", all parameters together p = {drift.p_value:.2g}"
    return f"{drift.first} to {drift.other}: {drift.verdict}{together}"


def _changes(drift: Drift) -> list[list[str]]:
    rows = [["", "change", "u", "in units of u", ""]]
    for c in drift.changes:
        remark = "significant" if c.significant else ""
        note = "; ".join(part for part in (remark, c.note) if part)
        change = _signed(c.difference, ".3g") + (f" {c.unit}" if c.unit != "1" else "")
        rows.append([c.what, change, f"{c.std:.2g}", _signed(c.sigmas, ".1f"), note])
    return rows + [[f"Note: {note}."] for note in drift.notes]


def _signed(value: float, form: str) -> str:
    """Return a difference with its sign; none is a plain 0."""
    return format(value, f"+z{form}") if value else "0"


def text(found: Sequence[Table]) -> str:
    """Return the tables for the terminal."""
    blocks = []
    for title, rows in found:
        full = [row for row in rows if len(row) == len(rows[0])]
        widths = [max(len(row[k]) for row in full) for k in range(len(rows[0]))]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)).rstrip()
            for row in rows
        ]
        blocks.append("\n".join([title, *(f"  {line}" for line in lines)]))
    return "\n\n".join(blocks) + "\n"


def verdicts(changes: Sequence[Drift]) -> str:
    """Return what the comparison comes to, a line a pair."""
    return "".join(f"{_title(drift)}\n" for drift in changes)


def document(runs: Sequence[ComparedRun], changes: Sequence[Drift]) -> dict[str, Any]:
    """Return runs and what has changed for programs."""
    return {
        "runs": [
            {
                "name": run.name,
                "dataset": run.dataset,
                "model": run.model,
                "calibrated_mm": run.measuring.calibrated_mm,
                "failed_gates": run.failed,
                "parameters": {
                    name: {"value": value, "std": std}
                    for name, (value, std) in run.estimates().items()
                },
                "scores": run.scores,
            }
            for run in runs
        ],
        "changes": [
            asdict(drift) | {"verdict": drift.verdict, "significant": drift.significant}
            for drift in changes
        ],
    }


def html(found: Sequence[Table]) -> str:
    """Return the tables as one self-contained page."""
    blocks: list[Block] = [PlainTable(title, head, rows) for title, (head, *rows) in found]
    note = (
        "A change is called significant if chance alone would make one as large, among those of "
        f"its table, with less than {100 * FAMILY_RISK:.0f} % probability. Runs are taken as "
        "independent, unless a note says otherwise."
    )
    return plain_page("Runs side by side", [*blocks, Text(note)], generator="calib compare")
