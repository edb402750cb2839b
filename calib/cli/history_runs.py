"""What the commands of `calib history` do."""

from __future__ import annotations

import argparse
import math
import sys
from datetime import date, datetime
from typing import TYPE_CHECKING

from calib.cli.acceptance import DONE, GATE_FAILED, warn_of_failed
from calib.cli.gaze import make_gazer
from calib.cli.length import PLATE
from calib.cli.rig_options import opened
from calib.cli.voice import print_json, records
from calib.core.errors import harmless
from calib.core.words import counted
from calib.stages.output_guard import OutputKind, files_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from calib.history.certified import Standard
    from calib.history.entry import IndexEntry
    from calib.instrument.calibration_file import Measuring

NOT_ALL = 3
"""Some calibrations were edited, damaged or of no whole run."""

MARK = b'data-generator="calib history chart" '

FLEET = "index.html"
PAGES = OutputKind(is_folder=True, files=(("*.html", (b'content="calib history page"',)),))

SESSIONS = 5
"""At acceptance. A session costs minutes, and the more there are the less their error hides."""

SHOWN = 10
"""Paths of a kind that are named; a fleet that was moved would fill the screen."""


def run_index(arguments: argparse.Namespace) -> int:
    """Index folders and say what changed; return 3 if some could not be read."""
    from calib.history.index import update

    found = update(arguments.index, arguments.folders)
    kinds = {
        "added": found.added,
        "changed": found.changed,
        "deleted": found.deleted,
        "moved": tuple(f"{old} to {new}" for old, new in found.moved),
        "left out": tuple(f"{path}: {why}" for path, why in found.failed),
        "cannot be read": tuple(f"{path}: {why}" for path, why in found.unreadable),
    }
    if arguments.json:
        print_json({"index": str(arguments.index), "calibrations": found.calibrations, **kinds})
    for kind, paths in kinds.items():
        if arguments.json or (arguments.quiet and kind != "cannot be read"):
            continue
        for path in paths[:SHOWN]:
            print(f"  {kind}: {harmless(str(path))}")
        if len(paths) > SHOWN:
            print(f"  {kind}: and {len(paths) - SHOWN} more")
    if not (arguments.json or arguments.quiet):
        count = counted(found.calibrations, "calibration")
        print(f"{harmless(str(arguments.index))}: {count} found")
    if not (found.calibrations or found.failed or found.unreadable):
        print("calib: no calibrations there: calib calibrate or batch first", file=sys.stderr)
    if found.unreadable:
        number = len(found.unreadable)
        print(f"calib: {number} calibration(s) are not indexed, see above", file=sys.stderr)
    return NOT_ALL if found.unreadable else DONE


def run_show(arguments: argparse.Namespace) -> int:
    """Print all rigs, or one rig's calibrations and charts."""
    from calib.core.errors import UsageError
    from calib.history.index import rigs
    from calib.history.output import text
    from calib.history.summary import ACCEPTED, notes, show

    if arguments.rig is None:
        if arguments.repaired is not None or arguments.repairs is not None:
            raise UsageError("--repaired and --repairs: name a rig to show")
        known = rigs(arguments.index)
        if arguments.json:
            named = [{"rig": r, "calibrations": number, "last": last} for r, number, last in known]
            print_json({"rigs": named})
        elif not arguments.quiet:
            rows = [[harmless(rig), str(number), last] for rig, number, last in known]
            sys.stdout.write(text([("Rigs", [["rig", "calibrations", "last"], *rows])]))
        return 0
    accepted = arguments.accepted or ACCEPTED
    entries = _counting(arguments)
    dates = f"{entries[0].date} to {entries[-1].date}"
    said, table = notes(entries, accepted=accepted), show(entries, accepted=accepted)
    if arguments.json:
        made = [
            {
                "date": one.date,
                "path": one.path,
                "dataset": one.dataset,
                "model": one.model,
                "range_mm": one.range_mm,
                "values": dict(zip(one.names, one.values.tolist(), strict=True)),
                "std": {
                    name: math.sqrt(variance)
                    for name, variance in zip(one.names, one.covariance.diagonal(), strict=True)
                },
            }
            for one in entries
        ]
        print_json({"rig": arguments.rig, "calibrations": made, "charts": records(table),
                    "notes": said})  # fmt: skip
        return 0
    if not arguments.quiet:
        count = counted(len(entries), "calibration")
        sys.stdout.write(text([(f"{harmless(arguments.rig)}: {count}, {dates}", table)]))
    for note in said:
        print(f"note: {note}")
    return 0


