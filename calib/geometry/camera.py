"""The pinhole camera with OpenCV's lens model: pixels to rays and back, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

from calib.arrays import FloatArray


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera.

    Parameters
    ----------
    matrix
        [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], px, shape (3, 3); the origin of pixel coordinates is
        the centre of the top-left pixel.
    distortion
        OpenCV order k1, k2, p1, p2, k3, ...; shape (k,) with k one of 0, 4, 5, 8, 12, 14.
    image_size
        Width and height, px.
    """

    matrix: FloatArray
    distortion: FloatArray
    image_size: tuple[int, int]
