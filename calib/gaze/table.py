"""Gazed rows as CSV: the columns of `calib measure`, and how each row came about."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.gaze.row import GazeRow
from calib.instrument.measured_text import POSITION_COLUMNS, csv_text, is_extrapolated, status_of
from calib.instrument.measuring import Positions

COVARIANCE = ("xx", "xy", "xz", "yy", "yz", "zz")
COLUMNS = (
    *POSITION_COLUMNS[:-1],
    *(f"cov_{name}_mm2" for name in COVARIANCE),
    "u1_px", "v1_px", "u_c1_px", "u2_px", "u_c2_px", "alpha2_deg",
    "moves", "looks", "age_c1_ms", "age_c2_ms",
    "status",
)  # fmt: skip
"""`age_c1_ms` and `age_c2_ms` are those of the oldest frame of the row when it came to hand."""


def header() -> str:
    """Return the first line."""
    return csv_text([COLUMNS])


def line(
    name: str,
    row: GazeRow,
    position: Positions,
    *,
    calibrated_mm: tuple[float, float],
    gate_failed: bool,
) -> str:
    """Return the line of a row.

    Parameters
    ----------
    position
        What was measured with it, one row.
    calibrated_mm
        Range of depth that the calibration covers.
    gate_failed
        Whether a check of the calibration failed: then no row is simply "ok".
    """
    if position.faults:
        return refused(name, position.faults[0])
    outside = is_extrapolated(position.position_mm[:, 2], calibrated_mm)
    numbers = [
        *position.position_mm[0], *position.std_mm[0], position.low95_mm[0], position.high95_mm[0],
    ]  # fmt: skip
    covariance = position.covariance_mm2[0][np.triu_indices(3)]
    return csv_text(
        [
            (
                name,
                *(f"{number:.4f}" for number in numbers),
                ("no", "yes")[outside],
                *(f"{number:.8g}" for number in covariance),
                *_read(row),
                status_of(outside, gate_failed=gate_failed),
            )
        ]
    )


def _read(row: GazeRow) -> Sequence[str]:
    """Return what was read and how, as cells."""
    pixels = (*row.pixel_c1, row.u_c1_px, row.pixel_c2[0], row.u_c2_px)
    ages = (max(seen.age_ms for seen in part) for part in (row.c1, row.c2))
    return (
        *(f"{value:.4f}" for value in pixels),
        f"{np.degrees(row.standstill.reading_rad):.7f}",
        str(row.moves),
        str(row.looks),
        *(f"{age:.1f}" for age in ages),
    )


def refused(name: str, reason: str) -> str:
    """Return the line of a target that could not be measured: no numbers, and why."""
    return csv_text([(name, *("",) * (len(COLUMNS) - 2), reason)])
