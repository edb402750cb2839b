"""The tables of a dataset, as columns: gaze and validation rows, sweep, lengths.

Arrays have shape (n,), rows in the order of the file, NaN where a row has no value, and cannot be
written to. `calib.dataset.readers` makes these tables from text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import FloatArray


def _unsaid() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True)
class GazeTable:
    """Gazes at targets: calibration, validation or measurement rows.

    Of each row exactly one source of the C1 coordinate, of the encoder reading and (but for
    measurements) of the reference is filled.

    Parameters
    ----------
    file
        Name for messages.
    line
        Line of each row in the file.
    ids
        Unique names.
    groups
        Rows that cross-validation keeps together; the id where none is given.
    x1c, y1c
        Normalised, undistorted coordinates in C1; y1c all NaN where the table does not say it.
    u1_px, v1_px
        Raw pixels in C1.
    image_c1
        Image of the board by C1, relative to the dataset.
    alpha2_rad
        Encoder readings, in (0, pi).
    u2_px
        The target's column in C2 at the reading.
    image_c2
        Image of the board by C2 at the reading.
    z_mm, u_z_mm
        Reference depth and its standard uncertainty; the latter NaN where the row gives none.
    stereo
        Stem of the image pair that gives the reference instead.
    references
        Further references, mm, by their name in ``z_<name>_mm``.
    depth_row
        Id of the row whose measured depth this row uses.
    time_s
        When the row was taken, s from any origin; shape (0,) where the table does not say it.
    approach
        -1 or 1, the side from which the axis came to rest; shape (0,) where the table does not say
        it.
    """

    file: str
    line: tuple[int, ...]
    ids: tuple[str, ...]
    groups: tuple[str, ...]
    x1c: FloatArray
    y1c: FloatArray
    u1_px: FloatArray
    v1_px: FloatArray
    image_c1: tuple[str | None, ...]
    alpha2_rad: FloatArray
    u2_px: FloatArray
    image_c2: tuple[str | None, ...]
    z_mm: FloatArray
    u_z_mm: FloatArray
    stereo: tuple[str | None, ...]
    references: Mapping[str, FloatArray]
    depth_row: tuple[str | None, ...]
    time_s: FloatArray = field(default_factory=_unsaid)
    approach: FloatArray = field(default_factory=_unsaid)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class SweepTable:
    """Images of C2 turned through known angles before a board at rest.

    Parameters
    ----------
    file, line, ids
        As in `GazeTable`.
    placements
        Rows with the same name saw the board at the same place.
    image_c2
        Image of the board, relative to the dataset.
    alpha2_rad
        Encoder readings, in (0, pi), shape (n,).
    """

    file: str
    line: tuple[int, ...]
    ids: tuple[str, ...]
    placements: tuple[str, ...]
    image_c2: tuple[str, ...]
    alpha2_rad: FloatArray

    def __len__(self) -> int:
        return len(self.ids)

    def only(self, rows: Sequence[int]) -> SweepTable:
        """Return these rows alone."""
        return SweepTable(
            file=self.file,
            line=tuple(self.line[i] for i in rows),
            ids=tuple(self.ids[i] for i in rows),
            placements=tuple(self.placements[i] for i in rows),
            image_c2=tuple(self.image_c2[i] for i in rows),
            alpha2_rad=self.alpha2_rad[list(rows)],
        )


@dataclass(frozen=True)
class LengthTable:
    """Distances between two measured points.

    Parameters
    ----------
    file, line, ids
        As in `GazeTable`.
    start, end
        Ids of the two rows.
    length_mm, u_length_mm
        Known distance and its standard uncertainty, shape (n,); NaN where it is yet to be measured.
    """

    file: str
    line: tuple[int, ...]
    ids: tuple[str, ...]
    start: tuple[str, ...]
    end: tuple[str, ...]
    length_mm: FloatArray
    u_length_mm: FloatArray

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class ReturnTable:
    """Returns to the target of the first row, in their order.

    Parameters
    ----------
    file, line, ids
        As in `GazeTable`.
    of, after
        Ids of the row whose target was returned to, and of the last row before the return.
    change_rad
        By how much the reading that gazes at the target has grown since, (n,).
    u_change_rad, u_first_rad
        Standard uncertainties of the return's own reading and of that row's, (n,).
    """

    file: str
    line: tuple[int, ...]
    ids: tuple[str, ...]
    of: tuple[str, ...]
    after: tuple[str, ...]
    change_rad: FloatArray
    u_change_rad: FloatArray
    u_first_rad: FloatArray

    def __len__(self) -> int:
        return len(self.ids)

    def to(self, first: str) -> ReturnTable:
        """Return the returns to the target of one row alone."""
        rows = [i for i, name in enumerate(self.of) if name == first]
        return ReturnTable(
            file=self.file,
            line=tuple(self.line[i] for i in rows),
            ids=tuple(self.ids[i] for i in rows),
            of=tuple(self.of[i] for i in rows),
            after=tuple(self.after[i] for i in rows),
            change_rad=self.change_rad[rows],
            u_change_rad=self.u_change_rad[rows],
            u_first_rad=self.u_first_rad[rows],
        )


def freeze(table: GazeTable | SweepTable | LengthTable | ReturnTable) -> None:
    """Make the arrays of a table read-only."""
    arrays = [*vars(table).values(), *vars(table).get("references", {}).values()]
    for array in arrays:
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
