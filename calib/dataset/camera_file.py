"""Finished camera models in files: mrcal's ``.cameramodel``, and YAML of OpenCV, ROS and Kalibr.

No text of such a file is ever evaluated: mrcal's is read as a Python literal, OpenCV's by OpenCV's
own parser.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.camera_yaml import is_camera_yaml, read_camera_yaml
from calib.dataset.manifest import DISTORTION_LENGTHS
from calib.dataset.messages import shown
from calib.geometry.camera import Camera

MODEL_LIMIT_BYTES = 64 * 1024 * 1024
"""mrcal keeps all that went into the solve in its file: some MB after a thousand images."""

LITERAL_LIMIT = 64 * 1024
"""Characters of a mrcal model without that part; ten times the largest without splines."""

MRCAL_MODELS: Final = {
    "LENSMODEL_PINHOLE": 0,
    "LENSMODEL_OPENCV4": 4,
    "LENSMODEL_OPENCV5": 5,
    "LENSMODEL_OPENCV8": 8,
    "LENSMODEL_OPENCV12": 12,
}
"""Lens models that equal OpenCV's, with their number of distortion coefficients."""

LONGEST_SIDE_PX = 100_000
"""No imager is larger; some file's number may be, or infinite."""

# The packed inputs of the solve: base 85, so free of quotation marks.
_OPTIMIZATION_INPUTS = re.compile(r"b'[^']*'|b\"[^\"]*\"")
# Without strings and comments, a model holds nothing but numbers and brackets, nested twice.
_STRINGS = re.compile(r"'[^'\n]*'|\"[^\"\n]*\"|#[^\n]*")
_PLAIN = re.compile(r"[\s\[\](){}:,.0-9eE+\-]*")
_NESTING = 4

_DISTORTION_NAMES = ("distortion_coefficients", "dist_coeffs")


def read_camera(text: str, *, name: str, camera: str = "c1") -> Camera:
    """Return the camera of a model file.

    Parameters
    ----------
    text
        Of the whole file.
    name
        Of the file, for messages.
    camera
        "c1" or "c2": which camera of a Kalibr camchain with two.

    Raises
    ------
    InputError
        If it is none of the formats, or its lens model is none of OpenCV's.
    """
    if is_camera_yaml(text):
        return _camera(*read_camera_yaml(text, name=name, camera=camera), name)
    if text.startswith("%YAML"):
        return _opencv(text, name)
    if "lensmodel" not in text:
        _refuse(
            name,
            "is neither a mrcal .cameramodel nor YAML of OpenCV, ROS or Kalibr",
            "write it with one of these",
        )
    return _mrcal(text, name)


def _refuse(name: str, what: str, remedy: str) -> NoReturn:
    raise InputError.single(where=name, what=what, remedy=remedy)


