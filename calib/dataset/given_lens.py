"""What is uncertain of a lens that the dataset brings finished."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.contents import Dataset

DEFAULT_U_FOCAL = 1e-3
"""Relative standard uncertainty of a given focal length of which none is stated. Twenty pictures of
a board held by hand leave 0.05 to 0.2 % (OpenCV's sample pictures 0.2 %), ten kelvins about 0.02 %;
nobody's lens is exact."""

DEFAULT_U_CENTRE = 1e-3
"""The same of a principal point, in parts of the focal length: the two come of one set of pictures
and about as well."""


def given_lens_covariance(dataset: Dataset, name: str) -> FloatArray:
    """Return the covariance of a given camera's fx, fy, cx, cy, distortion, shape (4 + k, 4 + k).

    As `u_focal` and `u_centre_px` of the manifest say, or by default; both focal lengths err by one
    factor. Zero where no pixel of the camera is used: coordinates that a table gives as x1c bring
    their uncertainty with them.

    Parameters
    ----------
    name
        "c1" or "c2"; a camera that the dataset brings.
    """
    camera = dataset.cameras[name]
    size = 4 + len(camera.distortion)
    covariance = np.zeros((size, size))
    if not uses_pixels(dataset, name):
        return covariance
    u_focal, u_centre = _stated(dataset, name)
    focal = np.diag(camera.matrix)[:2]
    covariance[:2, :2] = u_focal**2 * np.outer(focal, focal)
    covariance[[2, 3], [2, 3]] = u_centre**2
    return covariance


def assumed_of_lens(dataset: Dataset, name: str) -> str | None:
    """Return in words what is assumed of a given lens; None where nothing is."""
    section = dataset.manifest.camera(name)
    if section is None or not uses_pixels(dataset, name):
        return None
    keys = [k for k in ("u_focal", "u_centre_px") if getattr(section, k) is None]
    if not keys:
        return None
    u_focal, u_centre = _stated(dataset, name)
    return (
        f"[cameras.{name}]: the lens is given, and {' and '.join(keys)} not; assumed are "
        f"{100 * u_focal:.2g} % of the focal length and {u_centre:.2g} px of the principal point: "
        "state what its calibration says, or give its pictures"
    )


def uses_pixels(dataset: Dataset, name: str) -> bool:
    """Return whether a camera's pixels enter: by images, or by columns of a table."""
    number = name[-1]
    if dataset.stereo_pairs or (name == "c2" and dataset.sweep is not None):
        return True
    return any(
        bool(np.isfinite(getattr(table, f"u{number}_px")).any())
        or any(image is not None for image in getattr(table, f"image_{name}"))
        for table in dataset.rows
    )


def _stated(dataset: Dataset, name: str) -> tuple[float, float]:
    """Return the relative uncertainty of the focal length, and that of the centre, px."""
    section = dataset.manifest.camera(name)
    focal = float(dataset.cameras[name].matrix[0, 0])
    u_focal = None if section is None else section.u_focal
    u_centre = None if section is None else section.u_centre_px
    return (
        DEFAULT_U_FOCAL if u_focal is None else u_focal,
        DEFAULT_U_CENTRE * focal if u_centre is None else u_centre,
    )
