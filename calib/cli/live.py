"""`calib live`: the rig as a page in the browser."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path

from calib.cli.acceptance import add_calibration, warn_of_failed
from calib.cli.arguments import add_output, run_folder, whole
from calib.cli.guided_capture import DATASET
from calib.cli.rig_options import add_rig
from calib.core.errors import UsageError, harmless

DONE = 0

LOCAL = "127.0.0.1"
PORT = 8017
LAST_PORT = 65_535

NEEDED = ("starlette", "uvicorn", "websockets")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(parser, nargs="?", help="default: that of the dataset's last run")
    add_rig(parser)
    add_output(
        parser, "--dataset", kind=DATASET, default=Path("datasets/live"), metavar="DIR",
        help="folder to capture into; default: datasets/live. Its run goes to reports/NAME",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=_port, default=PORT, metavar="N",
        help=f"default: {PORT}; 0 takes any that is free",
    )  # fmt: skip
    parser.add_argument(
        "--host", default=LOCAL, metavar="ADDRESS",
        help=f"address to listen at; default: {LOCAL}, which other machines cannot reach",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C and return the exit status."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(
            f"live: {', '.join(missing)} cannot be imported; install the extra `web`: "
            "pip install 'active-gazing-calib[web]'"
        )
    from calib.instrument.calibration_file import read_calibration
    from calib.live.bench import Places
    from calib.live.serve import serve
    from calib.live.session import Given
    from calib.rig.settings import read_settings

    out = run_folder(None, arguments.dataset, force=arguments.force)
    given = Given(
        settings=read_settings(arguments.rig),
        places=Places(arguments.rig, arguments.dataset, out),
        calibration=arguments.calibration,
        allow_edited=arguments.allow_edited,
        accept_failed=arguments.accept_failed,
    )
    if given.calibration is not None:
        # Before the motor is asked for anything, and where the command was given.
        measuring = read_calibration(given.calibration, allow_edited=given.allow_edited)
        warn_of_failed(given.calibration, measuring.failed_gates, accepted=given.accept_failed)
    serve(given, host=arguments.host, port=arguments.port, announce=_announce)
    return DONE


def _port(text: str) -> int:
    return whole(text, least=0, most=LAST_PORT)


def _announce(address: str) -> None:
    print(f"open {harmless(address)}", flush=True)
    print("Ctrl-C ends it; the motor is stopped first", file=sys.stderr, flush=True)