def _mrcal(text: str, name: str) -> Camera:
    """Return the camera of a mrcal model, a Python dictionary with comments."""
    model = _literal(_OPTIMIZATION_INPUTS.sub("b''", text), name)
    lens = model.get("lensmodel")
    if not isinstance(lens, str) or lens not in MRCAL_MODELS:
        _refuse(
            name,
            f"lens model {shown(lens)} is not one of {', '.join(MRCAL_MODELS)}",
            "convert it: mrcal-convert-lensmodel LENSMODEL_OPENCV8",
        )
    values = _vector(model.get("intrinsics"), name, "intrinsics")
    expected = 4 + MRCAL_MODELS[lens]
    if len(values) != expected:
        _refuse(
            name,
            f"intrinsics has {len(values)} values, {lens} has {expected}",
            "write the file again with mrcal",
        )
    fx, fy, cx, cy = values[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    size = _vector(model.get("imagersize"), name, "imagersize")
    return _camera(matrix, values[4:], size, name)


def _literal(text: str, name: str) -> Mapping[str, Any]:
    """Return the dictionary literal in `text`, refusing what could exhaust Python's parser."""
    bare = _STRINGS.sub("", text.replace("b''", "")) if len(text) <= LITERAL_LIMIT else "oversized"
    depth = np.cumsum([(c in "[({") - (c in "])}") for c in bare]) if bare else np.zeros(1)
    if not _PLAIN.fullmatch(bare) or depth.max() > _NESTING or re.search(r"[+\-]\s*[+\-]", bare):
        _refuse(name, "is not a mrcal model", "write the file again with mrcal")
    try:
        model = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        model = None
    if not isinstance(model, dict):
        _refuse(name, "is not a mrcal model", "write the file again with mrcal")
    return model


def _vector(value: object, name: str, key: str) -> FloatArray:
    """Return a list of finite numbers as an array."""
    if isinstance(value, Sequence) and all(type(v) in (int, float) for v in value):
        try:
            vector = np.array(value, dtype=np.float64)
        except (OverflowError, ValueError):
            vector = np.array([np.nan])
        if np.all(np.isfinite(vector)):
            return vector
    _refuse(name, f"'{key}' is not a list of finite numbers", "write the file again")


def _opencv(text: str, name: str) -> Camera:
    """Return the camera of a YAML file written by cv2.FileStorage."""
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        keys = storage.root().keys()
    except (cv2.error, SystemError):
        _refuse(name, "is not OpenCV's YAML", "write the file again with cv2.FileStorage")
    if "fisheye_model" in keys and storage.getNode("fisheye_model").real() != 0:
        _refuse(
            name,
            "is a fisheye model",
            "calibrate with the pinhole model and rational distortion, or give images",
        )
    lens = next((key for key in _DISTORTION_NAMES if key in keys), _DISTORTION_NAMES[0])
    for key in ("camera_matrix", lens, "image_width", "image_height"):
        if key not in keys:
            _refuse(name, f"has no '{key}'", "write the file as OpenCV's calibration sample does")
    size = np.array([storage.getNode(key).real() for key in ("image_width", "image_height")])
    matrix = _opencv_matrix(storage.getNode("camera_matrix"), name, "camera_matrix")
    distortion = _opencv_matrix(storage.getNode(lens), name, lens)
    return _camera(matrix, distortion.ravel(), size, name)


def _opencv_matrix(node: Any, name: str, key: str) -> FloatArray:
    """Return a matrix node; its size is looked at before OpenCV allocates it."""
    import cv2

    try:
        matrix = node.mat() if 0 < _opencv_size(node) <= max(DISTORTION_LENGTHS) else None
    except (cv2.error, SystemError):
        matrix = None
    if matrix is None or not np.all(np.isfinite(matrix)):
        _refuse(name, f"'{key}' is not a matrix of finite numbers", "write the file again")
    return np.asarray(matrix, dtype=np.float64)


def _opencv_size(node: Any) -> float:
    """Return the number of elements that a matrix node announces; OpenCV 5 knows flat arrays."""
    sizes = node.getNode("sizes")
    if sizes.empty():
        sides: list[float] = [node.getNode("rows").real(), node.getNode("cols").real()]
    else:
        sides = [sizes.at(i).real() for i in range(min(sizes.size(), 3))]
    return float(math.prod(sides))


def _camera(matrix: FloatArray, distortion: FloatArray, size: FloatArray, name: str) -> Camera:
    """Return a camera of checked numbers."""
    if matrix.shape != (3, 3) or not np.array_equal(
        matrix * [[0, 1, 0], [1, 0, 0], [1, 1, 1]], [[0, 0, 0], [0, 0, 0], [0, 0, 1]]
    ):
        _refuse(name, "its matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", "check the file")
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        _refuse(name, "its focal lengths are not positive", "check the file")
    if len(distortion) not in DISTORTION_LENGTHS:
        _refuse(
            name,
            f"has {len(distortion)} distortion coefficients",
            f"OpenCV's models have {', '.join(map(str, DISTORTION_LENGTHS))}",
        )
    if len(size) != 2 or not 1 <= min(size) <= max(size) <= LONGEST_SIDE_PX or np.any(size % 1):
        _refuse(name, "its image size is not two whole numbers", "check the file")
    return Camera(matrix, distortion, (int(size[0]), int(size[1])))
