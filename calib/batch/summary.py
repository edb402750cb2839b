"""What a batch gave: one line a dataset, as CSV and as a page that leads to the reports."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias
from urllib.parse import quote

from calib.batch.task import Ending, Outcome
from calib.core.errors import CalibError, harmless
from calib.core.words import counted
from calib.history.drift import EFFECTIVE
from calib.history.read import RESULT, read_run
from calib.instrument.calibration_file import read_whole
from calib.report.plain_page import Block, Cell, Link, PlainTable, StateCell, Text, plain_page
from calib.stages.manifest import faults

GENERATOR = "calib batch"

DOCUMENTS = ("report.html", "certificate.html")

Result: TypeAlias = Ending | Literal["contradicted"]
"""A run is contradicted if its gates passed and its validation reference disagrees all the same."""


@dataclass(frozen=True)
class SummaryLine:
    """A dataset's line.

    Parameters
    ----------
    folder
        Of its run, relative to that of the batch.
    figures
        As printed, by column; none where the run has no gaze calibration.
    remarks
        Gates that failed, references that contradict the depths, or what the run said.
    documents
        That are there to be read.
    """

    dataset: str
    folder: str
    result: Result
    figures: dict[str, str]
    remarks: tuple[str, ...]
    documents: tuple[str, ...]


COLUMNS = ("model", "L_b + e, mm", "u, mm", "depths, mm", "u(z) at the middle, mm")


def line_of(outcome: Outcome, out: Path) -> SummaryLine:
    """Return the line of one dataset, from the files of its run."""
    folder = Path(outcome.task.out)
    relative = folder.relative_to(out.resolve()).as_posix()
    if outcome.ending in ("refused", "crashed"):
        # What lies there may be of an earlier run.
        return SummaryLine(outcome.task.dataset, relative, outcome.ending, {}, outcome.said, ())
    documents = tuple(name for name in DOCUMENTS if (folder / name).exists())
    if found := faults(folder):
        # The run was whole when it ended: something else has written there.
        return SummaryLine(outcome.task.dataset, relative, "refused", {}, (str(found[0]),), ())
    try:
        run = read_run(folder)
    except CalibError as error:
        # A calibration of cameras alone, as a rule.
        said = str(error).splitlines()[:1]
        return SummaryLine(
            outcome.task.dataset, relative, outcome.ending, {}, tuple(said), documents
        )
    value, std = run.estimates()[EFFECTIVE]
    near, far = run.measuring.calibrated_mm
    u = run.u_at((near + far) / 2)
    cells = (
        run.model, f"{value:.5g}", f"{std:.2g}", f"{near:.0f} to {far:.0f}",
        "" if u is None else f"{u:.2g}",
    )  # fmt: skip
    figures = dict(zip(COLUMNS, cells, strict=True))
    against = tuple(map(str, read_whole(folder / RESULT)[1].get("contradictions", ())))
    remarks = (*(f"gate {name}" for name in run.failed), *against)
    result: Result = outcome.ending
    if against and result == "passed":
        result = "contradicted"
    return SummaryLine(outcome.task.dataset, relative, result, figures, remarks, documents)


def counts(lines: Sequence[SummaryLine]) -> str:
    """Return how many ended how, in words."""
    kinds: tuple[Result, ...] = ("passed", "contradicted", "gates failed", "refused", "crashed")
    numbers = {kind: sum(line.result == kind for line in lines) for kind in kinds}
    said = ", ".join(f"{number} {kind}" for kind, number in numbers.items() if number)
    return f"{counted(len(lines), 'dataset')}: {said}"


def document(lines: Sequence[SummaryLine]) -> dict[str, Any]:
    """Return the summary as a JSON object."""
    return {
        "datasets": [
            {
                "dataset": line.dataset,
                "folder": line.folder,
                "result": line.result,
                "figures": line.figures,
                "remarks": list(line.remarks),
            }
            for line in lines
        ]
    }


def csv_text(lines: Sequence[SummaryLine]) -> str:
    """Return the table as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["dataset", "result", *COLUMNS, "run", "remarks"])
    for line in lines:
        figures = [line.figures.get(name, "") for name in COLUMNS]
        row = [line.dataset, line.result, *figures, line.folder, "; ".join(line.remarks)]
        # A name that a spreadsheet would compute is kept as text.
        cells = map(harmless, row)
        writer.writerow([f"'{cell}" if cell[:1] in tuple("=+-@") else cell for cell in cells])
    return text.getvalue()


def page(lines: Sequence[SummaryLine]) -> str:
    """Return the table as a page, what went wrong first."""
    order = ("crashed", "refused", "gates failed", "contradicted", "passed")
    rows: list[list[Cell]] = [
        [
            line.folder,
            StateCell(line.result, line.result == "passed"),
            *(line.figures.get(name, "") for name in COLUMNS),
            tuple(Link(_title(name), quote(f"{line.folder}/{name}")) for name in line.documents),
            "; ".join(line.remarks),
        ]
        for line in sorted(lines, key=lambda line: order.index(line.result))
    ]
    head = ["dataset", "result", *COLUMNS, "documents", "remarks"]
    blocks: list[Block] = [Text(f"{counts(lines)}."), PlainTable("", head, rows)]
    return plain_page("Batch of calibrations", blocks, generator=GENERATOR)


def _title(name: str) -> str:
    return name.partition(".")[0]
