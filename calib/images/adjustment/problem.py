"""The adjustment as a problem: pictures, what is known beforehand, the order of the unknowns.

Shared unknowns, in this order: intrinsics of C1 and of C2, each where it is not given; the warp of
the board along x and along y; the free ones of the rig (`mounting.RIG`); the errors of readings at
which several pictures were taken, in standard deviations. Own unknowns of a view: the pose of the
board, in C1, or in C2 where C2 sees it alone at no reading. The error of a reading at which one
picture was taken is eliminated in that picture; what is known beforehand is a view of its own, the
last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.camera import Camera
from calib.images.adjustment.mounting import RIG
from calib.images.joint.reduced import Unknowns
from calib.images.joint.unknowns import LensesAndBoard

POSE = 6
WARP = 2


@dataclass(frozen=True)
class BoardPictures:
    """Pictures of one board, i of them, by view of the board, v of them.

    Parameters
    ----------
    names
        Of the pictures.
    kinds
        What each was taken for: "lens", "pair", "row" or "sweep".
    camera
        0 for C1, 1 for C2, shape (i,).
    view
        Which view each shows, shape (i,).
    exposure
        At which of the e readings C2 took it, shape (i,); -1 for C1, and for pictures of C2 at a
        reading that does not matter.
    pixels
        Corners found, px, shape (i, corners, 2); NaN where not.
    readings_rad
        Of the encoder, shape (e,).
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    camera: IntArray
    view: IntArray
    exposure: IntArray
    pixels: FloatArray
    readings_rad: FloatArray

    @property
    def views(self) -> int:
        """Number of views, v."""
        return int(self.view.max()) + 1

    @property
    def shared(self) -> IntArray:
        """Readings at which several pictures were taken."""
        taken = np.bincount(self.exposure[self.exposure >= 0], minlength=len(self.readings_rad))
        return np.flatnonzero(taken > 1)

    @property
    def own(self) -> BoolArray:
        """Which pictures were taken at a reading of their own, shape (i,)."""
        return (self.exposure >= 0) & ~np.isin(self.exposure, self.shared)


@dataclass(frozen=True)
class AdjustmentProblem(LensesAndBoard):
    """The problem.

    Parameters
    ----------
    pictures
        What was observed.
    points
        Corners in the board's frame, mm, shape (corners, 3).
    cameras
        C1 and C2 to start from.
    free
        Whether the intrinsics of each are unknowns.
    lens_information
        What is known of the intrinsics of each beforehand, about those of `cameras`: inverse of
        their covariance; zeros where they are free and nothing is.
    names
        Free unknowns of the rig, in the order of `RIG`; the others are 0.
    prior
        Mean and standard deviation of each; an infinite one for none.
    reading_std_rad
        Standard deviation of the error of a reading, rad.
    """

    pictures: BoardPictures
    points: FloatArray
    cameras: tuple[Camera, Camera]
    free: tuple[bool, bool]
    names: tuple[str, ...]
    prior: tuple[tuple[float, float], ...]
    reading_std_rad: float
    lens_information: tuple[FloatArray, FloatArray]

    @property
    def pictured(self) -> BoardPictures:
        """The pictures."""
        return self.pictures

    @property
    def at_warp(self) -> IntArray:
        """Places of the board's warp, shape (2,)."""
        first = self.after_lenses
        return np.arange(first, first + WARP)

    @property
    def at_rig(self) -> IntArray:
        """Places of the free unknowns of the rig."""
        first = int(self.at_warp[-1]) + 1
        return np.arange(first, first + len(self.names))

    @property
    def at_held(self) -> IntArray:
        """Places of the errors of shared readings."""
        first = int(self.at_warp[-1]) + 1 + len(self.names)
        return np.arange(first, first + len(self.pictures.shared))

    @property
    def size(self) -> int:
        """Number of shared unknowns."""
        return int(self.at_warp[-1]) + 1 + len(self.names) + len(self.pictures.shared)

    def start(self, rig: FloatArray, warp: FloatArray, poses: FloatArray) -> Unknowns:
        """Return the unknowns of the cameras given, a rig, a board and these poses, (v, 6)."""
        own = [RIG.index(name) for name in self.names]
        held = np.zeros(len(self.pictures.shared))
        return Unknowns(
            np.concatenate([*self.lenses, warp, rig[own], held]), np.vstack([poses, np.zeros(POSE)])
        )

    def rig_at(self, x: FloatArray) -> FloatArray:
        """Return all unknowns of the rig, shape (13,)."""
        rig = np.zeros(len(RIG))
        rig[[RIG.index(name) for name in self.names]] = x[self.at_rig]
        return rig

    def held_at(self, x: FloatArray) -> FloatArray:
        """Return the errors of readings, rad, shape (e,); 0 for those of one picture."""
        errors = np.zeros(len(self.pictures.readings_rad))
        errors[self.pictures.shared] = self.reading_std_rad * x[self.at_held]
        return errors
