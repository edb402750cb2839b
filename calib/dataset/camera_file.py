"""Finished camera models in files: mrcal's ``.cameramodel``, YAML of OpenCV, ROS, Kalibr.

No text of such a file is ever evaluated: mrcal's is read as a Python literal, YAML as text.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.kalibr_yaml import looks_like_kalibr, read_kalibr
from calib.dataset.lens_slips import lens_fault
from calib.dataset.messages import shown
from calib.dataset.opencv_yaml import YamlCamera, looks_like_yaml, read_yaml_camera
from calib.geometry.camera import Camera
from calib.geometry.lens import coefficients_fault

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
        If it is in none of these formats, or its lens model is none of OpenCV's.
    """
    if looks_like_kalibr(text):
        return _camera(read_kalibr(text, name=name, camera=camera), name)
    if looks_like_yaml(text):
        return _camera(read_yaml_camera(text, name=name), name)
    if "lensmodel" not in text:
        _refuse(
            name,
            "is neither a mrcal .cameramodel nor OpenCV's YAML",
            "write it with mrcal or with cv2.FileStorage",
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
    return _camera(YamlCamera(matrix, values[4:], size), name)


def _literal(text: str, name: str) -> Mapping[str, Any]:
    """Return the dictionary literal in `text`, refusing what could exhaust Python's parser."""
    bare = _STRINGS.sub("", text.replace("b''", "")) if len(text) <= LITERAL_LIMIT else "oversized"
    depth = np.cumsum([(c in "[({") - (c in "])}") for c in bare]) if bare else np.zeros(1)
    if not _PLAIN.fullmatch(bare) or depth.max() > _NESTING or re.search(r"[+\-]\s*[+\-]", bare):
        _refuse(name, "is not a mrcal model", "write the file again with mrcal")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        model = ast.literal_eval(tree)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        model = tree = None
    if not isinstance(model, dict) or not isinstance(tree, ast.Dict):
        _refuse(name, "is not a mrcal model", "write the file again with mrcal")
    keys = [ast.literal_eval(key) for key in tree.keys if key is not None]
    for key in model:
        if keys.count(key) > 1:
            _refuse(name, f"has {shown(key)} twice", "keep one of them")
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


def _camera(found: YamlCamera, name: str) -> Camera:
    """Return a camera of checked numbers."""
    matrix, distortion, size, projection = found
    if matrix.shape != (3, 3) or not np.array_equal(
        matrix * [[0, 1, 0], [1, 0, 0], [1, 1, 1]], [[0, 0, 0], [0, 0, 0], [0, 0, 1]]
    ):
        _refuse(name, "its matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", "check the file")
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        _refuse(name, "its focal lengths are not positive", "check the file")
    if fault := coefficients_fault(projection, len(distortion)):
        _refuse(name, f"has {len(distortion)} distortion coefficients", fault)
    if len(size) != 2 or not 1 <= min(size) <= max(size) <= LONGEST_SIDE_PX or np.any(size % 1):
        _refuse(name, "its image size is not two whole numbers", "check the file")
    camera = Camera(matrix, distortion, (int(size[0]), int(size[1])), projection)
    if wrong := lens_fault(matrix, distortion.tolist(), camera.image_size, projection):
        _refuse(name, *wrong)
    return camera
