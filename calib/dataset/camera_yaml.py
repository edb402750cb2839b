"""Camera files of ROS (``camera_info``) and Kalibr (``camchain``): plain YAML.

Both name their lens model, and it is read as that model or refused: k1 to k4 of a fisheye model are
no k1, k2, p1, p2.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
import yaml

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.messages import shown

LIMIT = 64 * 1024
"""Characters; such a file has a few hundred."""

_NESTING = 8

_KEYS = re.compile(r"^(?:image_width|image_height|camera_matrix|distortion_model|cam\d+)\s*:", re.M)

ROS_MODELS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,)}
)
"""Lens models that are OpenCV's, with their numbers of coefficients."""

KALIBR_MODELS: Mapping[str, tuple[int, ...]] = MappingProxyType({"radtan": (4,), "none": (0,)})


def is_camera_yaml(text: str) -> bool:
    """Return whether a text looks like one of the two formats."""
    return not text.startswith("%YAML") and _KEYS.search(text[:LIMIT]) is not None


def read_camera_yaml(
    text: str, *, name: str, camera: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the matrix (3, 3), distortion (k,) and image size (2,) of a camera, unchecked.

    Parameters
    ----------
    text
        Of the whole file.
    name
        Of the file, for messages.
    camera
        "c1" or "c2": of a camchain with two cameras, cam0 is C1 and cam1 is C2.

    Raises
    ------
    InputError
        If it is none of the two formats, or its lens model is none of OpenCV's.
    """
    document = _document(text, name)
    if any(re.fullmatch(r"cam\d+", str(key)) for key in document):
        return _kalibr(_section(document, name, camera), name)
    return _ros(document, name)


def _refuse(name: str, what: str, remedy: str) -> NoReturn:
    raise InputError.single(where=name, what=what, remedy=remedy)


class _Loader(yaml.SafeLoader):
    """Reads plain YAML, and refuses what hides or multiplies: keys twice, anchors, deep nesting."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        self.nesting = getattr(self, "nesting", 0) + 1
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if self.nesting > _NESTING or getattr(event, "anchor", None) is not None:
            raise yaml.YAMLError("nested too deep, or with anchors")
        node = super().compose_node(parent, index)
        self.nesting -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for key in keys if keys.count(key) > 1), None)
        if twice is not None:
            raise yaml.YAMLError(f"key {twice!r} is there twice")
        return super().construct_mapping(node, deep=deep)


def _document(text: str, name: str) -> Mapping[str, Any]:
    remedy = "write it again with camera_calibration (ROS) or Kalibr"
    if len(text) > LIMIT:
        _refuse(name, "is too large for a camera", remedy)
    try:
        document = yaml.load(text, Loader=_Loader)  # noqa: S506 - a SafeLoader with limits
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        where = getattr(error, "problem_mark", None)
        line = "" if where is None else f" at line {where.line + 1}"
        what = (getattr(error, "problem", None) or str(error)).splitlines()[0]
        _refuse(name, f"is not plain YAML{line}: {what}", remedy)
    if not isinstance(document, dict):
        _refuse(name, "is not plain YAML", remedy)
    return document


def _section(document: Mapping[str, Any], name: str, camera: str) -> Mapping[str, Any]:
    cameras = sorted(key for key in document if re.fullmatch(r"cam\d+", str(key)))
    place = 1 if camera == "c2" and len(cameras) > 1 else 0
    section = document[cameras[place]]
    if len(cameras) > 2:
        _refuse(name, f"has {len(cameras)} cameras", "leave cam0 for C1 and cam1 for C2 in it")
    if not isinstance(section, dict):
        _refuse(name, f"'{cameras[place]}' is no section", "write it again with Kalibr")
    return section


def _ros(document: Mapping[str, Any], name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    model = document.get("distortion_model")
    lens = _data(document, name, "distortion_coefficients")
    if model not in ROS_MODELS:
        _unknown(name, "distortion_model", model, ROS_MODELS)
    _count(name, str(model), lens, ROS_MODELS[str(model)])
    matrix = _data(document, name, "camera_matrix")
    if matrix.shape != (9,):
        _refuse(name, "'camera_matrix' has not nine numbers", "check the file")
    size = _numbers([document.get(key) for key in ("image_width", "image_height")], name, "size")
    return matrix.reshape(3, 3), lens, size


def _kalibr(section: Mapping[str, Any], name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    if section.get("camera_model") != "pinhole":
        _unknown(name, "camera_model", section.get("camera_model"), {"pinhole": ()})
    model = section.get("distortion_model", "none")
    if model not in KALIBR_MODELS:
        _unknown(name, "distortion_model", model, KALIBR_MODELS)
    lens = _numbers(section.get("distortion_coeffs", []), name, "distortion_coeffs")
    if model == "none":
        lens = lens[:0]
    _count(name, str(model), lens, KALIBR_MODELS[str(model)])
    values = _numbers(section.get("intrinsics"), name, "intrinsics")
    if values.shape != (4,):
        _refuse(name, "'intrinsics' has not four numbers", "check the file")
    fx, fy, cx, cy = values
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return matrix, lens, _numbers(section.get("resolution"), name, "resolution")


def _unknown(name: str, key: str, value: object, known: Mapping[str, object]) -> NoReturn:
    _refuse(
        name,
        f"{key} {shown(value)} is not one of {', '.join(known)}",
        "calibrate with one of these, or give images of a board",
    )


def _count(name: str, model: str, lens: FloatArray, counts: tuple[int, ...]) -> None:
    if len(lens) not in counts:
        expected = " or ".join(map(str, counts))
        _refuse(name, f"{model} has {expected} coefficients, here are {len(lens)}", "check it")


def _data(document: Mapping[str, Any], name: str, key: str) -> FloatArray:
    section = document.get(key)
    if not isinstance(section, dict) or "data" not in section:
        _refuse(name, f"has no '{key}' with data", "write it again with camera_calibration")
    return _numbers(section["data"], name, key)


def _numbers(value: object, name: str, key: str) -> FloatArray:
    if isinstance(value, list) and all(type(v) in (int, float) for v in value):
        try:
            numbers = np.array(value, dtype=np.float64)
        except OverflowError:
            numbers = np.array([np.nan])
        if np.isfinite(numbers).all():
            return numbers
    _refuse(name, f"'{key}' is not a list of finite numbers", "check the file")
