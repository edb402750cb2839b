"""Calibration boards, their corners in pictures, and a lens solved from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera


@dataclass(frozen=True)
class Board:
    """A calibration board.

    Parameters
    ----------
    type
        "chessboard" or "charuco".
    columns, rows
        Inner corners across and down.
    square_mm
        Side of a square, mm.
    target
        Column and row of the corner that is gazed at.
    dictionary, marker_mm, legacy
        ChArUco only: name as in OpenCV (``DICT_4X4_50``), side of a marker, old pattern.
    """

    type: str
    columns: int
    rows: int
    square_mm: float
    target: tuple[int, int]
    dictionary: str | None = None
    marker_mm: float | None = None
    legacy: bool = False

    @property
    def corner_count(self) -> int:
        """Number of inner corners."""
        return self.columns * self.rows

    @property
    def target_index(self) -> int:
        """Place of the gazed corner in board order (row by row)."""
        return self.target[1] * self.columns + self.target[0]

    def object_points(self) -> FloatArray:
        """Return the corners in the board's frame, mm, shape (corners, 3), z = 0, row by row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
        return self.square_mm * flat.astype(np.float64)


@dataclass(frozen=True)
class Corners:
    """Board corners found in the images of one camera.

    Parameters
    ----------
    images
        Paths relative to the dataset, one a view.
    pixels
        Shape (views, corners, 2), px, board order; NaN where a corner was not found.
    detector
        What found each board: "cascade:classic", "cascade:sector", "charuco", "cache" or "none";
        with ":small-window" where marks inside squares disturb the usual window.
    image_size
        Width and height, px.
    remarks
        What the reader should know of how they were found.
    """

    images: tuple[str, ...]
    pixels: FloatArray
    detector: tuple[str, ...]
    image_size: tuple[int, int]
    remarks: tuple[str, ...] = ()

    def select(self, images: tuple[str, ...]) -> Corners:
        """Return the views of the images named, in that order."""
        place = {name: i for i, name in enumerate(self.images)}
        index = [place[name] for name in images]
        return Corners(
            images=images,
            pixels=self.pixels[index],
            detector=tuple(self.detector[i] for i in index),
            image_size=self.image_size,
            remarks=self.remarks,
        )


@dataclass(frozen=True)
class LensFit:
    """Intrinsics of one camera by one backend and one lens model.

    Parameters
    ----------
    backend
        "opencv", "mrcal", or "joint" of this program's own solves.
    lens_model
        Name in the backend's own words.
    camera
        The estimate, OpenCV's parameters.
    covariance
        Of fx, fy, cx, cy and the distortion, shape (4 + k, 4 + k), px and 1.
    rms_px
        Root mean square of the residual per coordinate (not per point) over inliers, px.
    residuals
        Observed minus projected, px, shape (views, corners, 2); NaN where missing or rejected.
    poses
        Board poses, rotation vector (rad) and translation (mm) camera from board, (views, 6).
    rejected
        Number of corners discarded as outliers.
    board_warp_mm
        Solved deformation of the board in x and y, mm, where the backend solves it; else None.
    """

    backend: Literal["mrcal", "opencv", "joint"]
    lens_model: str
    camera: Camera
    covariance: FloatArray
    rms_px: float
    residuals: FloatArray
    poses: FloatArray
    rejected: int
    board_warp_mm: tuple[float, float] | None = None
