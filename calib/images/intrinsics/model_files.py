"""Camera models as text: mrcal's ``.cameramodel`` and OpenCV's YAML."""

from __future__ import annotations

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, intrinsic_vector
from calib.images.mrcal.solves import LENS_MODELS

_DIGITS = 12


def cameramodel_text(camera: Camera, *, extrinsics: FloatArray | None = None) -> str:
    """Return mrcal's ``.cameramodel`` of a camera.

    Parameters
    ----------
    extrinsics
        From the reference frame to the camera's, Rodrigues vector and translation, shape (6,);
        None for a camera at the origin.

    Raises
    ------
    ValueError
        If mrcal has no such lens model (a fisheye; 14 coefficients, a tilted imager).
    """
    count = len(camera.distortion)
    if camera.projection != "perspective":
        raise ValueError(f"mrcal has no {camera.projection} lens model of OpenCV's coefficients")
    if count not in LENS_MODELS:
        raise ValueError(f"mrcal has no lens model with {count} of OpenCV's coefficients")
    numbers = ", ".join(f"{v:.{_DIGITS}g}" for v in intrinsic_vector(camera))
    at = np.zeros(6) if extrinsics is None else extrinsics
    pose = ", ".join(f"{v:.{_DIGITS}g}" for v in at)
    width, height = camera.image_size
    return (
        "{\n"
        f"    'lensmodel': '{LENS_MODELS[count]}',\n"
        "    # fx, fy, cx, cy, distortion\n"
        f"    'intrinsics': [ {numbers} ],\n"
        f"    'extrinsics': [ {pose} ],\n"
        f"    'imagersize': [ {width}, {height} ]\n"
        "}\n"
    )


def opencv_text(camera: Camera) -> str:
    """Return a camera as OpenCV's FileStorage writes it, in YAML, with its calibration's names."""
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    storage = cv2.FileStorage("camera.yml", flags)
    width, height = camera.image_size
    storage.write("image_width", width)
    storage.write("image_height", height)
    if camera.projection == "equidistant":
        # As OpenCV's calibration sample marks coefficients for cv2.fisheye.
        storage.write("fisheye_model", 1)
    storage.write("camera_matrix", camera.matrix)
    # OpenCV cannot store a matrix without elements; four zeros are the same lens.
    lens = camera.distortion if len(camera.distortion) else np.zeros(4)
    storage.write("distortion_coefficients", lens[:, None])
    return str(storage.releaseAndGetString())
