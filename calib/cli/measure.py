"""`calib measure`: 3-D positions from readings and a calibration."""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

from calib.cli.acceptance import NAMED_FAULTS, add_calibration, warn_of_failed
from calib.cli.arguments import STREAM, add_input, add_output
from calib.cli.streams import say, standard_input
from calib.cli.voice import add_voice, as_json_lines
from calib.core.errors import InputError
from calib.core.text_stream import read_texts
from calib.stages.output_guard import OutputKind

if TYPE_CHECKING:
    from calib.dataset.readings import ReadingBlock
    from calib.instrument.calibration_file import Measuring

DONE, NOT_ALL = 0, 3

SHOWN_ID = 60
"""Characters of an id in a message."""

POSITIONS = OutputKind(
    is_folder=False,
    marks=(
        b"id,x_mm,y_mm,z_mm,",
        b"id,source,u_z_mm,",
        b"length_mm,u_length_mm,reference_mm",
        b'{"id": ',
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(parser)
    add_input(parser, "table", metavar="TABLE.csv", help="- reads standard input, line for line")
    add_output(parser, "--out", kind=POSITIONS, metavar="CSV", help="default: standard output")
    instead = parser.add_mutually_exclusive_group()
    add_input(parser, "--lengths", group=instead, metavar="CSV", help="id, from, to: distances")
    instead.add_argument("--sources", action="store_true", help="what u(z) of each is made of")
    parser.add_argument(
        "--model", default="selected", metavar="NAME",
        help="selected (default), rows, adjustment, a fitted model, or average over all of them",
    )  # fmt: skip
    parser.add_argument(
        "--strict", action="store_true", help="stop at the first row that cannot be measured"
    )
    add_voice(
        parser,
        json_help="write an object a row, JSON Lines; null is no figure, or no limit",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure and return the exit status: 3 if a row could not be, or a gate had failed."""
    from calib.instrument.by_model import AVERAGE, instrument_of
    from calib.instrument.calibration_file import read_calibration

    measuring = read_calibration(arguments.calibration, allow_edited=arguments.allow_edited)
    if arguments.model != AVERAGE or arguments.sources:
        instrument_of(measuring, arguments.model)
    refused = warn_of_failed(
        arguments.calibration, measuring.failed_gates, accepted=arguments.accept_failed
    )
    name = "standard input" if str(arguments.table) == STREAM else str(arguments.table)
    tally = _Tally(name, strict=arguments.strict, quiet=arguments.quiet)
    work = _lengths if arguments.lengths is not None else _positions
    with _opened(arguments.table, name) as file, writer(arguments.out) as write:
        put = as_json_lines(write) if arguments.json else write
        work(arguments, measuring, read_texts(file, name=name), tally, put)
    return NOT_ALL if tally.report() or refused else DONE


def _positions(
    arguments: argparse.Namespace,
    measuring: Measuring,
    texts: Iterator[str],
    tally: _Tally,
    write: Callable[[str], None],
) -> None:
    """Write positions, or what their uncertainty is made of, block by block."""
    from calib.dataset.readings import read_blocks
    from calib.instrument import measured_text as out
    from calib.instrument.by_model import SELECTED, doubt, instrument_of, measure_by
    from calib.instrument.measuring import measure

    write(out.csv_text([out.SOURCE_COLUMNS if arguments.sources else out.POSITION_COLUMNS]))
    failed = bool(measuring.failed_gates) and not arguments.accept_failed
    note: str | None = None
    for block in read_blocks(texts, name=tally.name):
        if arguments.sources:
            found = measure(instrument_of(measuring, arguments.model), block.table)
            write(out.source_rows(found))
            tally.add(block, found.faults)
            continue
        measured = measure_by(measuring, block.table, model=arguments.model)
        if note is None and arguments.model == SELECTED:
            note = doubt(measuring, measured, block.table)
        tally.add(block, measured.faults)
        write(
            out.position_rows(
                block, measured, calibrated_mm=measuring.calibrated_mm, gate_failed=failed
            )
        )
    if note is not None and not arguments.quiet:
        say(f"calib: note: {note}")


def _lengths(
    arguments: argparse.Namespace,
    measuring: Measuring,
    texts: Iterator[str],
    tally: _Tally,
    write: Callable[[str], None],
) -> None:
    """Write distances between measured points."""
    from calib.dataset.readings import read_blocks
    from calib.instrument import measured_text as out
    from calib.instrument.by_model import SELECTED, doubt, measure_by
    from calib.instrument.measuring import read_pairs

    (block,) = read_blocks(texts, name=tally.name, whole=True)
    measured = measure_by(measuring, block.table, model=arguments.model)
    tally.add(block, measured.faults)
    failed = bool(measuring.failed_gates) and not arguments.accept_failed
    repeated = {name for name, count in Counter(block.ids).items() if count > 1}
    pairs = read_pairs(arguments.lengths)
    rows, none = out.length_rows(
        measured,
        pairs,
        calibrated_mm=measuring.calibrated_mm,
        gate_failed=failed,
        repeated=repeated,
    )
    write(out.csv_text([out.LENGTH_COLUMNS]) + rows)
    tally.failed = max(tally.failed, none)
    if arguments.model == SELECTED and (note := doubt(measuring, measured, block.table)):
        say(f"calib: note: {note}")


class _Tally:
    """Rows that could not be measured."""

    def __init__(self, name: str, *, strict: bool, quiet: bool) -> None:
        self.name = name
        self._quiet = quiet
        self._strict = strict
        self._named: list[str] = []
        self.rows = self.failed = 0

    def add(self, block: ReadingBlock, measured: Mapping[int, str]) -> None:
        """Count a block's rows; `measured` are the faults of those that had none in the table.

        Raises
        ------
        InputError
            At the first row that could not be measured, if asked to be strict.
        """
        faults = block.faults | {int(block.place[i]): fault for i, fault in measured.items()}
        self.rows += len(block)
        self.failed += len(faults)
        for i in sorted(faults)[: NAMED_FAULTS - len(self._named)]:
            name = block.ids[i]
            cut = name if len(name) <= SHOWN_ID else f"{name[: SHOWN_ID - 1]}…"
            where = f"{self.name}, line {block.lines[i]} (id {cut})"
            if self._strict:
                remedy = "mend the row, or leave --strict out"
                raise InputError.single(where=where, what=faults[i], remedy=remedy)
            self._named.append(f"calib: {where}: {faults[i]}")

    def report(self) -> bool:
        """Say on stderr what could not be measured; return whether there was anything.

        Raises
        ------
        InputError
            If the table had no rows.
        """
        if self.rows == 0:
            remedy = "add a row for each reading"
            raise InputError.single(where=self.name, what="has no rows", remedy=remedy)
        for line in self._named if not self._quiet else ():
            say(line)
        if self.failed:
            more = f", the first {NAMED_FAULTS} named above" * (self.failed > NAMED_FAULTS)
            say(f"calib: {self.failed} of {self.rows} rows could not be measured{more}")
        return self.failed > 0


def _opened(table: Path, name: str) -> IO[bytes]:
    if str(table) == STREAM:
        return os.fdopen(standard_input().fileno(), "rb", closefd=False)
    try:
        return table.open("rb")
    except OSError as error:
        raise InputError.single(
            where=name,
            what=f"cannot be read ({error.strerror})",
            remedy="give a CSV table with a row for each reading, see datasets/README.md",
        ) from None


@contextmanager
def writer(path: Path | None) -> Iterator[Callable[[str], None]]:
    """Give a function that writes text: to standard output at once, or to a file, whole."""
    from calib.stages.files import atomic_write

    if path is None:

        def printed(text: str) -> None:
            sys.stdout.buffer.write(text.encode())
            sys.stdout.buffer.flush()

        yield printed
        return
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:

        def written(text: str) -> None:
            file.write(text)

        yield written
