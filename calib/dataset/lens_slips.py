"""Intrinsics that no lens has: slips of hand in a camera matrix or its distortion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.lens import ProjectionName

SMALLEST_FOCAL_PX = 20.0
"""A focal length below it is in millimetres, or the image is a stamp."""

OFF_CENTRE_SHARE = 0.1
"""Part of the image's side by which a principal point is off where cx and cy may be exchanged."""

EXCHANGED_SHARE = 0.04
"""Part of the image's side by which it is off at most once they are exchanged back."""

LARGEST_TANGENTIAL = 0.05
"""Of p1 and p2: lens elements millimetres off their axis reach a fifth of it."""

DOUBTED_TANGENTIAL = 0.01

_MATLAB = (
    "OpenCV's order is k1, k2, p1, p2, k3; MATLAB's RadialDistortion is k1, k2, k3, its "
    "TangentialDistortion p1, p2"
)


def lens_fault(
    matrix: FloatArray,
    distortion: Sequence[float],
    size: tuple[int, int] | None,
    projection: ProjectionName | None = None,
) -> tuple[str, str] | None:
    """Return what cannot be meant and its remedy; None if nothing is wrong.

    Parameters
    ----------
    matrix
        Camera matrix, px, shape (3, 3).
    distortion
        In OpenCV's order.
    size
        Width and height of the image, px; None where it is not known.
    projection
        Of the lens model; None for perspective.
    """
    focal = matrix[[0, 1], [0, 1]]
    if focal.min() < SMALLEST_FOCAL_PX:
        what = f"fx = {focal[0]:g}, fy = {focal[1]:g} look like millimetres"
        return what, "give it in pixels: millimetres divided by the pixel pitch"
    if size is not None and _exchanged(matrix[:2, 2], np.array(size)):
        cx, cy = matrix[:2, 2]
        what = f"cx = {cx:g} and cy = {cy:g} look exchanged in an image of {size[0]} x {size[1]}"
        return what, f"write cx = {cy:g}, cy = {cx:g}, or correct the image size"
    if projection not in (None, "perspective"):
        return None
    tangential = np.abs(np.asarray(distortion[2:4], dtype=np.float64))
    if tangential.size and tangential.max() > LARGEST_TANGENTIAL:
        values = f"p1 = {distortion[2]:g}, p2 = {distortion[3]:g}"
        return f"{values} are no tangential distortion of a lens: another order?", _MATLAB
    return None


def lens_doubts(distortion: FloatArray) -> Iterator[str]:
    """Yield what is no fault of a lens but may be a slip."""
    if len(distortion) < 5:
        return
    p1, p2, k3 = distortion[2:5]
    small = abs(p2) < DOUBTED_TANGENTIAL and 0 < abs(k3) < DOUBTED_TANGENTIAL
    if max(abs(p1), abs(p2)) > DOUBTED_TANGENTIAL or (p1 == 0 and p2 != 0 and small):
        yield f"p1 = {p1:g}, p2 = {p2:g}, k3 = {k3:g} are unusual: {_MATLAB}"


def _exchanged(centre: FloatArray, size: FloatArray) -> bool:
    middle = (size - 1) / 2
    off = np.abs(centre - middle) / size
    back = np.abs(centre[::-1] - middle) / size
    return bool(off.max() > OFF_CENTRE_SHARE and back.max() < EXCHANGED_SHARE)
