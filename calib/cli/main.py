"""The command line: parse, guard the outputs, call, say how it ended. Nothing is computed here.

Imports that take time are inside the functions that need them: ``calib --help`` answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import NoReturn, Protocol

from calib.cli import (
    batch,
    calibrate,
    capture,
    check,
    compare,
    completion,
    export,
    gaze,
    history,
    length,
    live,
    measure,
    plan,
    rig,
    schema,
    simulate,
    study,
    verify,
)
from calib.cli.arguments import guard_outputs
from calib.cli.examples import add_examples
from calib.cli.streams import discard, open_streams, refused_output, say, settled, tell
from calib.cli.voice import error_json, painted, print_json
from calib.core.errors import CalibError
from calib.core.parent import end_with_parent
from calib.core.version import __version__


class _Writable(Protocol):
    """What messages are written to."""

    def write(self, text: str, /) -> object: ...


DONE, DEFECT, REFUSED, GATE_FAILED = 0, 1, 2, 3
INTERRUPTED = 128 + signal.SIGINT

# One BLAS thread: the last bits of a sum must not hang on the number of cores.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

_YOUNG_OBJECTS = 50_000
"""New containers after which Python looks for garbage in cycles: its 700 cost a tenth of a run,
most of it while libraries are imported. Arrays are freed at once, whatever is set here."""


@dataclass(frozen=True)
class Command:
    """A command: its module has `add_arguments` and `run`."""

    name: str
    module: ModuleType
    purpose: str


GROUPS: tuple[tuple[str, tuple[Command, ...]], ...] = (
    (
        "calibrate",
        (
            Command("calibrate", calibrate, "run the whole chain on a dataset"),
            Command("batch", batch, "calibrate many datasets, with one summary"),
            Command("check", check, "list every problem of a dataset; writes nothing"),
            Command("verify", verify, "are the files of a run whole and untouched?"),
            Command("completion", completion, "completion of commands for bash or zsh"),
            Command("schema", schema, "JSON Schema of dataset.toml, calibration.json or rig.toml"),
        ),
    ),
    (
        "measure",
        (
            Command("measure", measure, "3-D positions from readings and a calibration"),
            Command("export", export, "cameras and their pose for OpenCV, mrcal, ROS or Kalibr"),
        ),
    ),
    (
        "plan, compare, watch",
        (
            Command("plan", plan, "where to put the next targets"),
            Command("compare", compare, "runs of one rig side by side: what has changed"),
            Command("history", history, "many rigs over years: charts and due dates"),
        ),
    ),
    (
        "the rig itself",
        (
            Command("capture", capture, "rows of the rig into a dataset"),
            Command("gaze", gaze, "turn C2 to targets and measure their positions"),
            Command("length", length, "the distance of two points, each gazed at: plates too"),
            Command("live", live, "the rig as a page in the browser: check to length"),
            Command("rig", rig, "is the rig fit to be calibrated and measured with?"),
        ),
    ),
    (
        "simulate",
        (
            Command("simulate", simulate, "a dataset with known truth"),
            Command("study", study, "many simulated rigs: coverage, bias, efficiency"),
        ),
    ),
)


def _overview() -> str:
    """Return the commands in their groups, as the help shows them."""
    lines = []
    for title, commands in GROUPS:
        lines += [f"{title}:", *(f"  {c.name:<11} {c.purpose}" for c in commands), ""]
    return "\n".join(lines)


class _Parser(argparse.ArgumentParser):
    """Refuses in one line, as all the rest of the program does."""

    def _print_message(self, message: str, file: _Writable | None = None) -> None:
        """Print help, which must not be lost unnoticed, or words about arguments, as given."""
        if file is not None and file is sys.stdout:
            file.write(message)
        elif message:
            say(message.rstrip("\n"))

    def error(self, message: str) -> NoReturn:
        self.exit(REFUSED, f"{self.prog}: {message}; {self.prog} --help says what there is\n")


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = _Parser(
        prog="calib",
        description="Calibrates active-gazing stereo: a fixed camera C1 and a yawing camera C2.\n\n"
        + _overview(),
        epilog="Exit status: 0 done, 2 bad input or usage, 3 a gate failed (outputs are written), "
        "1 a defect of the program.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"calib {__version__}")
    commands = top.add_subparsers(
        dest="command", required=True, metavar="COMMAND", help="one of the above; COMMAND --help"
    )
    for _, group in GROUPS:
        for command in group:
            add = commands.add_parser(command.name, description=command.purpose)
            command.module.add_arguments(add)
            if hasattr(command.module, "run"):
                add.set_defaults(run=command.module.run)
    top.set_defaults(whole_parser=parser)
    add_examples(top)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    end_with_parent()
    for name in _THREADS:
        os.environ[name] = "1"
    _collect_seldom()
    open_streams()
    try:
        status = _run(arguments)
    except SystemExit as ended:
        # Of argparse: help, version, usage.
        status = ended.code if isinstance(ended.code, int) else REFUSED
        if settled(status) == status:
            raise
        return REFUSED
    return settled(status)


def _collect_seldom() -> None:
    """Keep Python from looking for garbage often, and at the end, where all memory is given back.

    The last search would go through every object of every library: one second of a calibration.
    """
    gc.set_threshold(_YOUNG_OBJECTS, *gc.get_threshold()[1:])
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)


def _run(arguments: Sequence[str] | None) -> int:
    parsed: argparse.Namespace | None = None
    try:
        parsed = parser().parse_args(arguments)
        command: Callable[[argparse.Namespace], int] = parsed.run
        guard_outputs(parsed)
        status = command(parsed)
        sys.stdout.flush()
    except CalibError as error:
        if getattr(parsed, "json", False):
            print_json(error_json(error))
        tell(f"{painted('calib', 'red', sys.stderr)}: {error}")
        return error.exit_status
    except BrokenPipeError:
        # The reader of our output has gone; nothing is left to be said to it.
        discard(sys.stdout)
        return DONE
    except OSError as error:
        return refused_output(error)
    except KeyboardInterrupt:
        tell("calib: interrupted; what was finished is kept and will be reused")
        return INTERRUPTED
    return status


if __name__ == "__main__":
    sys.exit(main())
