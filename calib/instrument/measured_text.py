"""What was measured, as CSV: a row out for each row in."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence, Set

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import harmless as escaped
from calib.dataset.readings import ReadingBlock
from calib.dataset.tables import LengthTable
from calib.instrument.measuring import Measured, Positions

AXES = ("x_mm", "y_mm", "z_mm")
POSITION_COLUMNS = (
    "id", *AXES, *(f"u_{axis}" for axis in AXES),
    "z_low95_mm", "z_high95_mm", "extrapolated", "status",
)  # fmt: skip
SOURCE_COLUMNS = ("id", "source", "u_z_mm", "share_percent")
LENGTH_COLUMNS = (
    "id", "from", "to", "length_mm", "u_length_mm",
    "reference_mm", "u_reference_mm", "error_mm", "status",
)  # fmt: skip
OK, EXTRAPOLATED, GATE_FAILED = "ok", "extrapolated", "gate failed"


def is_extrapolated(z_mm: FloatArray, calibrated_mm: tuple[float, float]) -> bool:
    """Return whether any of the depths, shape (n,), lies outside those calibrated."""
    near, far = calibrated_mm
    return not bool(np.all((z_mm >= near) & (z_mm <= far)))


def status_of(extrapolated: bool, *, gate_failed: bool) -> str:
    """Return what is to be minded of a figure, "ok" if nothing is."""
    return ", ".join([EXTRAPOLATED] * extrapolated + [GATE_FAILED] * gate_failed) or OK


_FORMULA = ("=", "+", "-", "@")
"""What a cell that a spreadsheet takes for a formula begins with."""


def harmless(text: str) -> str:
    """Return a name as terminal and spreadsheet show it, who then obey nothing in it.

    What would be a formula gets an apostrophe; what does not print is escaped.
    """
    text = escaped(text)
    return f"'{text}" if _is_formula(text.lstrip("'")) else text


def as_given(cell: str) -> str:
    """Return the name without the apostrophe that `harmless` gave it."""
    return cell[1:] if cell.startswith("'") and _is_formula(cell.lstrip("'")) else cell


def _is_formula(text: str) -> bool:
    if not text.startswith(_FORMULA):
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def position_rows(
    block: ReadingBlock,
    measured: Positions,
    *,
    calibrated_mm: tuple[float, float],
    gate_failed: bool = False,
) -> str:
    """Return the positions as CSV, a row for each of the block, without header.

    Parameters
    ----------
    measured
        Of the block's rows without fault.
    calibrated_mm
        Range of depth that the calibration covers.
    gate_failed
        Whether a check of the calibration failed: then no row is simply "ok".
    """
    z = measured.position_mm[:, 2]
    outside = ~((z >= calibrated_mm[0]) & (z <= calibrated_mm[1]))
    words = [status_of(beyond, gate_failed=gate_failed) for beyond in (False, True)]
    status = [words[beyond] for beyond in outside.tolist()]
    extrapolated = [("no", "yes")[beyond] for beyond in outside.tolist()]
    numbers = [
        *measured.position_mm.T, *measured.std_mm.T, measured.low95_mm, measured.high95_mm,
    ]  # fmt: skip
    columns = [list(map("%.4f".__mod__, column.tolist())) for column in numbers]
    ids = map(harmless, measured.ids)
    rows = list(zip(ids, *columns, extrapolated, status, strict=True))
    empty = ("",) * (len(columns) + 1)
    for i, fault in measured.faults.items():
        rows[i] = (harmless(measured.ids[i]), *empty, fault)
    if len(rows) == len(block):
        return csv_text(rows)
    complete = [
        (harmless(block.ids[i]), *empty, block.faults.get(i, "")) for i in range(len(block))
    ]
    for i, row in zip(block.place.tolist(), rows, strict=True):
        complete[i] = row
    return csv_text(complete)


def source_rows(measured: Measured) -> str:
    """Return what u(z) is made of as CSV: a row for each reading and source, without header.

    Intrinsics and pose of the cameras are sources with what their errors do to the depth by way of
    the calibrated parameters and of the reading together. The sources add up in quadrature.
    """
    rows = []
    for i, name in enumerate(measured.ids):
        whole = measured.std_mm[i, 2]
        if i in measured.faults:
            continue
        for source, part in measured.sources_mm.items():
            share = f"{100 * (part[i] / whole) ** 2:.2f}"
            rows.append((harmless(name), source, _number(part[i]), share))
    return csv_text(rows)


def length_rows(
    measured: Positions,
    lengths: LengthTable,
    *,
    calibrated_mm: tuple[float, float],
    gate_failed: bool = False,
    repeated: Set[str] = frozenset(),
) -> tuple[str, int]:
    """Return distances between measured points as CSV without header, and how many have none.

    The points share the calibration's errors, which largely cancel for points near each other.
    `repeated` are ids that several readings have: no length says which of them it means.
    A length is extrapolated if one of its ends lies outside `calibrated_mm`, the depths calibrated.
    """
    place = {name: i for i, name in enumerate(measured.ids)}
    rows, failed = [], 0
    for i, name in enumerate(lengths.ids):
        ends = lengths.start[i], lengths.end[i]
        fault = _length_fault(measured, place, ends, repeated)
        known = [lengths.length_mm[i], lengths.u_length_mm[i]]
        if fault is not None:
            failed += 1
            rows.append((harmless(name), *ends, "", "", *map(_or_empty, known), "", fault))
            continue
        between = [place[end] for end in ends]
        length, u = measured.length(*between)
        shown = [*map(_or_empty, known), _or_empty(length - known[0])]
        beyond = is_extrapolated(measured.position_mm[between, 2], calibrated_mm)
        status = status_of(beyond, gate_failed=gate_failed)
        rows.append((harmless(name), *ends, _number(length), _number(u), *shown, status))
    return csv_text(rows), failed


def _length_fault(
    measured: Positions, place: dict[str, int], ends: tuple[str, str], repeated: Set[str]
) -> str | None:
    for point in ends:
        if point in repeated:
            return f"several readings have the id {point!r}: give each its own"
        if point not in place:
            return f"point {point!r} is not in the table of readings, or its row has a fault"
        if place[point] in measured.faults:
            return f"point {point!r} could not be measured: {measured.faults[place[point]]}"
    return None


def _or_empty(value: float) -> str:
    return _number(value) if math.isfinite(value) else ""


def _number(value: float) -> str:
    """Return a length in mm to 0.1 um; more digits mean nothing at this accuracy."""
    return f"{value:.4f}" if math.isfinite(value) else "inf"
