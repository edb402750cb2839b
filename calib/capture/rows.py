"""Gaze rows captured: gazed at, measured by hand, written."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count as from_number
from typing import Final

import numpy as np

from calib.capture.description import Description, Kind, add_sections, add_tables
from calib.capture.journal import now, refuse_earlier, row_journal
from calib.capture.references import Reference
from calib.capture.returns import EVERY, Returning, is_due, return_to_first
from calib.capture.writer import GrowingFolder
from calib.core.version import __version__
from calib.gaze.aim import Aiming, BlindAiming, EpipolarAiming
from calib.gaze.gazing import Gazer
from calib.gaze.placing import Placing
from calib.gaze.row import GazeRow
from calib.gaze.target import BoardCorner
from calib.geometry.camera import Camera
from calib.geometry.parameters import vector
from calib.rig.devices import RigDevices
from calib.rig.protocols import Lost, RigError

LETTERS: Final[Mapping[Kind, str]] = {"gaze": "g", "validation": "v"}

REFUSALS_MAX: Final = 10
"""Targets in a row that cannot be gazed at before the capture ends: something is wrong."""

LOST_MAX: Final = 3
"""Times in a row that a device is lost before the capture ends: no other target brings it back."""

NEARER, FARTHER = 0.85, 1.2
"""Depths looked through around the one measured by hand, in parts of it."""

SLACK_RAD: Final = float(np.deg2rad(8.0))
"""Readings before calibration are as wrong as the zero of a yaw axis set by eye."""

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Capture:
    """What a capture needs.

    Parameters
    ----------
    gazer
        The rig.
    hand
        Puts targets up.
    reference
        Measures their depths.
    folder
        Where the rows go.
    known
        What the manifest says of the rig.
    kind
        Which table.
    announce
        Told of each row, and of what is refused.
    u_return_rad
        Standard uncertainty with which C2 comes back to one reading, rad.
    returns_every
        Rows between two returns to the first target; 0 for none.
    """

    gazer: Gazer
    hand: Placing
    reference: Reference
    folder: GrowingFolder
    known: Description
    kind: Kind
    announce: Announce
    u_return_rad: float
    returns_every: int = EVERY

    @property
    def table(self) -> str:
        """Name of the table."""
        return f"{self.kind}.csv"


@dataclass(frozen=True)
class Captured:
    """How a capture ended: rows in the table, targets that were refused now."""

    rows: int
    refused: int


def capture_rows(capture: Capture, *, count: int) -> Captured:
    """Add rows until the table has `count` of them, or too many targets are refused in a row.

    Raises
    ------
    RigError
        If the zero of the readings has changed since the first row; see `calib.capture.returns`.
    UsageError
        If the computer's clock was set back since the last row.
    """
    aiming = before_calibration(capture.gazer.rig, capture.known.lenses.get("c1"))
    refuse_earlier(capture.folder.all_events())
    _note_start(capture)
    have, refused, in_a_row, lost = len(capture.folder.rows(capture.table)), 0, 0, 0
    returning = _returning(capture, aiming)
    while have < count and in_a_row < REFUSALS_MAX:
        if is_due(returning):
            return_to_first(returning)
        name = next_name(capture)
        try:
            _take(capture, aiming, name)
        except RigError as error:
            refused, in_a_row = refused + 1, in_a_row + 1
            lost = lost + 1 if isinstance(error, Lost) else 0
            capture.folder.note("refused", table=capture.table, id=name, reason=str(error))
            capture.announce(f"{name}: {error}")
            if lost == LOST_MAX:
                raise
            continue
        have, in_a_row, lost = have + 1, 0, 0
    if is_due(returning):
        return_to_first(returning)
    return Captured(have, refused)


def next_name(capture: Capture) -> str:
    """Return an id that no row has or had, and whose pictures are nobody's.

    A picture without a row is what a capture that was killed left of the row in work, if the
    journal says so: its name is free.
    """
    folder, table = capture.folder, capture.table
    taken = {row.get("id", "") for row in folder.rows(table)}
    taken |= {event.get("id", "") for event in folder.events("row") if event.get("table") == table}
    begun = {event.get("id") for event in folder.events("begun") if event.get("table") == table}
    for number in from_number(1):
        name = f"{LETTERS[capture.kind]}{number:02d}"
        there = any((folder.root / p).exists() for p in _pictures(capture.kind, name).values())
        if name not in taken and (name in begun or not there):
            return name
    raise AssertionError  # never: numbers do not end


def _pictures(kind: Kind, name: str) -> dict[str, str]:
    """Return the names of a row's pictures."""
    return {role: f"{kind}/{role}/{name}.png" for role in ("c1", "c2")}


