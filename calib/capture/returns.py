"""Returns to the first target while rows are captured: whether the zero stands still.

A motor heats, a cable pulls, steps are lost: rows then have different zeros, and nothing in a
single row shows it. Every few rows the first target is put up again where it stood, C2 goes back to
the reading that it had there, and what its picture shows elsewhere is the change. It is drawn into
a control chart and written into the dataset, where the calibration reads it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count as from_number
from typing import Final

import numpy as np

from calib.capture.description import Description, add_tables
from calib.capture.journal import now, row_journal
from calib.capture.writer import GrowingFolder
from calib.core.arrays import FloatArray
from calib.dataset.encoder import Encoder
from calib.dataset.returns import COLUMNS, TIME, scan_returns
from calib.dataset.tables import ReturnTable
from calib.gaze.aim import Aiming, BlindAiming
from calib.gaze.gazing import Gazer
from calib.gaze.placing import Placing
from calib.gaze.row import GazeRow
from calib.instrument.returns import control_of, control_words
from calib.rig.known import Role
from calib.rig.protocols import Refused, RigError

TABLE: Final = "returns.csv"
EVERY: Final = 10
"""Rows between two returns."""

TRIES: Final = 3
"""A return that is refused is tried so often."""

BACK_PX: Final = 1.0
"""A target that C1 sees farther from where it was is not back: what a change of its depth does to
C2's reading C1 does not show, and who misses the place sideways misses it in depth."""

SAME_PX: Final = 0.1
"""A target within this of where it was is found with the same error."""

CHART_HALF: Final = 12
"""Characters of the chart from its middle to a limit."""


@dataclass(frozen=True)
class First:
    """The row whose target is returned to, as the journal has it.

    Parameters
    ----------
    name
        Its id.
    depth_mm
        Of its target.
    reading_rad
        Where C2 stood.
    pixel_c1, pixel_c2
        Where the cameras saw the target, px, shape (2,).
    u_c1_px, u_c2_px
        Standard uncertainty of a coordinate, px.
    """

    name: str
    depth_mm: float
    reading_rad: float
    pixel_c1: FloatArray
    pixel_c2: FloatArray
    u_c1_px: float
    u_c2_px: float


@dataclass(frozen=True)
class Returning:
    """What returns need.

    Parameters
    ----------
    gazer, hand, folder, known, announce
        As in `calib.capture.rows.Capture`.
    aiming
        Where targets of a depth, mm, are looked for.
    every
        Rows between two returns; 0 for none.
    u_return_rad
        Standard uncertainty with which C2 comes back to one reading, rad.
    """

    gazer: Gazer
    hand: Placing
    folder: GrowingFolder
    known: Description
    announce: Callable[[str], None]
    aiming: Callable[[float], Aiming]
    every: int
    u_return_rad: float


def is_due(returning: Returning) -> bool:
    """Return whether C2 should return now: after so many rows, or after a new reference run."""
    if not returning.every:
        return False
    stops = [e for e in returning.folder.all_events() if e.get("event") in ("row", "return")]
    if not stops:
        return False
    since = 0
    for event in stops:
        since = 0 if event["event"] == "return" else since + 1
    standing = stops[-1].get("standstill")
    home = standing.get("home") if isinstance(standing, dict) else None
    is_new_home = returning.gazer.rig.axis.standstill().home != home
    return since >= returning.every or is_new_home or not_in_control(returning) is not None


def not_in_control(returning: Returning) -> str | None:
    """Return what is wrong with the zero by the returns so far; None if nothing."""
    table = _table(returning)
    if table is None or not control_of(table, _encoder(returning.known)).outside[-1]:
        return None
    return control_words(table, _encoder(returning.known))


