"""`calib gaze`: C2 turned to targets, and their positions measured as they are gazed at."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from calib.cli.acceptance import add_calibration, warn_of_failed
from calib.cli.arguments import add_output, positive
from calib.cli.measure import POSITIONS, writer
from calib.cli.rig_options import add_rig, last_check, opened
from calib.cli.streams import say
from calib.cli.voice import add_voice, as_json_lines

if TYPE_CHECKING:
    from calib.gaze.aim import EpipolarAiming
    from calib.gaze.gazing import Gazer
    from calib.gaze.row import GazeRow
    from calib.gaze.target import Target
    from calib.geometry.camera import Camera
    from calib.instrument.calibration_file import Measuring
    from calib.rig.devices import RigDevices

DONE, NOT_ALL = 0, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_calibration(parser)
    add_rig(parser)
    parser.add_argument(
        "--count", type=positive, default=1, metavar="N", help="targets, or rows with --follow"
    )
    add_target(parser)
    parser.add_argument(
        "--follow", action="store_true", help="the target moves: C2 goes where it will be"
    )
    add_output(parser, "--out", kind=POSITIONS, metavar="CSV", help="default: standard output")
    add_voice(parser, json_help="write an object a row, JSON Lines")
    parser.add_argument(
        "--model", default="selected", metavar="NAME",
        help="selected (default), a fitted model, or average over all of them",
    )  # fmt: skip


def add_target(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the target."""
    parser.add_argument(
        "--target", default="board", metavar="WHAT",
        help="board (default), corner:COLUMN,ROW, tag:DICTIONARY:ID, blob or cross",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Gaze and return the exit status: 3 if a target could not be measured or a gate had failed."""
    from calib.gaze.measured import aiming, lenses
    from calib.instrument.by_model import AVERAGE, instrument_of
    from calib.instrument.calibration_file import read_calibration

    measuring = read_calibration(arguments.calibration, allow_edited=arguments.allow_edited)
    if arguments.model != AVERAGE:
        instrument_of(measuring, arguments.model)
    refused = warn_of_failed(
        arguments.calibration, measuring.failed_gates, accepted=arguments.accept_failed
    )
    interrupted: KeyboardInterrupt | None = None
    with opened(arguments.rig) as rig:
        known = lenses(measuring, rig, name=str(arguments.calibration))
        gazer = make_gazer(arguments, rig, known.c2, lens_c1=known.c1)
        with writer(arguments.out) as write:
            put = as_json_lines(write) if arguments.json else write
            table = _Table(arguments, measuring, put)
            work = _follow if arguments.follow else _gaze_at_each
            try:
                work(arguments, rig, gazer, aiming(measuring, known.c1), table)
            except KeyboardInterrupt as ended:
                # The motor first; then what was measured is kept.
                rig.axis.stop()
                interrupted = ended
    if interrupted is not None:
        raise interrupted
    return NOT_ALL if table.report() or refused else DONE


def make_gazer(
    arguments: argparse.Namespace,
    rig: RigDevices,
    lens_c2: Camera,
    *,
    lens_c1: Camera | None = None,
    at: Target | None = None,
) -> Gazer:
    """Return the rig ready to gaze at the target asked for, as its last check found it.

    Parameters
    ----------
    at
        A target instead of the one that the arguments name.
    """
    from calib.gaze.gazing import Gazer, law_of
    from calib.gaze.target import target
    from calib.rig.known import known_board

    check = last_check(arguments.rig, rig.serial)
    return Gazer(
        rig=rig,
        target=at or target(arguments.target, known_board(rig)),
        lens_c1=lens_c1,
        lens_c2=lens_c2,
        law=law_of(rig, lens_c2, backlash_steps=0.0 if check is None else check.backlash_steps),
        settle_s=0.0 if check is None else check.settle_s,
    )


def _gaze_at_each(
    arguments: argparse.Namespace,
    rig: RigDevices,
    gazer: Gazer,
    aiming: EpipolarAiming,
    table: _Table,
) -> None:
    """Gaze at one target after the other; what cannot be measured is a line that says why."""
    from calib.capture.rows import LOST_MAX
    from calib.gaze.placing import placing_for
    from calib.rig.protocols import Lost, RigError

    lost = 0
    hand = placing_for(rig, _tell)
    hint = _other_virtual_target(rig, arguments.target)
    for name in (f"t{i:02d}" for i in range(1, arguments.count + 1)):
        hand.place(name)
        try:
            table.add(name, gazer.gaze(aiming, depth_mm=table.last_mm))
        except RigError as error:
            table.refuse(name, f"{error}{hint}")
            lost = lost + 1 if isinstance(error, Lost) else 0
            if lost == LOST_MAX:
                raise
        else:
            lost = 0


def _other_virtual_target(rig: RigDevices, wanted: str) -> str:
    """Return what to add to a refusal where the virtual rig shows another target."""
    if rig.world is None:
        return ""
    shown, kind = rig.settings.virtual.target, wanted.partition(":")[0]
    if (shown == wanted) if kind == "tag" else {"corner": "board"}.get(kind, kind) == shown:
        return ""
    return (
        f"; the virtual rig shows {shown!r}: put up another by [virtual] target in a rig.toml, "
        "and give it by --rig"
    )


def _follow(
    arguments: argparse.Namespace,
    rig: RigDevices,
    gazer: Gazer,
    aiming: EpipolarAiming,
    table: _Table,
) -> None:
    """Gaze at one target once, at rest, and then follow it."""
    from calib.capture.rows import LOST_MAX
    from calib.gaze.following import Follower
    from calib.gaze.placing import placing_for, set_swaying
    from calib.rig.protocols import Lost, RigError

    placing_for(rig, _tell).place("t01")
    table.add("t01", gazer.gaze(aiming))
    set_swaying(rig)
    follower, lost = Follower(gazer, aiming), 0
    for name in (f"t{i:02d}" for i in range(2, arguments.count + 1)):
        try:
            table.add(name, follower.row(table.last_mm))
        except RigError as error:
            table.refuse(name, str(error))
            lost = lost + 1 if isinstance(error, Lost) else 0
            if lost == LOST_MAX:
                raise
        else:
            lost = 0


class _Table:
    """The rows as they come, and how many were refused."""

    def __init__(
        self, arguments: argparse.Namespace, measuring: Measuring, write: Callable[[str], None]
    ) -> None:
        from calib.gaze.table import header

        self._measuring = measuring
        self._model, self._quiet = arguments.model, arguments.quiet
        self._gate_failed = bool(measuring.failed_gates) and not arguments.accept_failed
        self._write = write
        self._refused: list[str] = []
        self.last_mm: float | None = None
        write(header())

    def add(self, name: str, row: GazeRow) -> None:
        """Write a row with the position of its target."""
        from calib.gaze.measured import position
        from calib.gaze.table import line

        found = position(self._measuring, row, model=self._model)
        if found.faults:
            self.refuse(name, found.faults[0])
            return
        self.last_mm = float(found.position_mm[0, 2])
        self._write(
            line(
                name, row, found,
                calibrated_mm=self._measuring.calibrated_mm, gate_failed=self._gate_failed,
            )
        )  # fmt: skip

    def refuse(self, name: str, reason: str) -> None:
        """Write why there is no position."""
        from calib.gaze.table import refused

        self._refused.append(name)
        self._write(refused(name, reason))
        _tell(f"calib: {name}: {reason}")

    def report(self) -> bool:
        """Say how many were refused; return whether any was."""
        if self._refused and not self._quiet:
            _tell(f"calib: {len(self._refused)} target(s) could not be measured")
        return bool(self._refused)


def _tell(line: str) -> None:
    say(line)
