"""Measuring with a finished calibration: positions and lengths from readings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import InputError
from calib.dataset.folder import decode
from calib.dataset.readers import read_lengths
from calib.dataset.tables import GazeTable, LengthTable
from calib.geometry.camera import Camera, on_centre_row, without_ray
from calib.geometry.plane import OBSERVABLE, Gaze
from calib.instrument.calibration_file import Measuring
from calib.rows.from_table import ImageObservations, observe
from calib.uncertainty.measurement import Instrument, with_standoff
from calib.uncertainty.predictive import LinearPositions, depth_sources, linear_positions

TABLE_LIMIT_BYTES = 200_000_000
"""Some four million readings."""


def _bad(where: str, what: str, remedy: str) -> InputError:
    return InputError.single(where=where, what=what, remedy=remedy)


def table_text(path: Path, *, name: str) -> str:
    """Return the text of a table.

    Raises
    ------
    InputError
        If it cannot be read, is too large or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(TABLE_LIMIT_BYTES + 1)
    except OSError as error:
        raise _bad(name, f"cannot be read ({error.strerror})", "give a CSV table") from None
    if len(data) > TABLE_LIMIT_BYTES:
        raise _bad(name, f"is larger than {TABLE_LIMIT_BYTES // 1_000_000} MB", "split it")
    return decode(data, where=name)


def read_pairs(path: Path) -> LengthTable:
    """Return the table of distances asked for.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    return read_lengths(table_text(path, name=str(path)), name=str(path), known=False)


class Positions(Protocol):
    """Positions with their uncertainties, by one model or by several."""

    @property
    def faults(self) -> Mapping[int, str]:
        """Why a row could not be measured, by its place."""

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

    @property
    def covariance_mm2(self) -> FloatArray:
        """Covariance of x, y, z of each point, shape (n, 3, 3)."""

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
    parts
        Instrument and positions of which the sources of uncertainty are computed when asked for.
    faults
        Why a row could not be measured, by its place; its numbers are NaN.
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
    parts: tuple[Instrument, LinearPositions]
    faults: Mapping[int, str]

    @property
    def sources_mm(self) -> dict[str, FloatArray]:
        """What each source contributes to the standard uncertainty of z, by name, shape (n,)."""
        sources = depth_sources(*self.parts)
        return {name: part[list(self.depth_of)] for name, part in sources.items()}

    @property
    def covariance_mm2(self) -> FloatArray:
        """Covariance of x, y, z of each point, shape (n, 3, 3)."""
        covariance = self.by_common @ self.common @ self.by_common.swapaxes(1, 2)
        for own in (self.by_depth_row, self.by_row):
            covariance += own @ own.swapaxes(1, 2)
        covariance[list(self.faults)] = np.nan
        return covariance

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


def measure(
    measuring: Measuring,
    table: GazeTable,
    seen: ImageObservations | None = None,
    *,
    refused: Mapping[int, str] = MappingProxyType({}),
) -> Measured:
    """Return the positions of the points in a table of readings.

    Parameters
    ----------
    refused
        Rows that are no readings, by their place, and why: they are not measured.
    seen
        Where pictures show the targets, and how well, for rows whose pixels are also in the table;
        None takes the pixels of the table with their usual uncertainty.

    A row that cannot be measured has NaN for numbers, and `faults` says why: its pixel lies outside
    the picture or where the lens has no ray, the calibration lacks the camera, or C1's ray and C2's
    gaze plane do not meet in front of C1.
    """
    table, faults = _usable(measuring, table, refused)
    rows = observe(table, measuring.setup, seen)
    loadings = rows.shared[:, : OBSERVABLE.z] if rows.shared_names else None
    # With u2 the motor's step is measured and no longer an error: rows differ.
    std = measuring.noise_factor * rows.std[:, : OBSERVABLE.z]
    instrument = measuring.instrument
    if rows.off_centre:
        instrument = with_standoff(instrument)
    with np.errstate(invalid="ignore"):
        linear = _in_blocks(instrument, rows.gaze, loadings, std)
    own_z = linear.position_mm[:, 2]
    for i in map(int, np.flatnonzero(~(np.isfinite(own_z) & (own_z > 0)))):
        faults.setdefault(i, NO_MEETING)
    borrows, source = _depth_sources(table, faults)
    ray = np.stack([rows.x1c, rows.y1c, np.ones(len(table))], axis=1)
    z = linear.position_mm[source, 2]
    z[list(faults)] = np.nan
    by_common, by_depth_row = linear.by_common, linear.own
    by_row = np.zeros_like(by_depth_row)
    if borrows.any():
        by_common, by_depth_row = by_common.copy(), by_depth_row.copy()
        # x = x1c z and y = y1c z: with another row's depth the errors come from two rows.
        by_common[borrows] = ray[borrows, :, None] * linear.by_common[source[borrows], 2][:, None]
        by_depth_row[borrows] = ray[borrows, :, None] * linear.own[source[borrows], 2][:, None]
        by_row[borrows, 0, OBSERVABLE.x1c] = (z * std[:, OBSERVABLE.x1c])[borrows]
        by_row[borrows, 1, OBSERVABLE.y1c] = (z * std[:, OBSERVABLE.y1c])[borrows]
    common = ((by_common @ linear.common) * by_common).sum(axis=2)
    u = np.sqrt(common + (by_depth_row**2).sum(axis=2) + (by_row**2).sum(axis=2))
    u[list(faults)] = np.nan
    inverse, half = 1 / z, measuring.factor95 * u[:, 2] / z**2
    with np.errstate(divide="ignore", invalid="ignore"):
        high = np.where(half < inverse, 1 / (inverse - half), np.inf)
    high[list(faults)] = np.nan
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
        depth_of=tuple(source.tolist()),
        parts=(instrument, linear),
        faults=faults,
    )


BLOCK = 8192
"""Rows whose derivatives a processor's cache holds: a million at once take twice as long."""