def return_to_first(returning: Returning) -> None:
    """Return to the first target and write what is found.

    Raises
    ------
    RigError
        If the target cannot be gazed at again, or the zero has changed.
    """
    first = first_row(returning.folder, target=returning.gazer.target.name)
    if first is None:
        return
    name = _next_name(returning.folder)
    row, change, u = _tried(returning, first, name)
    pictures = _pictures(name)
    returning.folder.note("begun", table=TABLE, id=name)
    for role, seen in (("c1", row.c1[-1]), ("c2", row.c2[0])):
        returning.folder.picture(pictures[role], seen.frame.pixels)
    after = returning.folder.events("row")[-1].get("id", "")
    numbers = (row.standstill.reading_rad, change, u, _u_first(returning, first, row))
    cells = {"id": name, "of": first.name, "after": str(after)}
    cells |= dict(zip(COLUMNS[3:], (f"{math.degrees(n):.9f}" for n in numbers), strict=True))
    cells[TIME] = now()
    returning.folder.add_row(TABLE, list(cells), cells)
    add_tables(returning.folder, {"returns": {"table": TABLE}})
    kept = {"c1": row.c1[-1], "c2": row.c2[0]}
    returning.folder.note("return", id=name, of=first.name, **row_journal(row, kept))
    table = _table(returning)
    if table is not None:
        returning.announce(_chart(table, _encoder(returning.known)))
    wrong = not_in_control(returning)
    if wrong is not None:
        raise RigError(wrong)


def first_row(folder: GrowingFolder, *, target: str) -> First | None:
    """Return the first row of a target's kind; None if the journal has none that is whole."""
    begun = None
    for event in folder.all_events():
        begun = event.get("target") if event.get("event") == "start" else begun
        if event.get("event") != "row" or begun != target:
            continue
        try:
            return First(
                name=str(event["id"]),
                depth_mm=float(event["depth_mm"]),
                reading_rad=math.radians(float(event["standstill"]["reading_deg"])),
                pixel_c1=np.array(event["pixel_c1"], dtype=np.float64).reshape(2),
                pixel_c2=np.array(event["pixel_c2"], dtype=np.float64).reshape(2),
                u_c1_px=float(event["u_c1_px"]),
                u_c2_px=float(event["u_c2_px"]),
            )
        except (KeyError, TypeError, ValueError):
            continue
    return None


def _tried(returning: Returning, first: First, name: str) -> tuple[GazeRow, float, float]:
    """Return the row of a return, the change of the zero and its uncertainty, rad."""
    for attempt in range(TRIES):
        returning.hand.place_again(name, of=first.name)
        try:
            row = returning.gazer.gaze_from(first.reading_rad)
            change, u = _change(returning, first, row)
            if abs(change) > returning.gazer.law.step_rad:
                # C2's centre stands off its axis: a change so large is read where C2 looks as then.
                row = returning.gazer.gaze_from(
                    returning.gazer.law.place(first.reading_rad + change)
                )
                change, u = _change(returning, first, row)
            return row, change, u
        except RigError as error:
            returning.folder.note("refused", table=TABLE, id=name, reason=str(error))
            returning.announce(f"{name}: {error}")
            if attempt == TRIES - 1:
                raise RigError(
                    f"{name}: the target of {first.name} cannot be gazed at again, so that nobody "
                    "knows whether the zero still stands; put it back where it stood, look for "
                    "lost steps, or go without returns (--returns 0)"
                ) from error
    raise AssertionError  # never: the last attempt returns or raises


def _change(returning: Returning, first: First, row: GazeRow) -> tuple[float, float]:
    """Return by how much the reading that gazes at the target has grown, and its uncertainty, rad.

    The target itself moved as C1 sees it; what that does to the reading is taken off.
    """
    gazer = returning.gazer
    then, here = (gazer.residual(pixel) for pixel in (first.pixel_c2, row.pixel_c2))
    if then is None or here is None:
        raise Refused("the target lies where C2's lens has no ray")
    off = row.pixel_c1 - first.pixel_c1
    if np.abs(off).max() > BACK_PX:
        raise Refused(
            f"C1 sees the target {np.hypot(*off):.1f} px from where it was for {first.name} "
            f"(limit {BACK_PX:g} px): put it back exactly, in a fixture"
        )
    expected = _reading(returning, first, row.pixel_c1) - _reading(returning, first, first.pixel_c1)
    change = row.standstill.reading_rad + here - first.reading_rad - then - expected
    own = math.hypot(*(_turn(returning, first, role, row) for role in ("c1", "c2")))
    return change, math.hypot(returning.u_return_rad, own)


def _u_first(returning: Returning, first: First, row: GazeRow) -> float:
    """Return what is uncertain of the first row in a comparison with a return, rad."""
    then = replace(row, u_c1_px=first.u_c1_px, u_c2_px=first.u_c2_px)
    here = replace(first, pixel_c1=row.pixel_c1, pixel_c2=row.pixel_c2)
    own = math.hypot(*(_turn(returning, here, role, then) for role in ("c1", "c2")))
    return math.hypot(returning.u_return_rad, own)


