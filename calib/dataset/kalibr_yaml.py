"""Cameras in Kalibr's ``camchain``: plain YAML with one section a camera.

It names the lens model, and is read as that model or refused: the four coefficients of an
equidistant lens are no k1, k2, p1, p2.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
import yaml

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.messages import shown
from calib.dataset.opencv_yaml import YamlCamera, by_key, number, root_of
from calib.geometry.lens import ProjectionName

_SECTION = re.compile(r"^cam\d+\s*:", re.M)

MODELS: Mapping[str, tuple[ProjectionName, int]] = MappingProxyType(
    {"radtan": ("perspective", 4), "equidistant": ("equidistant", 4), "none": ("perspective", 0)}
)
"""Distortion models that are OpenCV's, with their number of coefficients."""


def looks_like_kalibr(text: str) -> bool:
    """Return whether a camera file is meant to be a camchain."""
    return not text.startswith("%YAML:") and _SECTION.search(text) is not None


def read_kalibr(text: str, *, name: str, camera: str) -> YamlCamera:
    """Return what a camchain says of a camera.

    Parameters
    ----------
    text
        Of the whole file.
    name
        Of the file, for messages.
    camera
        "c1" or "c2": where there are two cameras, cam0 is C1 and cam1 is C2.

    Raises
    ------
    InputError
        If it is no such file, or names a lens model that is none of OpenCV's.
    """
    root = root_of(text, name)
    cameras = sorted(key for key in root if re.fullmatch(r"cam\d+", key))
    if len(cameras) > 2:
        _refuse(name, f"has {len(cameras)} cameras", "leave cam0 for C1 and cam1 for C2 in it")
    chosen = cameras[-1 if camera == "c2" else 0]
    node = root[chosen]
    if not isinstance(node, yaml.MappingNode):
        _refuse(name, f"'{chosen}' is no section", "write it again with Kalibr")
    section = by_key(node, name)
    _known(name, "camera_model", _text(section.get("camera_model")), ("pinhole",))
    if "distortion_model" not in section:
        _refuse(name, f"'{chosen}' has no 'distortion_model'", "write it again with Kalibr")
    model = _text(section["distortion_model"])
    _known(name, "distortion_model", model, MODELS)
    projection, count = MODELS[model]
    lens = _numbers(section, "distortion_coeffs", name) if count else np.zeros(0)
    if len(lens) != count:
        what = f"{model} has {count} coefficients, here are {len(lens)}"
        _refuse(name, what, "check which model they are of")
    values = _numbers(section, "intrinsics", name)
    if len(values) != 4:
        _refuse(name, "'intrinsics' has not four numbers", "write it again with Kalibr")
    fx, fy, cx, cy = values
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return YamlCamera(matrix, lens, _numbers(section, "resolution", name), projection)


def _refuse(name: str, what: str, remedy: str) -> NoReturn:
    raise InputError.single(where=name, what=what, remedy=remedy)


def _known(name: str, key: str, value: str, known: Collection[str]) -> None:
    if value not in known:
        _refuse(
            name,
            f"{key} {shown(value)} is not one of {', '.join(known)}",
            "calibrate with one of these, or give images of a board",
        )


def _text(node: Any) -> str:
    return node.value if isinstance(node, yaml.ScalarNode) else ""


def _numbers(section: Mapping[str, Any], key: str, name: str) -> FloatArray:
    node = section.get(key)
    items = node.value if isinstance(node, yaml.SequenceNode) else [None]
    values = np.array([number(item) for item in items])
    if not np.isfinite(values).all():
        _refuse(name, f"'{key}' is not a list of finite numbers", "write it again with Kalibr")
    return values
