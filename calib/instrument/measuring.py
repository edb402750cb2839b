"""Measuring with a finished calibration: positions and lengths from readings."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset.folder import decode
from calib.dataset.readers import read_lengths
from calib.dataset.tables import GazeTable, LengthTable
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibration_file import Measuring
from calib.rows.from_table import observe
from calib.uncertainty.measurement import with_standoff
from calib.uncertainty.predictive import depth_sources, linear_positions

TABLE_LIMIT_BYTES = 200_000_000
"""Some four million readings."""


def _bad(where: str, what: str, remedy: str) -> InputError:
    return InputError.single(where=where, what=what, remedy=remedy)


def table_text(source: bytes | Path, *, name: str) -> str:
    """Return the text of a table, from its bytes or its file.

    Raises
    ------
    InputError
        If it cannot be read, is too large or is not UTF-8.
    """
    remedy = "give a CSV table with a row for each reading, see datasets/README.md"
    if isinstance(source, Path):
        try:
            with source.open("rb") as file:
                source = file.read(TABLE_LIMIT_BYTES + 1)
        except OSError as error:
            raise _bad(name, f"cannot be read ({error.strerror})", remedy) from None
    if len(source) > TABLE_LIMIT_BYTES:
        raise _bad(name, f"is larger than {TABLE_LIMIT_BYTES // 1_000_000} MB", "split it")
    return decode(source, where=name)


def read_pairs(path: Path, measured: Positions) -> LengthTable:
    """Return the table of distances asked for.

    Raises
    ------
    InputError
        If it cannot be read or names a point that was not measured.
    """
    lengths = read_lengths(table_text(path, name=str(path)), name=str(path), known=False)
    known = set(measured.ids)
    problems = [
        Problem(
            where=f"{path}, line {lengths.line[i]} (id {lengths.ids[i]})",
            what=f"point {point!r} is not in the table of readings",
            remedy="name ids of that table",
        )
        for i in range(len(lengths))
        for point in (lengths.start[i], lengths.end[i])
        if point not in known
    ]
    if problems:
        raise InputError(problems)
    return lengths


class Positions(Protocol):
    """Positions with their uncertainties, by one model or by several."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Of the rows, n of them."""

    @property
    def position_mm(self) -> FloatArray:
        """Coordinates x, y, z in frame C1, shape (n, 3)."""

    @property
    def std_mm(self) -> FloatArray:
        """Standard uncertainties, shape (n, 3)."""

    @property
    def low95_mm(self) -> FloatArray:
        """Lower ends of the 95 % intervals of z, shape (n,)."""

    @property
    def high95_mm(self) -> FloatArray:
        """Upper ends, infinite where the reading does not limit the distance, shape (n,)."""

    def length(self, start: int, end: int) -> tuple[float, float]:
        """Return the distance of two points and its standard uncertainty, mm."""


@dataclass(frozen=True)
class Measured:
    """Positions with their uncertainties.

    Parameters
    ----------
    ids
        Of the rows, n of them.
    position_mm, std_mm
        x, y, z in frame C1 and their standard uncertainties, shape (n, 3).
    low95_mm, high95_mm
        Of z, shape (n,); infinite where the reading does not limit the distance.
    by_common, common
        Derivatives by parameters and shared errors, shape (n, 3, k), and their covariance (k, k).
    by_depth_row, by_row
        Effect, mm, of one standard deviation of each reading error of the row whose depth is used,
        and of the row itself where that is another one, shape (n, 3, 4) each.
    depth_of
        For each row the place of the row whose depth it uses.
    sources_mm
        What each source contributes to the standard uncertainty of z, by name, shape (n,) each.
    """

    ids: tuple[str, ...]
    position_mm: FloatArray
    std_mm: FloatArray
    low95_mm: FloatArray
    high95_mm: FloatArray
    by_common: FloatArray
    common: FloatArray
    by_depth_row: FloatArray
    by_row: FloatArray
    depth_of: tuple[int, ...]
    sources_mm: Mapping[str, FloatArray]

    def length(self, start: int, end: int) -> tuple[float, float]:
        """Return the distance of two points and its standard uncertainty, mm."""
        across = self.position_mm[end] - self.position_mm[start]
        length = float(np.linalg.norm(across))
        if length == 0:
            return 0.0, 0.0
        along = across / length
        common = along @ (self.by_common[end] - self.by_common[start])
        variance = float(common @ self.common @ common)
        own: dict[int, FloatArray] = {}
        for point, sign in ((end, 1.0), (start, -1.0)):
            parts = ((point, self.by_row), (self.depth_of[point], self.by_depth_row))
            for row, effect in parts:
                own[row] = own.get(row, np.zeros(effect.shape[2])) + sign * (along @ effect[point])
        variance += sum(float(effect @ effect) for effect in own.values())
        return length, float(np.sqrt(variance))


