"""The command line: parse, call, say how it ended. Nothing is computed here.

Imports that take time stand inside the functions that need them: ``calib --help`` answers at once.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib import __version__
from calib.cli import compare as compare_command
from calib.cli import history as history_command
from calib.cli import plan as plan_command
from calib.cli import study as study_command
from calib.cli.arguments import (
    STREAM,
    add_input,
    add_output,
    guard_outputs,
    natural,
    run_folder,
)
from calib.core.errors import CalibError, UsageError
from calib.stages.interruption import interrupt_on
from calib.stages.output_guard import NEW_FOLDER, RUN_FOLDER, OutputKind

if TYPE_CHECKING:
    from calib.dataset.contents import Dataset

DONE, DEFECT, REFUSED, GATE_FAILED = 0, 1, 2, 3
INTERRUPTED = 128 + signal.SIGINT

# One BLAS thread: the last bits of a sum must not hang on the number of cores.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


POSITIONS = OutputKind(
    is_folder=False,
    marks=(b"id,x_mm,y_mm,z_mm,", b"id,source,u_z_mm,", b"length_mm,u_length_mm,reference_mm"),
)
"""Known by the header of their table."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calib",
        description="Calibrates active-gazing stereo: a fixed camera C1 and a yawing camera C2.",
        epilog="Exit status: 0 done, 2 bad input or usage, 3 a gate failed (outputs are written), "
        "1 a defect of the program.",
    )
    parser.add_argument("--version", action="version", version=f"calib {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add = commands.add_parser("calibrate", help="run the whole chain on a dataset")
    add_input(add, "dataset", metavar="DATASET", help="folder with dataset.toml")
    add_output(add, "--out", kind=RUN_FOLDER, metavar="DIR", help="default: reports/NAME")
    add.add_argument("--seed", type=natural, default=0, metavar="N", help="default: 0")
    add.add_argument(
        "--depths", type=float, nargs=2, metavar=("LOW", "HIGH"),
        help="range of the depth uncertainty table, mm; default: that of the rows",
    )  # fmt: skip
    add.set_defaults(run=_calibrate)

    add = commands.add_parser("check", help="list every problem of a dataset; writes nothing")
    add_input(add, "dataset", metavar="DATASET")
    add.set_defaults(run=_check)

    add = commands.add_parser("measure", help="3-D positions from readings and a calibration")
    add_input(add, "calibration", metavar="CALIBRATION.json")
    add_input(add, "table", metavar="TABLE.csv", help="- reads standard input")
    add_output(add, "--out", kind=POSITIONS, metavar="CSV", help="default: standard output")
    instead = add.add_mutually_exclusive_group()
    add_input(add, "--lengths", group=instead, metavar="CSV", help="id, from, to: their distances")
    instead.add_argument("--sources", action="store_true", help="what u(z) of each is made of")
    add.add_argument(
        "--model", default="selected", metavar="NAME",
        help="selected (default), a fitted model, or average over all of them",
    )  # fmt: skip
    add.set_defaults(run=_measure)

    add = commands.add_parser("simulate", help="a dataset with known truth")
    add_output(add, "out", kind=NEW_FOLDER, metavar="OUT", help="folder to make")
    add.add_argument("--seed", type=natural, required=True, metavar="N")
    add.add_argument("--images", action="store_true", help="render the whole rig's pictures")
    add.add_argument("--model", default="axis-offset", help="default: axis-offset")
    add.add_argument("--rows", type=int, default=14, metavar="N", help="gaze rows; default: 14")
    add.add_argument("--validation-rows", type=int, default=10, metavar="N", help="default: 10")
    add.add_argument("--outliers", type=float, default=0.0, metavar="SHARE", help="gross errors")
    add.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="fix a parameter"
    )
    add.set_defaults(run=_simulate)

    add = commands.add_parser("compare", help="runs of one rig side by side: what has changed")
    compare_command.add_arguments(add)
    add.set_defaults(run=compare_command.run)

    add = commands.add_parser("history", help="many rigs over years: charts and due dates")
    history_command.add_arguments(add)

    add = commands.add_parser("plan", help="where to put the next targets")
    plan_command.add_arguments(add)
    add.set_defaults(run=plan_command.run)

    add = commands.add_parser("study", help="many simulated rigs: coverage, bias, efficiency")
    study_command.add_arguments(add)
    add.set_defaults(run=study_command.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    for name in _THREADS:
        os.environ[name] = "1"
    parsed = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = parsed.run
    try:
        guard_outputs(parsed)
        return command(parsed)
    except CalibError as error:
        print(f"calib: {error}", file=sys.stderr)
        return error.exit_status
    except BrokenPipeError:
        # The reader of our output has gone; nothing is left to be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except KeyboardInterrupt:
        print("calib: interrupted; what was finished is kept and will be reused", file=sys.stderr)
        return INTERRUPTED


def _calibrate(arguments: argparse.Namespace) -> int:
    from calib.cli.console import summary
    from calib.dataset.load import load_dataset
    from calib.results.manifest import finished_before, run_fingerprint

    interrupt_on(signal.SIGINT, signal.SIGTERM)
    dataset = load_dataset(arguments.dataset)
    out = run_folder(arguments.out, dataset.root, force=arguments.force)
    depths = tuple(arguments.depths) if arguments.depths else None
    if depths is not None and not 0 < depths[0] < depths[1] < float("inf"):
        raise UsageError("--depths: give two depths in mm, 0 < LOW < HIGH")
    settings = {"seed": arguments.seed, "depths_mm": depths}
    if finished_before(out, run_fingerprint(dataset.sha256, settings)):
        print(f"{out}: up to date, nothing has changed")
    else:
        _run_chain(dataset, out, settings)
    text, passed = summary(out)
    print(text)
    return DONE if passed else GATE_FAILED


def _run_chain(dataset: Dataset, out: Path, settings: dict[str, Any]) -> None:
    from calib.chain.calibrate import Options, calibrate
    from calib.cli.console import Console

    console = Console()
    try:
        calibrate(
            dataset,
            out,
            Options(**settings),
            announce=console.announce,
            progress=console.progress,
            command=shlex.join(["calib", *sys.argv[1:]]),
        )
    finally:
        console.close()


def _check(arguments: argparse.Namespace) -> int:
    from calib.dataset.load import load_dataset

    dataset = load_dataset(arguments.dataset)
    for warning in dataset.warnings:
        print(f"warning: {warning}")
    parts = {
        "gaze rows": dataset.gaze,
        "validation rows": dataset.validation,
        "sweep images": dataset.sweep,
        "lengths": dataset.lengths,
        "stereo pairs": dataset.stereo_pairs,
        "images of C1": dataset.images.get("c1"),
        "images of C2": dataset.images.get("c2"),
    }
    found = ", ".join(f"{len(part)} {name}" for name, part in parts.items() if part)
    print(f"{dataset.manifest.name}: no problems; {found or 'no rows and no images'}")
    return DONE


def _measure(arguments: argparse.Namespace) -> int:
    from calib.dataset.readers import read_measurements
    from calib.instrument.by_model import SELECTED, doubt, instrument_of, measure_by
    from calib.instrument.calibration_file import read_calibration
    from calib.instrument.measuring import (
        TABLE_LIMIT_BYTES,
        lengths_csv,
        measure,
        positions_csv,
        read_pairs,
        sources_csv,
        table_text,
    )
    from calib.stages.store import write_bytes

    measuring = read_calibration(arguments.calibration)
    piped = str(arguments.table) == STREAM
    name = "standard input" if piped else str(arguments.table)
    text = sys.stdin.buffer.read(TABLE_LIMIT_BYTES + 1) if piped else arguments.table
    table, model = read_measurements(table_text(text, name=name), name=name), arguments.model
    if arguments.sources:
        result = sources_csv(measure(instrument_of(measuring, model), table))
    else:
        measured = measure_by(measuring, table, model=model)
        told = doubt(measuring, measured, table) if model == SELECTED else None
        if told is not None:
            print(f"calib: note: {told}", file=sys.stderr)
        if arguments.lengths is not None:
            result = lengths_csv(measured, read_pairs(arguments.lengths, measured))
        else:
            result = positions_csv(measuring, measured)
    if arguments.out is None:
        sys.stdout.write(result)
    else:
        write_bytes(arguments.out, result.encode())
    return DONE


def _simulate(arguments: argparse.Namespace) -> int:
    from calib.cli.console import Console
    from calib.simulate.contents import SimulationOptions
    from calib.simulate.dataset import simulate_dataset

    options = SimulationOptions(
        seed=arguments.seed,
        model=arguments.model,
        rows=arguments.rows,
        validation_rows=arguments.validation_rows,
        images=arguments.images,
        outlier_share=arguments.outliers,
        fixed=dict(_assignment(text) for text in arguments.set),
    )
    console = Console()
    try:
        simulate_dataset(arguments.out, options, progress=partial(console.progress, "images"))
    finally:
        console.close()
    print(f"{arguments.out}: written, with its truth in truth.json")
    return DONE


def _assignment(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(f"--set {text}: give NAME=VALUE, for example axis_z_mm=-20") from None


if __name__ == "__main__":
    sys.exit(main())
