"""A calibrated rig for Python: readings in, positions with their uncertainties out.

`calib measure` is the same with a table around it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import UsageError
from calib.dataset.reading_values import not_numbers, value_faults
from calib.dataset.tables import GazeTable
from calib.instrument.by_model import SELECTED, measure_by
from calib.instrument.calibration_file import Measuring, read_calibration
from calib.instrument.measuring import Positions

RESULT = "calibration.json"


class FailedGates(UserWarning):
    """A calibration is used whose gates failed: its uncertainties cannot be relied on."""


def load(
    path: str | os.PathLike[str], *, accept_failed: bool = False, allow_edited: bool = False
) -> Rig:
    """Return the rig that a calibration describes.

    Parameters
    ----------
    path
        A calibration.json, or the folder of a run.
    accept_failed
        Whether to be silent where gates of the calibration failed.
    allow_edited
        Whether a file that was edited by hand is taken all the same.

    Raises
    ------
    InputError
        If the file is none, is damaged or edited, lies in the folder of a run that did not finish,
        has another format or holds no gaze calibration.

    Warns
    -----
    FailedGates
        If gates of the calibration failed.
    """
    file = Path(path)
    file = file / RESULT if file.is_dir() else file
    measuring = read_calibration(file, allow_edited=allow_edited)
    if measuring.failed_gates and not accept_failed:
        failed = "; ".join(f"{gate.name} ({gate.detail})" for gate in measuring.failed_gates)
        warnings.warn(f"{file}: must not be used, gates failed: {failed}", FailedGates, 2)
    return Rig(measuring)


@dataclass(frozen=True)
class Rig:
    """A calibrated rig; make one with `calib.load`.

    Parameters
    ----------
    measuring
        The instrument, as the calibration describes it.
    """

    measuring: Measuring = field(repr=False)

    def __repr__(self) -> str:
        low, high = self.calibrated_mm
        failed = f", gates failed: {', '.join(self.failed_gates)}" if self.failed_gates else ""
        return f"Rig(calibrated from {low:g} to {high:g} mm, {' '.join(self.models)}{failed})"

    @property
    def failed_gates(self) -> tuple[str, ...]:
        """Names of the gates that failed: a rig with any must not be used."""
        return tuple(gate.name for gate in self.measuring.failed_gates)

    @property
    def calibrated_mm(self) -> tuple[float, float]:
        """Nearest and farthest depth that the calibration covers, mm."""
        return self.measuring.calibrated_mm

    @property
    def models(self) -> tuple[str, ...]:
        """Models that `measure` takes: "selected", "average", and the fitted ones by name."""
        m = self.measuring
        return (SELECTED, "average", *(share.model for share in m.shares), *m.by)

    def measure(
        self,
        *,
        alpha2_deg: ArrayLike,
        x1c: ArrayLike | None = None,
        y1c: ArrayLike | None = None,
        u1_px: ArrayLike | None = None,
        v1_px: ArrayLike | None = None,
        u2_px: ArrayLike | None = None,
        depth_of: Sequence[int] | None = None,
        model: str = SELECTED,
    ) -> Points:
        """Return the positions of targets from readings.

        Parameters
        ----------
        alpha2_deg
            Readings of the encoder, degrees in (0, 180), shape (n,). All others have this shape,
            or are one number for all. A NaN in any of them, given that it could not be read,
            leaves its target unmeasured, as do values that `calib measure` refuses.
        x1c, y1c
            Normalised, undistorted coordinates in C1.
        u1_px, v1_px
            Instead: pixels in C1's picture as it comes, if the calibration holds C1's lens.
        u2_px
            The target's column in C2's picture, px; without it C2 is taken to gaze at the target
            exactly.
        depth_of
            For each reading the place of the one whose measured depth it takes, as corners of a
            plane board do, counted from 0; by default its own.
        model
            One of `models`.

        Returns
        -------
        Points
            In order. A reading that cannot be measured has NaN, and `Points.status` says why.

        Raises
        ------
        UsageError
            If arrays have different lengths or coordinates are missing, `depth_of` names a place
            that there is not, or there is no such model.
        """
        columns = _columns(
            alpha2_deg=alpha2_deg, x1c=x1c, y1c=y1c, u1_px=u1_px, v1_px=v1_px, u2_px=u2_px
        )
        # A value that is none must not pass for one that was left out, as y1c = 0 or u2 gazed at.
        refused = value_faults(columns) | not_numbers(columns)
        if refused:
            columns = {name: _without(column, refused) for name, column in columns.items()}
        table = reading_table(columns, depth_of)
        positions = measure_by(self.measuring, table, model=model, refused=refused)
        return Points(positions, self.calibrated_mm)


@dataclass(frozen=True)
class Points:
    """Measured positions in frame C1, n of them; NaN where a reading could not be measured.

    Parameters
    ----------
    positions
        As measured.
    calibrated_mm
        Nearest and farthest depth that the calibration covers, mm.
    """

    positions: Positions
    calibrated_mm: tuple[float, float]

    def __len__(self) -> int:
        return len(self.positions.position_mm)

    def __repr__(self) -> str:
        beyond, none = int(self.extrapolated.sum()), len(self) - int(self.valid.sum())
        return f"Points({len(self)} readings, {beyond} extrapolated, {none} not measured)"

    @property
    def xyz_mm(self) -> FloatArray:
        """Coordinates x, y, z, mm, shape (n, 3)."""
        return self.positions.position_mm

    @property
    def std_mm(self) -> FloatArray:
        """Standard uncertainties of x, y, z, mm, shape (n, 3)."""
        return self.positions.std_mm

    @cached_property
    def covariance_mm2(self) -> FloatArray:
        """Covariance of x, y, z of each point, mm squared, shape (n, 3, 3)."""
        return self.positions.covariance_mm2

    @property
    def low95_mm(self) -> FloatArray:
        """Lower ends of the 95 % intervals of z, mm, shape (n,)."""
        return self.positions.low95_mm

    @property
    def high95_mm(self) -> FloatArray:
        """Upper ends, mm, shape (n,); infinite where a reading does not limit the distance."""
        return self.positions.high95_mm

    @cached_property
    def valid(self) -> BoolArray:
        """Which could be measured, shape (n,)."""
        valid: BoolArray = np.isfinite(self.xyz_mm[:, 2])
        return valid

    @cached_property
    def extrapolated(self) -> BoolArray:
        """Which lie outside the depths that the calibration covers, shape (n,)."""
        low, high = self.calibrated_mm
        z = self.xyz_mm[:, 2]
        outside: BoolArray = np.logical_and(self.valid, (z < low) | (z > high))
        return outside

    @cached_property
    def status(self) -> tuple[str, ...]:
        """Of each: "ok", "extrapolated", or why it could not be measured."""
        words = ["extrapolated" if beyond else "ok" for beyond in self.extrapolated.tolist()]
        for i, fault in self.positions.faults.items():
            words[i] = fault
        return tuple(words)

    def length(self, start: int, end: int) -> tuple[float, float]:
        """Return the distance of two points and its standard uncertainty, mm.

        Errors that both points share cancel, as they do in the rig. NaN if one was not measured.

        Parameters
        ----------
        start, end
            Places of the points; negative ones count from the end.

        Raises
        ------
        IndexError
            If there is no such point.
        """
        places = range(len(self))
        try:
            return self.positions.length(places[start], places[end])
        except IndexError:
            raise IndexError(f"length: no points {start} and {end} among {len(self)}") from None


def _columns(**given: Any) -> dict[str, FloatArray]:
    """Return the columns that are given, shape (n,) each.

    Raises
    ------
    UsageError
        If their shapes differ, or coordinates are missing or given twice.
    """
    names = {name for name, value in given.items() if value is not None}
    if names & {"x1c", "y1c", "u1_px", "v1_px"} not in ({"x1c", "y1c"}, {"u1_px", "v1_px"}):
        raise UsageError("measure: give x1c and y1c, or u1_px and v1_px")
    try:
        arrays = {name: np.asarray(given[name], dtype=np.float64) for name in sorted(names)}
    except (TypeError, ValueError) as error:
        raise UsageError(f"measure: not all readings are numbers ({error})") from None
    try:
        shape = np.broadcast_shapes(*(a.shape for a in arrays.values()), (1,))
    except ValueError:
        shape = ()
    if len(shape) != 1:
        found = ", ".join(f"{name} {a.shape}" for name, a in arrays.items())
        raise UsageError(f"measure: readings must be of one length, shape (n,); got {found}")
    return {name: np.broadcast_to(a, shape) for name, a in arrays.items()}


def reading_table(
    columns: dict[str, FloatArray], depth_of: Sequence[int] | None = None
) -> GazeTable:
    """Return readings as a table; the columns are those of `Rig.measure`, shape (n,) each."""
    degrees = columns["alpha2_deg"]
    n = len(degrees)
    nothing, unnamed = np.full(n, np.nan), (None,) * n
    # Outside of (0, 180) there is no reading; NaN is one that could not be taken.
    reading = np.where((degrees > 0) & (degrees < 180), np.deg2rad(degrees), np.nan)
    ids = tuple(map(str, range(n)))
    return GazeTable(
        file="readings",
        line=tuple(range(n)),
        ids=ids,
        groups=ids,
        x1c=columns.get("x1c", nothing),
        y1c=columns.get("y1c", nothing),
        u1_px=columns.get("u1_px", nothing),
        v1_px=columns.get("v1_px", nothing),
        image_c1=unnamed,
        alpha2_rad=reading,
        u2_px=columns.get("u2_px", nothing),
        image_c2=unnamed,
        z_mm=nothing,
        u_z_mm=nothing,
        stereo=unnamed,
        references={},
        depth_row=unnamed if depth_of is None else _depth_rows(depth_of, ids),
    )


def _depth_rows(depth_of: Sequence[int], ids: tuple[str, ...]) -> tuple[str, ...]:
    if len(depth_of) != len(ids):
        raise UsageError(f"measure: depth_of has {len(depth_of)} places, there are {len(ids)}")
    try:
        places = [index(i) for i in depth_of]
    except TypeError:
        places = [-1]
    if any(not 0 <= i < len(ids) for i in places):
        raise UsageError(f"measure: depth_of: places go from 0 to {len(ids) - 1}")
    return tuple(ids[i] for i in places)


def _without(column: FloatArray, refused: Mapping[int, str]) -> FloatArray:
    """Return a column, shape (n,), with NaN in the places that are refused."""
    column = column.copy()
    column[list(refused)] = np.nan
    return column