def _turn(returning: Returning, first: First, role: Role, row: GazeRow) -> float:
    """Return what a camera leaves uncertain of the turn between the first row and a return, rad.

    What a detector is off by for the place of the target between pixels is the same at the same
    place and drops out; elsewhere it counts twice, once for each of the two.
    """
    seen, pixel, was, u = (
        (row.c1, row.pixel_c1, first.pixel_c1, row.u_c1_px)
        if role == "c1"
        else (row.c2, row.pixel_c2, first.pixel_c2, row.u_c2_px)
    )
    floor = max(one.observation.floor_px for one in seen)
    noise = math.sqrt(max(u**2 - floor**2, 0.0))
    moved = float(np.abs(pixel - was).max()) > SAME_PX
    px = math.hypot(noise, math.sqrt(2) * floor if moved else 0.0)
    aside = pixel + np.array([1.0, 0.0])
    if role == "c1":
        return px * abs(_reading(returning, first, aside) - _reading(returning, first, pixel))
    turns = (returning.gazer.residual(aside) or 0.0) - (returning.gazer.residual(pixel) or 0.0)
    return px * abs(turns)


def _reading(returning: Returning, first: First, pixel_c1: FloatArray) -> float:
    """Return the reading that is expected for a pixel of C1 at the first target's depth, rad."""
    aiming = returning.aiming(first.depth_mm)
    if isinstance(aiming, BlindAiming):
        # Of C1 nothing is known: a pixel of it turns C2 about as much as one of C2's own.
        middle = np.array(returning.gazer.lens_c2.image_size) / 2
        off = returning.gazer.residual(middle + pixel_c1 - first.pixel_c1) or 0.0
        return off - (returning.gazer.residual(middle) or 0.0)
    return aiming.aim(pixel_c1, depth_mm=first.depth_mm).first_rad


def _table(returning: Returning) -> ReturnTable | None:
    """Return the returns so far to the present first target; None if there are none.

    Raises
    ------
    InputError
        If their table is damaged.
    """
    folder = returning.folder
    text, first = folder.text(TABLE), first_row(folder, target=returning.gazer.target.name)
    if text is None or first is None or not folder.rows(TABLE):
        return None
    table = scan_returns(text, name=TABLE).sound().to(first.name)
    return table if len(table) else None


def _encoder(known: Description) -> Encoder:
    return Encoder.model_validate(
        {
            "resolution_deg": known.resolution_deg,
            "u_alpha2_deg": known.u_alpha2_deg,
            **known.motor,
        }
    )


def _next_name(folder: GrowingFolder) -> str:
    """Return an id that no return had, and whose pictures are nobody's."""
    taken = {row.get("id") for row in folder.rows(TABLE)}
    taken |= {event.get("id") for event in folder.events("return")}
    begun = {event.get("id") for event in folder.events("begun") if event.get("table") == TABLE}
    for number in from_number(1):
        name = f"r{number:02d}"
        there = any((folder.root / path).exists() for path in _pictures(name).values())
        if name not in taken and (name in begun or not there):
            return name
    raise AssertionError  # never: numbers do not end


def _pictures(name: str) -> Mapping[str, str]:
    return {role: f"returns/{role}/{name}.png" for role in ("c1", "c2")}


def _chart(table: ReturnTable, encoder: Encoder) -> str:
    """Return the chart's line of the last return: its place between the limits, and in figures."""
    found = control_of(table, encoder).single
    z = float(found.statistic[-1])
    place = round(CHART_HALF * z / found.limit)
    width = CHART_HALF + 2
    cells = [" "] * (2 * width + 1)
    for edge in (-CHART_HALF, 0, CHART_HALF):
        cells[width + edge] = "|" if edge else ":"
    cells[width + min(max(place, -width), width)] = "*"
    change = math.degrees(table.change_rad[-1])
    return (
        f"{table.ids[-1]}: {table.of[-1]} again after {table.after[-1]}  "
        f"[{''.join(cells)}]  zero {change:+.4f} deg, {z:+.1f} u of {found.limit:g}"
    )
