"""The length between two points: each is gazed at, and errors that both share cancel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from calib.gaze.aim import Aiming
from calib.gaze.gazing import Gazer
from calib.gaze.measured import positions
from calib.gaze.row import GazeRow, refuse_moved
from calib.gaze.target import Target
from calib.instrument.calibration_file import Measuring
from calib.instrument.measured_text import csv_text, is_extrapolated, status_of
from calib.instrument.measuring import Positions
from calib.rig.protocols import Refused

COLUMNS: Final = (
    "id", "from", "to", "length_mm", "u_length_mm", "low95_mm", "high95_mm",
    "from_z_mm", "to_z_mm", "status",
)  # fmt: skip

COVERAGE: Final = 1.96


@dataclass(frozen=True)
class GazedLength:
    """A distance between two targets.

    Parameters
    ----------
    rows
        Of the two, in the order in which they were gazed at.
    positions
        Of both.
    length_mm, u_mm
        Their distance and its standard uncertainty, mm.
    is_extrapolated
        Whether an end lies outside the depths that were calibrated.
    """

    rows: tuple[GazeRow, GazeRow]
    positions: Positions
    length_mm: float
    u_mm: float
    is_extrapolated: bool

    def status(self, *, gate_failed: bool) -> str:
        """Return what is to be minded of it, or that nothing is."""
        return status_of(self.is_extrapolated, gate_failed=gate_failed)


def gaze_length(
    gazer: Gazer, aiming: Aiming, measuring: Measuring, ends: tuple[Target, Target], *, model: str
) -> GazedLength:
    """Gaze at both ends and return their distance.

    The farther one, which needs C2 the more exactly, is gazed at first; the first is looked at
    again at the end, for a thing that moved in between has another length.

    Raises
    ------
    RigError
        If one of them cannot be gazed at, or moved; the message says why.
    """
    eyes = [replace(gazer, target=end) for end in ends]
    rows = [eye.gaze(aiming) for eye in eyes]
    again = eyes[0].find_in_c1()
    refuse_moved(f"C1, {ends[0].name}:", rows[0].c1, [again], eyes[0].noise_c1)
    found = positions(measuring, rows, model=model)
    for i, why in sorted(found.faults.items()):
        raise Refused(f"{ends[i].name}: {why}")
    length, u = found.length(0, 1)
    outside = is_extrapolated(found.position_mm[:, 2], measuring.calibrated_mm)
    return GazedLength((rows[0], rows[1]), found, length, u, outside)


def header() -> str:
    """Return the first line of a table of lengths."""
    return csv_text([COLUMNS])


def line(name: str, ends: tuple[Target, Target], found: GazedLength, *, gate_failed: bool) -> str:
    """Return the line of a length."""
    half = COVERAGE * found.u_mm
    z = found.positions.position_mm[:, 2]
    values = (found.length_mm, found.u_mm, found.length_mm - half, found.length_mm + half, *z)
    status = found.status(gate_failed=gate_failed)
    cells = (name, ends[0].name, ends[1].name, *(f"{value:.4f}" for value in values), status)
    return csv_text([cells])


def refused(name: str, ends: tuple[Target, Target], reason: str) -> str:
    """Return the line of a length that could not be measured: no numbers, and why."""
    nothing = ("",) * (len(COLUMNS) - 4)
    return csv_text([(name, ends[0].name, ends[1].name, *nothing, reason)])
