"""`calib history`: the calibrations of many rigs over time."""

from __future__ import annotations

import argparse
import math
from datetime import date
from pathlib import Path

from calib.cli.acceptance import add_calibration
from calib.cli.arguments import add_input, add_output, positive
from calib.cli.history_runs import (
    MARK,
    PAGES,
    run_chart,
    run_check,
    run_due,
    run_index,
    run_page,
    run_show,
)
from calib.cli.rig_options import add_rig
from calib.cli.voice import add_voice
from calib.stages.output_guard import OutputKind

DEFAULT = Path("history.sqlite")
HELP = f"default: {DEFAULT}"

INDEX = OutputKind(is_folder=False, marks=(b"SQLite format 3\0",))
"""Whose database it is `calib.history.index` sees before it changes anything."""

CHART = OutputKind(is_folder=False, marks=(MARK,))
"""Known by its generator."""

RECORD = OutputKind(is_folder=False, marks=(b'content="calib history check"',))
"""Known by its generator."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's own commands."""
    commands = parser.add_subparsers(dest="history_command", required=True, metavar="COMMAND")

    add = commands.add_parser("index", help="index the calibrations in folders, by rig")
    add_input(
        add, "folders", nargs="+", metavar="DIR", is_calibration=True,
        help="folders with finished runs",
    )  # fmt: skip
    add_output(add, "--index", kind=INDEX, default=DEFAULT, metavar="FILE", help=HELP)
    add_voice(add, json_help="print what was added, changed, moved and skipped as JSON")
    add.set_defaults(run=run_index)

    add = commands.add_parser("show", help="all rigs, or one rig's control charts as text")
    add.add_argument("rig", nargs="?", metavar="RIG", help="serial number; default: list the rigs")
    _accepted(add)
    _repaired(add)
    _index(add)
    add_voice(add, json_help="print rigs, or calibrations and charts of one, as JSON")
    add.set_defaults(run=run_show)

    add = commands.add_parser("chart", help="one rig's control charts as SVG")
    add.add_argument("rig", metavar="RIG", help="serial number")
    add_output(add, "--out", kind=CHART, required=True, metavar="SVG", help="file to write")
    _accepted(add)
    _repaired(add)
    _index(add)
    add_voice(add)
    add.set_defaults(run=run_chart)

    add = commands.add_parser("page", help="pages of all rigs, and of each")
    add.add_argument("--rig", metavar="RIG", help="write this rig's page alone")
    add_output(
        add, "--out", kind=PAGES, default=Path("reports/history"), metavar="DIR",
        help="default: reports/history",
    )  # fmt: skip
    _tolerance(add, required=False)
    _accepted(add)
    _repaired(add)
    _index(add)
    add_voice(add)
    add.set_defaults(run=run_page)

    add = commands.add_parser("check", help="a check standard measured between calibrations")
    add_calibration(add)
    add_input(add, "standard", metavar="STANDARD.toml", help="certified lengths and depths")
    add_input(
        add, "readings", metavar="READINGS.csv",
        help="date, and the columns of measure; with --gaze it may be new",
    )  # fmt: skip
    add.add_argument(
        "--gaze", action="store_true",
        help="gaze at the standard now and add the session to READINGS.csv",
    )  # fmt: skip
    add_rig(add, help="of --gaze, and asks for it")
    add_output(add, "--out", kind=RECORD, metavar="HTML", help="page to write; default: none")
    add.add_argument(
        "--accepted",
        type=positive,
        metavar="N",
        help="sessions that make the reference; default: 5",
    )
    add_voice(add, json_help="print charts, notes and alarms as JSON")
    add.set_defaults(run=run_check)

    add = commands.add_parser("due", help="when a rig is due for its next calibration")
    add.add_argument("rig", metavar="RIG", help="serial number")
    _tolerance(add, required=True)
    _repaired(add)
    _index(add)
    add_voice(add, json_help="print date, method and notes as JSON")
    add.set_defaults(run=run_due)


def _tolerance(parser: argparse.ArgumentParser, *, required: bool) -> None:
    parser.add_argument(
        "--tolerance", type=_millimetres, required=required, metavar="MM",
        help="largest tolerated error of a depth by drift, over the calibrated range",
    )  # fmt: skip


def _repaired(parser: argparse.ArgumentParser) -> None:
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--repaired", type=_date, metavar="DATE",
        help="of the rig's last repair or adjustment; calibrations before it do not count",
    )  # fmt: skip
    add_input(
        parser, "--repairs", group=either, metavar="CSV",
        help="the same of many rigs: columns rig and date",
    )  # fmt: skip


def _accepted(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--accepted", type=positive, metavar="N",
        help="calibrations that make the reference; default: 3",
    )  # fmt: skip


def _index(parser: argparse.ArgumentParser) -> None:
    add_input(parser, "--index", default=DEFAULT, metavar="FILE", help=HELP)


def _millimetres(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: give a length in mm above 0")
    return value


def _date(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: write it as 2026-01-31") from None