def run_chart(arguments: argparse.Namespace) -> int:
    """Write one rig's control charts."""
    from calib.core.errors import InputError
    from calib.history.drawing import chart_rows, legend, one_drawing
    from calib.history.quantities import series
    from calib.history.summary import ACCEPTED
    from calib.stages.files import write_bytes

    accepted = arguments.accepted or ACCEPTED
    entries = _counting(arguments)
    if len(entries) <= accepted:
        raise InputError.single(
            where=arguments.rig,
            what=f"has {counted(len(entries), 'calibration')}; {accepted} make the reference",
            remedy="calibrate it again, or give a smaller --accepted",
        )
    picture = one_drawing(
        chart_rows(series(entries), accepted=accepted),
        title=f"Rig {entries[0].rig}, calibrations from {entries[0].date} to {entries[-1].date}",
        caption=legend(accepted=accepted, of="calibrations"),
    ).encode()
    write_bytes(arguments.out, picture.replace(b"<svg ", b"<svg " + MARK, 1))
    if not arguments.quiet:
        print(f"{harmless(str(arguments.out))}: written")
    return 0


def run_due(arguments: argparse.Namespace) -> int:
    """Print when a rig is due."""
    from calib.core.errors import InputError
    from calib.history.summary import due, due_text, notes

    entries = _counting(arguments)
    found = due(entries, tolerance_mm=arguments.tolerance)
    if found is None:
        raise InputError.single(
            where=arguments.rig,
            what="has fewer than two calibrations on different days, so no interval",
            remedy="calibrate it again after an interval of your choice",
        )
    said = notes(entries, accepted=0)
    if arguments.json:
        day, told, of = found
        print_json({"rig": arguments.rig, "due": day.isoformat(), "interval_days": told.interval,
                    "method": told.method, "risk": told.risk, "capped": told.capped,
                    "quantity": of.name, "notes": said})  # fmt: skip
        return 0
    if not arguments.quiet or found[0] < date.today():
        print(f"{harmless(arguments.rig)}: " + "\n".join(due_text(found)))
    for note in said:
        print(f"note: {note}")
    return 0


def _repairs(arguments: argparse.Namespace) -> dict[str, date]:
    """Return the last repair of rigs that had one, as far as it is given."""
    from calib.core.errors import UsageError
    from calib.history.entry import one_spelling
    from calib.history.index import rigs
    from calib.history.repairs import read_repairs

    if arguments.repairs is not None:
        known = {rig for rig, _, _ in rigs(arguments.index)}
        return read_repairs(arguments.repairs, known=known)
    if arguments.repaired is None:
        return {}
    if arguments.rig is None:
        raise UsageError("--repaired: name the rig that was repaired; --repairs is of many")
    return {one_spelling(arguments.rig): arguments.repaired}


def _counting(arguments: argparse.Namespace) -> Sequence[IndexEntry]:
    """Return the calibrations of the rig that was asked for, since its last repair."""
    from calib.history.index import history
    from calib.history.summary import since

    entries = history(arguments.index, arguments.rig)
    return since(entries, _repairs(arguments).get(entries[0].rig))


def run_page(arguments: argparse.Namespace) -> int:
    """Write the pages."""
    from calib.history.index import history, rigs
    from calib.history.page import fleet_page, page_name, rig_page
    from calib.history.summary import ACCEPTED
    from calib.stages.files import make_folder, write_bytes

    asked = {"accepted": arguments.accepted or ACCEPTED, "tolerance_mm": arguments.tolerance}
    repairs = _repairs(arguments)
    wanted = [arguments.rig] if arguments.rig else [rig for rig, _, _ in rigs(arguments.index)]
    histories = [history(arguments.index, rig) for rig in wanted]
    pages = {entries[0].rig: entries for entries in histories}
    make_folder(arguments.out)
    names = [FLEET, *map(page_name, pages)]
    places = files_of(arguments.out, names, PAGES, option="--out", force=arguments.force)
    if arguments.rig is None or not places[FLEET].exists():
        fleet = [history(arguments.index, rig) for rig, _, _ in rigs(arguments.index)]
        write_bytes(places[FLEET], fleet_page(fleet, repairs=repairs, **asked).encode())
    for rig, entries in pages.items():
        one = rig_page(entries, repaired=repairs.get(rig), **asked)
        write_bytes(places[page_name(rig)], one.encode())
    said = places[FLEET if arguments.rig is None else page_name(next(iter(pages)))]
    if not arguments.quiet:
        print(f"{harmless(str(said))}: written")
    return 0


