"""`calib study`: many simulated rigs, calibrated and scored."""

from __future__ import annotations

import argparse
import shlex
import sys
from functools import partial
from pathlib import Path

from calib.cli.arguments import add_output, jobs, natural, whole
from calib.cli.voice import add_voice
from calib.stages.output_guard import OutputKind, files_of

DONE, CLAIM_BROKEN = 0, 3

MOST_RIGS = 1_000_000
"""A month on a hundred processors."""

JOURNAL = "rigs.jsonl"
MARK = b'data-generator="calib study" '
STUDY = OutputKind(
    is_folder=True,
    files=(
        (JOURNAL, (b'{"condition":"',)),
        ("scores.csv", (b"condition,subject,",)),
        ("scores.json", (b'"generator": "calib ',)),
        ("*.svg", (MARK,)),
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_output(
        parser, "--out", kind=STUDY, default=Path("reports/study"), metavar="DIR",
        help="default: reports/study; finished rigs there are reused",
    )  # fmt: skip
    parser.add_argument(
        "--rigs",
        type=partial(whole, least=1, most=MOST_RIGS),
        default=100,
        metavar="N",
        help="a condition; default: 100",
    )
    parser.add_argument("--seed", type=natural, default=0, metavar="N", help="default: 0")
    parser.add_argument(
        "--condition", action="append", metavar="NAME",
        help="a condition, or the group default, ranks, broken or all; may be repeated; "
        "default: default",
    )  # fmt: skip
    parser.add_argument(
        "--jobs", type=jobs, default=1, metavar="N", help="processes here; default: 1"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="work on this Dask cluster instead")
    add_voice(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the study and return the exit status: 3 if a claim is clearly broken."""
    from calib.cli.console import Console
    from calib.stages.files import write_bytes
    from calib.study.claims import judge, verdict_text
    from calib.study.conditions import chosen
    from calib.study.output import study_files, study_names
    from calib.study.run import run_study
    from calib.study.scores import score_all

    conditions = chosen(tuple(arguments.condition or ("default",)))
    # Before the work of hours, of which nothing could be written afterwards.
    places = files_of(
        arguments.out, (JOURNAL, *study_names()), STUDY, option="--out", force=arguments.force
    )
    console = Console(quiet=arguments.quiet)
    try:
        records = run_study(
            places[JOURNAL],
            conditions,
            rigs=arguments.rigs,
            seed=arguments.seed,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            progress=lambda done, of: console.progress("rigs", done, of),
        )
    finally:
        console.close()
    scores = score_all(records)
    verdicts = judge(scores)
    settings = {
        "command": shlex.join(["calib", *sys.argv[1:]]),
        "seed": arguments.seed,
        "rigs": arguments.rigs,
        "conditions": list(conditions),
    }
    files = study_files(records, scores, verdicts, settings=settings, mark=MARK)
    for name, content in files.items():
        write_bytes(places[name], content)
    told = [v for v in verdicts if v.broken] if arguments.quiet else verdicts
    lines = [verdict_text(verdict) for verdict in told]
    if not arguments.quiet:
        lines.append("written: " + ", ".join(str(places[name]) for name in files))
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    return CLAIM_BROKEN if any(verdict.broken for verdict in verdicts) else DONE
