"""`calib batch`: many datasets, one summary."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from calib.cli.arguments import add_input, add_output, jobs, natural
from calib.cli.voice import add_voice, print_json
from calib.core.errors import harmless
from calib.stages.interruption import interrupt_on
from calib.stages.output_guard import OutputKind, files_of

if TYPE_CHECKING:
    from calib.batch.task import Outcome

PAGE, TABLE = "batch.html", "batch.csv"
BATCH = OutputKind(
    is_folder=True,
    files=((PAGE, (b'content="calib batch"',)), (TABLE, (b"dataset,result,model,",))),
)

STATUS = {"crashed": 1, "refused": 2, "gates failed": 3, "passed": 0}
"""Exit status by ending, the worst first."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_input(
        parser, "datasets", nargs="+", metavar="DATASET", help="folders with dataset.toml"
    )  # fmt: skip
    add_output(
        parser, "--out", kind=BATCH, default=Path("reports/batch"), metavar="DIR",
        help="default: reports/batch; finished runs there are reused",
    )  # fmt: skip
    parser.add_argument("--seed", type=natural, default=0, metavar="N", help="default: 0")
    add_voice(parser, json_help="print the result of each dataset as JSON")
    parser.add_argument(
        "--jobs", type=jobs, metavar="N",
        help="datasets at a time here; default: as many as processors",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="work on this Dask cluster instead; its workers must see the same folders",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Calibrate all, write the summary, return the status of the worst."""
    from calib.batch.run import refuse_absent, run_batch, tasks_of
    from calib.batch.summary import counts, csv_text, document, line_of, page
    from calib.cli.console import Console
    from calib.stages.files import make_folder, write_bytes
    from calib.stages.parallel import processors

    interrupt_on(signal.SIGINT, signal.SIGTERM)
    refuse_absent(arguments.datasets)
    tasks = tasks_of(arguments.datasets, arguments.out, seed=arguments.seed, force=arguments.force)
    # Begun at once: the folder of an unfinished batch is known as one.
    make_folder(arguments.out)
    places = files_of(
        arguments.out, (TABLE, PAGE), BATCH, option="--out", force=arguments.force
    )  # fmt: skip
    if not places[PAGE].exists():
        write_bytes(places[PAGE], page([]).encode())
    console, done = Console(quiet=arguments.quiet), 0

    def finished(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        console.close()
        name = harmless(outcome.task.dataset)
        result = line_of(outcome, arguments.out).result
        if not (arguments.quiet and result == "passed"):
            print(f"  {done} of {len(tasks)}  {result}: {name}", file=sys.stderr)
            for line in outcome.said:
                print(f"      {harmless(line)}", file=sys.stderr)
        console.progress("datasets", done, len(tasks))

    try:
        outcomes = run_batch(
            tasks,
            jobs=arguments.jobs or processors(),
            scheduler=arguments.scheduler,
            finished=finished,
        )
    finally:
        console.close()
    lines = [line_of(outcome, arguments.out) for outcome in outcomes]
    write_bytes(places[TABLE], csv_text(lines).encode())
    write_bytes(places[PAGE], page(lines).encode())
    if arguments.json:
        print_json(document(lines))
    elif not arguments.quiet:
        print(counts(lines))
        print(f"summary: {harmless(str(arguments.out / PAGE))}")
    return next(
        (status for ending, status in STATUS.items() if any(o.ending == ending for o in outcomes)),
        0,
    )