def run_check(arguments: argparse.Namespace) -> int:
    """Chart a check standard; return 3 on an alarm."""
    from calib.history.output import text
    from calib.history.read_standard import read_standard
    from calib.history.standard import check_standard
    from calib.history.standard_text import findings, notes, page, table
    from calib.instrument.calibration_file import read_calibration
    from calib.instrument.measuring import table_text
    from calib.stages.files import write_bytes

    measuring = read_calibration(arguments.calibration, allow_edited=arguments.allow_edited)
    minded = warn_of_failed(
        arguments.calibration, measuring.failed_gates, accepted=arguments.accept_failed
    )
    standard = read_standard(arguments.standard)
    name = str(arguments.readings)
    if arguments.gaze or arguments.rig is not None:
        _add_session(arguments, measuring, standard)
    checked = check_standard(
        measuring, standard, table_text(arguments.readings, name=name), name=name
    )
    accepted = arguments.accepted or SESSIONS
    title = f"Check standard {standard.serial}"
    dates = f"{len(checked.dates)} sessions, {checked.dates[0]} to {checked.dates[-1]}"
    charts, said = table(checked, accepted=accepted), findings(checked, accepted=accepted)
    kept = notes(checked, accepted=accepted)
    if arguments.json:
        print_json({"standard": standard.serial, "sessions": checked.dates,
                    "charts": records(charts), "notes": kept, "alarms": said})  # fmt: skip
    else:
        if not arguments.quiet:
            sys.stdout.write(text([(f"{title}: {dates}", charts)]))
            for note in kept:
                print(f"note: {note}")
        for finding in said:
            print(f"ALARM: {finding}")
    if arguments.out is not None:
        write_bytes(arguments.out, page(title, checked, accepted=accepted).encode())
        if not (arguments.json or arguments.quiet):
            print(f"page: {harmless(str(arguments.out))}")
    return GATE_FAILED if said or minded else DONE


def _add_session(arguments: argparse.Namespace, measuring: Measuring, standard: Standard) -> None:
    """Gaze at the standard and add what was read to the table, whole or not at all."""
    from calib.core.errors import InputError
    from calib.gaze.measured import aiming, lenses
    from calib.gaze.placing import placing_for
    from calib.history.gazed import gaze_standard, has_sessions, targets_of, with_session
    from calib.history.standard import check_standard
    from calib.rig.known import known_board
    from calib.stages.files import write_bytes

    name, plates = (
        str(arguments.readings),
        "plate:" in "".join(map(standard.gazed_as, standard.targets)),
    )
    before, table = _table_so_far(arguments.readings), arguments.readings.resolve()
    if not table.parent.is_dir():
        raise InputError.single(
            where=str(table.parent), what="is not a folder", remedy="make it, or name another"
        )
    if has_sessions(before, name=name):
        # What cannot be read afterwards is told before the rig moves.
        check_standard(measuring, standard, before, name=name)
    with opened(arguments.rig, virtual_target=PLATE if plates else None) as rig:
        known = lenses(measuring, rig, name=str(arguments.calibration))
        targets = targets_of(standard, known_board(rig))
        first = next(iter(targets.values()))
        gazer = make_gazer(arguments, rig, known.c2, lens_c1=known.c1, at=first)
        if rig.world is not None:
            placing_for(rig, print).place(standard.serial)
        rows = gaze_standard(gazer, aiming(measuring, known.c1), targets)
    now = datetime.now().isoformat(timespec="seconds")
    after = with_session(_table_so_far(arguments.readings), rows, date=now, name=name)
    check_standard(measuring, standard, after, name=name)
    write_bytes(table, after.encode())
    print(f"{harmless(name)}: session of {now} added", file=sys.stderr)


def _table_so_far(path: Path) -> str:
    from calib.instrument.measuring import table_text

    return table_text(path, name=str(path)) if path.exists() else ""
