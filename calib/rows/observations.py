"""Rows as the fits see them: gazes with reference depths and all their uncertainties."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.plane import Gaze

GROUP_SOURCE = "reference depth of a pose"
"""Source of what rows that share the error of one reference depth add to independent ones."""


def _no_shared() -> FloatArray:
    return np.zeros((0, 0, 0))


def depth_groups(names: Sequence[Hashable], u_mm: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return `z_group` and `u_z_group_mm` of rows; both empty where no two share an error.

    Parameters
    ----------
    names
        Of the reference measurement of each row, length n.
    u_mm
        Standard uncertainty of that measurement, shape (n,); NaN counts as none.
    """
    u = np.nan_to_num(u_mm)
    if u.any():
        number: dict[Hashable, int] = {}
        label = np.array([number.setdefault(name, len(number)) for name in names])
        u[np.bincount(label)[label] < 2] = 0.0
        if u.any():
            return label, u
    return np.zeros(0, dtype=np.int64), np.zeros(0)


@dataclass(frozen=True)
class Observations:
    """Calibration or validation rows in frame C1.

    The error of row i, quantity q (columns of `calib.geometry.plane.OBSERVABLE`) is modelled as
    ``std[i, q] * own + shared[i, q] @ common`` with independent standard-normal ``own`` (one a
    row and quantity) and ``common`` (one vector for all rows: what C1's intrinsics and the stereo
    extrinsics, estimated once, have wrong). Rows of one `z_group` have part of their own errors of
    z in common.

    Parameters
    ----------
    ids, groups
        Name of each row and of the pose or day it shares with others.
    x1c, y1c
        Normalised, undistorted coordinates in C1, shape (n,). y1c is 0 where `has_height` is
        false: the table did not say it.
    alpha2_rad, gaze_residual_rad
        Encoder reading, and angle from C2's centre column to the target, rad, shape (n,).
    z_mm
        Reference depth, mm, shape (n,).
    std
        Standard uncertainties of each row's errors without the shared ones, shape (n, 5).
    shared
        Loadings of the shared errors, shape (n, 5, k); shape (0, 0, 0) if there are none.
    shared_names
        One name a shared error, length k.
    has_height
        Whether y1c is known for every row.
    z_group
        Rows of one number have their reference depth from one measurement, shape (n,); shape (0,)
        if no two of them have.
    alone, alone_names
        Loadings, shape (n, 5, c), and names of further shared errors that these rows have and
        readings have not: those of corrections. Shape (0, 0, 0) if there are none.
    u_z_group_mm
        What is uncertain of it, and so one error of all these rows, mm, shape (n,). It is part of
        `std`, which says of each row by itself how far its depth may be off.
    """

    ids: tuple[str, ...]
    groups: tuple[str, ...]
    x1c: FloatArray
    y1c: FloatArray
    alpha2_rad: FloatArray
    gaze_residual_rad: FloatArray
    z_mm: FloatArray
    std: FloatArray
    has_height: bool = True
    shared: FloatArray = field(default_factory=_no_shared)
    shared_names: tuple[str, ...] = ()
    z_group: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    u_z_group_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    alone: FloatArray = field(default_factory=_no_shared)
    alone_names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def has_groups(self) -> bool:
        """Whether some rows share the error of one reference measurement."""
        return len(self.z_group) > 0

    @property
    def off_centre(self) -> bool:
        """Whether C2's images show targets beside its centre column."""
        return bool(np.any(self.gaze_residual_rad))

    @property
    def gaze(self) -> Gaze:
        """The rows without their depths."""
        return Gaze(self.x1c, self.y1c, self.alpha2_rad, self.gaze_residual_rad)

    def take(self, rows: BoolArray | IntArray) -> Observations:
        """Return the chosen rows."""
        index = np.arange(len(self))[rows]
        places = index.tolist()
        return Observations(
            ids=tuple(map(self.ids.__getitem__, places)),
            groups=tuple(map(self.groups.__getitem__, places)),
            x1c=self.x1c[index],
            y1c=self.y1c[index],
            alpha2_rad=self.alpha2_rad[index],
            gaze_residual_rad=self.gaze_residual_rad[index],
            z_mm=self.z_mm[index],
            std=self.std[index],
            has_height=self.has_height,
            shared=self.shared[index] if self.shared_names else self.shared,
            shared_names=self.shared_names,
            z_group=self.z_group[index] if self.has_groups else self.z_group,
            u_z_group_mm=self.u_z_group_mm[index] if self.has_groups else self.u_z_group_mm,
            alone=self.alone[index] if self.alone_names else self.alone,
            alone_names=self.alone_names,
        )