def _in_blocks(
    instrument: Instrument, gaze: Gaze, loadings: FloatArray | None, std: FloatArray
) -> LinearPositions:
    """Return what `linear_positions` does, block by block."""
    blocks = []
    for start in range(0, max(len(gaze), 1), BLOCK):
        part = slice(start, start + BLOCK)
        some = Gaze(gaze.x1c[part], gaze.y1c[part], gaze.alpha2[part], gaze.residual[part])
        given = None if loadings is None else loadings[part]
        blocks.append(linear_positions(instrument, some, given, reading_std=std[part]))
    if len(blocks) == 1:
        return blocks[0]
    return LinearPositions(
        position_mm=np.concatenate([b.position_mm for b in blocks]),
        by_common=np.concatenate([b.by_common for b in blocks]),
        common=blocks[0].common,
        own=np.concatenate([b.own for b in blocks]),
    )


NO_MEETING = "C1's ray and C2's gaze plane do not meet in front of C1: check units, signs and order"


def _depth_sources(table: GazeTable, faults: dict[int, str]) -> tuple[BoolArray, IntArray]:
    """Return which rows use another row's depth, and whose depth each uses, shape (n,) each."""
    own = np.arange(len(table))
    if not any(table.depth_row):
        return np.zeros(len(table), dtype=np.bool_), own
    place = {name: i for i, name in enumerate(table.ids)}
    count = Counter(table.ids)
    source = own.copy()
    for i, name in enumerate(table.depth_row):
        if name is None or name == table.ids[i]:
            continue
        other = place.get(name)
        if other is None:
            faults[i] = f"depth_row {name!r} is not the id of a row of this table"
        elif count[name] > 1:
            faults[i] = f"depth_row {name!r} is the id of several rows: give each its own"
        elif table.depth_row[other] not in (None, name):
            faults[i] = f"depth_row {name!r} takes its own depth from another row"
        elif other in faults:
            faults[i] = f"depth_row {name!r} could not be measured"
        else:
            source[i] = other
            # Its own plane and ray need not meet: only its ray is used.
            if faults.get(i) == NO_MEETING:
                del faults[i]
    return source != own, source


def _usable(
    measuring: Measuring, table: GazeTable, refused: Mapping[int, str]
) -> tuple[GazeTable, dict[int, str]]:
    """Return the table without the pixels that no ray reaches, and why rows have none."""
    faults = dict(refused)
    cleared = table
    for name, columns in (("c1", ("u1_px", "v1_px")), ("c2", ("u2_px",))):
        pixels = np.stack([getattr(table, column) for column in columns], axis=1)
        given = np.isfinite(pixels).all(axis=1)
        if not given.any():
            continue
        camera: Camera | None = getattr(measuring.setup.cameras, name)
        fault = np.full(len(table), None, dtype=object)
        if camera is None:
            fault[given] = (
                f"{' '.join(columns)}: in pixels of {name}, whose intrinsics the calibration does "
                "not hold"
            )
        else:
            full = pixels if name == "c1" else on_centre_row(camera, pixels[:, 0])
            fault[without_ray(camera, full)] = (
                f"{' '.join(columns)}: the lens of {name} has no ray there"
            )
            size = np.array(camera.image_size, dtype=np.float64)[: pixels.shape[1]]
            with np.errstate(invalid="ignore"):
                outside = given & ((pixels < -0.5) | (pixels > size - 0.5)).any(axis=1)
            fault[outside] = (
                f"{' '.join(columns)}: outside the picture of {name}, "
                f"{camera.image_size[0]} x {camera.image_size[1]} px"
            )
        bad = np.flatnonzero(fault != None)  # noqa: E711 - element by element
        faults |= {int(i): str(fault[i]) for i in bad if int(i) not in faults}
        if len(bad):
            pixels[bad] = np.nan
            cleared = (
                replace(cleared, u1_px=pixels[:, 0], v1_px=pixels[:, 1])
                if name == "c1"
                else replace(cleared, u2_px=pixels[:, 0])
            )
    return cleared, faults