def measure(measuring: Measuring, table: GazeTable) -> Measured:
    """Return the positions of the points in a table of readings.

    Raises
    ------
    InputError
        If rows need a camera that the calibration does not hold, or C1's ray and C2's plane do
        not meet in front of C1.
    """
    _refuse_unseen(measuring, table)
    rows = observe(table, measuring.setup, None)
    loadings = rows.shared[:, : OBSERVABLE.z] if rows.shared_names else None
    # With u2 the motor's step is measured and no longer an error: rows differ.
    std = measuring.noise_factor * rows.std[:, : OBSERVABLE.z]
    instrument = measuring.instrument
    if rows.off_centre:
        instrument = with_standoff(instrument)
    linear = linear_positions(instrument, rows.gaze, loadings, reading_std=std)
    _refuse_unreachable(table, linear.position_mm[:, 2])
    place = {name: i for i, name in enumerate(table.ids)}
    depth_of = tuple(i if d is None else place[d] for i, d in enumerate(table.depth_row))
    source = np.array(depth_of)
    borrows = np.arange(len(table)) != source
    ray = np.stack([rows.x1c, rows.y1c, np.ones(len(table))], axis=1)
    z = linear.position_mm[source, 2]
    by_common, by_depth_row = linear.by_common.copy(), linear.own.copy()
    by_row = np.zeros_like(by_depth_row)
    # x = x1c z and y = y1c z: with another row's depth the errors come from two rows.
    by_common[borrows] = ray[borrows, :, None] * linear.by_common[source[borrows], 2][:, None]
    by_depth_row[borrows] = ray[borrows, :, None] * linear.own[source[borrows], 2][:, None]
    by_row[borrows, 0, OBSERVABLE.x1c] = (z * std[:, OBSERVABLE.x1c])[borrows]
    by_row[borrows, 1, OBSERVABLE.y1c] = (z * std[:, OBSERVABLE.y1c])[borrows]
    common = np.einsum("nik,kl,nil->ni", by_common, linear.common, by_common)
    u = np.sqrt(common + (by_depth_row**2).sum(axis=2) + (by_row**2).sum(axis=2))
    inverse, half = 1 / z, measuring.factor95 * u[:, 2] / z**2
    with np.errstate(divide="ignore"):
        high = np.where(half < inverse, 1 / (inverse - half), np.inf)
    return Measured(
        ids=table.ids,
        position_mm=ray * z[:, None],
        std_mm=u,
        low95_mm=1 / (inverse + half),
        high95_mm=high,
        by_common=by_common,
        common=linear.common,
        by_depth_row=by_depth_row,
        by_row=by_row,
        depth_of=depth_of,
        sources_mm={name: part[source] for name, part in depth_sources(instrument, linear).items()},
    )


def _refuse_unseen(measuring: Measuring, table: GazeTable) -> None:
    wants = {"c1": np.isfinite(table.u1_px), "c2": np.isfinite(table.u2_px)}
    for name, rows in wants.items():
        if rows.any() and getattr(measuring.setup.cameras, name) is None:
            i = int(np.flatnonzero(rows)[0])
            raise InputError.single(
                where=f"{table.file}, line {table.line[i]} (id {table.ids[i]})",
                what=f"is in pixels of {name}, whose intrinsics the calibration does not hold",
                remedy=f"calibrate with [cameras.{name}], or give normalised coordinates",
            )
    images = [i for i, name in enumerate(table.image_c1) if name is not None]
    if images:
        raise InputError.single(
            where=f"{table.file}, line {table.line[images[0]]} (id {table.ids[images[0]]})",
            what="names an image; measure takes coordinates",
            remedy="give u1_px and v1_px, or x1c and y1c",
        )


def _refuse_unreachable(table: GazeTable, z: FloatArray) -> None:
    problems = [
        Problem(
            where=f"{table.file}, line {table.line[i]} (id {table.ids[i]})",
            what="C1's ray and C2's gaze plane do not meet in front of C1",
            remedy="check x1c and alpha2_deg: units, sign, the row's order",
        )
        for i in np.flatnonzero(~(np.isfinite(z) & (z > 0)))
    ]
    if problems:
        raise InputError(problems)


def positions_csv(measuring: Measuring, measured: Positions) -> str:
    """Return the positions as CSV, one row per reading."""
    low, high = measuring.calibrated_mm
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    axes = ("x_mm", "y_mm", "z_mm")
    writer.writerow(
        ["id", *axes, *(f"u_{a}" for a in axes), "z_low95_mm", "z_high95_mm", "extrapolated"]
    )
    for i, name in enumerate(measured.ids):
        z = measured.position_mm[i, 2]
        numbers = [*measured.position_mm[i], *measured.std_mm[i]]
        numbers += [measured.low95_mm[i], measured.high95_mm[i]]
        outside = "no" if low <= z <= high else "yes"
        writer.writerow([name, *(_number(v) for v in numbers), outside])
    return text.getvalue()


def _number(value: float) -> str:
    """Return a length in mm to 0.1 um; more digits mean nothing at this accuracy."""
    return f"{value:.4f}" if math.isfinite(value) else "inf"


def sources_csv(measured: Measured) -> str:
    """Return what u(z) is made of as CSV: a row for each reading and source.

    Intrinsics and pose of the cameras are sources with what their errors do to the depth by way of
    the calibrated parameters and of the reading together. The sources add up in quadrature.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["id", "source", "u_z_mm", "share_percent"])
    for i, name in enumerate(measured.ids):
        whole = measured.std_mm[i, 2]
        for source, part in measured.sources_mm.items():
            writer.writerow([name, source, _number(part[i]), f"{100 * (part[i] / whole) ** 2:.2f}"])
    return text.getvalue()


def lengths_csv(measured: Positions, lengths: LengthTable) -> str:
    """Return distances between measured points as CSV, with their standard uncertainties.

    The points share the calibration's errors, which largely cancel for points near each other.
    """
    place = {name: i for i, name in enumerate(measured.ids)}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            "id",
            "from",
            "to",
            "length_mm",
            "u_length_mm",
            "reference_mm",
            "u_reference_mm",
            "error_mm",
        ]
    )
    for i, name in enumerate(lengths.ids):
        start, end = place[lengths.start[i]], place[lengths.end[i]]
        length, u = measured.length(start, end)
        reference, u_reference = lengths.length_mm[i], lengths.u_length_mm[i]
        known = [reference, u_reference, length - reference]
        shown = [_number(v) if math.isfinite(v) else "" for v in known]
        writer.writerow(
            [name, lengths.start[i], lengths.end[i], _number(length), _number(u), *shown]
        )
    return text.getvalue()