def targets_before(folder: GrowingFolder) -> tuple[str, ...]:
    """Return the targets that were put up for rows and refusals, in the order of the journal."""
    tables = {f"{kind}.csv" for kind in LETTERS}
    return tuple(
        str(event.get("id"))
        for event in folder.all_events()
        if event.get("event") in ("row", "refused") and event.get("table") in tables
    )


def _returning(capture: Capture, aiming: Callable[[float], Aiming]) -> Returning:
    return Returning(
        gazer=capture.gazer,
        hand=capture.hand,
        folder=capture.folder,
        known=capture.known,
        announce=capture.announce,
        aiming=aiming,
        every=capture.returns_every,
        u_return_rad=capture.u_return_rad,
    )


def before_calibration(rig: RigDevices, lens_c1: Camera | None) -> Callable[[float], Aiming]:
    """Return where to look for a target of a known depth, mm, before there is a calibration."""
    baseline = rig.settings.nominal_baseline_mm
    if lens_c1 is None or baseline is None:
        return lambda _: BlindAiming(rig.axis.range_rad)
    theta = vector({"baseline_mm": baseline})
    return lambda depth: EpipolarAiming(
        theta, lens_c1, (NEARER * depth, FARTHER * depth), slack_rad=SLACK_RAD
    )


def _take(capture: Capture, aiming: Callable[[float], Aiming], name: str) -> None:
    """Take one row and write it."""
    capture.hand.place(name)
    depth = capture.reference.depth(name)
    z = depth.z_mm
    row = _gazer_for(capture.gazer, aiming(z)).gaze(aiming(z), depth_mm=z)
    capture.gazer.noise_c1 = capture.gazer.noise_c1.after(row.c1)
    capture.gazer.noise_c2 = capture.gazer.noise_c2.after(row.c2)
    pictures = _pictures(capture.kind, name)
    kept = {"c1": row.c1[-1], "c2": row.c2[0]}
    capture.folder.note("begun", table=capture.table, id=name)
    taken = {name: kept[role].frame.pixels for role, name in pictures.items()}
    for picture, pixels in (taken | dict(depth.pictures)).items():
        capture.folder.picture(picture, pixels)
    cells = _cells(capture, name, row, pictures) | dict(depth.cells)
    capture.folder.add_row(capture.table, list(cells), cells)
    add_sections(capture.folder, capture.known, capture.kind, capture.table)
    add_tables(capture.folder, depth.tables)
    capture.folder.note("row", table=capture.table, id=name, depth_mm=z, **row_journal(row, kept))
    capture.announce(
        f"{name}: {math.degrees(row.standstill.reading_rad):.4f} deg, {row.moves} moves, "
        f"z {z:.1f} mm"
    )


def _gazer_for(gazer: Gazer, aiming: Aiming) -> Gazer:
    """Return the gazer, with as many looks as a search over the whole range needs."""
    if not isinstance(aiming, BlindAiming):
        return gazer
    low, high = gazer.law.range_rad
    looks = 2 + math.ceil((high - low) / (gazer.law.field_rad / 2))
    law = replace(gazer.law, looks_max=looks, moves_max=looks + gazer.law.moves_max)
    return replace(gazer, law=law)


def _cells(
    capture: Capture, name: str, row: GazeRow, pictures: Mapping[str, str]
) -> dict[str, str]:
    """Return the cells of a row but for its depth.

    A board is found again in its pictures by the chain, which then knows how well; any other
    target is given by its pixels.
    """
    reading = f"{math.degrees(row.standstill.reading_rad):.9f}"
    target = capture.gazer.target
    if isinstance(target, BoardCorner) and target.board == capture.known.board:
        seen = {"image_c1": pictures["c1"], "image_c2": pictures["c2"]}
    else:
        seen = {
            "u1_px": f"{row.pixel_c1[0]:.5f}",
            "v1_px": f"{row.pixel_c1[1]:.5f}",
            "u2_px": f"{row.pixel_c2[0]:.5f}",
        }
    stopped = {"alpha2_deg": reading, "approach": str(row.standstill.approached), "time": now()}
    return {"id": name} | seen | stopped


def _note_start(capture: Capture) -> None:
    rig = capture.gazer.rig
    capture.folder.note(
        "start",
        time=now(),
        version=__version__,
        table=capture.table,
        serial=rig.serial,
        devices={"c1": rig.c1.identity, "c2": rig.c2.identity, "axis": rig.axis.identity},
        target=capture.gazer.target.name,
        u_alpha2_deg=capture.known.u_alpha2_deg,
    )
