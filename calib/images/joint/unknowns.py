"""Where lenses and board stand among the shared unknowns of a solve of many pictures."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.geometry.camera import Camera, intrinsic_vector, with_intrinsics
from calib.images.bundle import deformed


class ImagesOfViews(Protocol):
    """Images of a board by view."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """What each was taken for."""

    @property
    def camera(self) -> IntArray:
        """0 for C1, 1 for C2, shape (i,)."""

    @property
    def view(self) -> IntArray:
        """Which view each shows, shape (i,)."""

    @property
    def pixels(self) -> FloatArray:
        """Corners found, px, shape (i, corners, 2)."""

    @property
    def views(self) -> int:
        """Number of views."""


class LensesAndBoard:
    """A problem whose shared unknowns begin with the intrinsics of the cameras that are free.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    cameras
        C1 and C2 to start from.
    free
        Whether the intrinsics of each are unknowns.
    """

    points: FloatArray
    cameras: tuple[Camera, Camera]
    free: tuple[bool, bool]

    @property
    @abstractmethod
    def pictured(self) -> ImagesOfViews:
        """The images."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of shared unknowns."""

    @property
    @abstractmethod
    def at_warp(self) -> IntArray:
        """Places of the board's warp, shape (2,)."""

    def at_lens(self, camera: int) -> IntArray:
        """Places of the intrinsics of a camera among the shared unknowns; none if it is given."""
        counts = [
            4 + len(c.distortion) if f else 0 for c, f in zip(self.cameras, self.free, strict=True)
        ]
        first = counts[0] if camera else 0
        return np.arange(first, first + counts[camera])

    @property
    def after_lenses(self) -> int:
        """Place of the first shared unknown that is none of a lens."""
        return len(self.at_lens(0)) + len(self.at_lens(1))

    @property
    def lenses(self) -> list[FloatArray]:
        """The intrinsics to start from, of the cameras that are free."""
        return [intrinsic_vector(c) for c, f in zip(self.cameras, self.free, strict=True) if f]

    def camera_at(self, x: FloatArray, camera: int) -> Camera:
        """Return a camera with the intrinsics of shared unknowns."""
        if not self.free[camera]:
            return self.cameras[camera]
        return with_intrinsics(self.cameras[camera], x[self.at_lens(camera)])

    def board_at(self, x: FloatArray) -> FloatArray:
        """Return the board's corners, mm, shape (corners, 3)."""
        a, b = (float(v) for v in x[self.at_warp])
        return deformed(self.points, (a, b))
