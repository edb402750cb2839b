"""Cameras in YAML: OpenCV's FileStorage and ROS's camera_info, which have the same keys.

Parsed by libyaml, event by event first: OpenCV's own parser crashes on deep nesting, and hangs on
some damaged files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np
import yaml

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.messages import shown
from calib.geometry.lens import ProjectionName, coefficients_fault

YAML_LIMIT = 4 * 1024 * 1024
"""Characters: the corners of a thousand views, which OpenCV's sample may write into the file."""

NESTING = 16
"""Levels of lists and tables; OpenCV writes four."""

LONGEST_MATRIX = 14

BROWN: Final = {
    "plumb_bob": (4, 5),
    "radtan": (4, 5),
    "radial_tangential": (4, 5),
    "brown_conrady": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "rational": (8, 12, 14),
    "thin_prism": (12, 14),
    "pinhole": (0, 4, 5, 8, 12, 14),
    "perspective": (0, 4, 5, 8, 12, 14),
    "none": (0,),
}
"""Names of OpenCV's pinhole models, with the numbers of their coefficients."""

EQUIDISTANT: Final = (
    *(
        "equidistant",
        "equi_distant",
        "equi",
        "fisheye",
        "opencv_fisheye",
        "kannala_brandt",
        "kannalabrandt",
    ),
    *("kannalabrandt4", "kannalabrandt8", "kb4"),
)
"""Names of OpenCV's fisheye model; ORB-SLAM counts its focal lengths and centre in, to 8."""

_OTHERS = re.compile(
    r"equi-?_?dist|fish-?_?eye|kannala|brandt|\bkb\d*|omni|\bmei\b|\be?ucm\b|unified|double_?"
    r"sphere|\bds\b|\bfov\b|\batan\b|equi-?_?solid|stereographic|orthographic|cahvore?|spherical|"
    r"cylindrical|panoram|spline|scaramuzza|ocam|division",
    re.IGNORECASE,
)
"""What other lens models are called."""

_MODEL_KEY = re.compile(
    r"(distortion|lens|projection|camera)?[_.]?(model|type)(_type|_name)?|fisheye_model|projection",
    re.IGNORECASE,
)
_OMNIDIRECTIONAL_KEYS = ("xi", "mirror_parameters")
"""Written by `cv2.omnidir` and CamOdoCal beside a matrix and coefficients like a pinhole's."""

_SURE_KEYS = ("distortion_model", "distortion_type", "lens_model", "projection_model")
_DISTORTION_NAMES = ("distortion_coefficients", "dist_coeffs")
_FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_OTHER = "calibrate with one of OpenCV's (pinhole, rational, fisheye), or give images"
_AGAIN = "write the file again with cv2.FileStorage"


class YamlCamera(NamedTuple):
    """What a file says: matrix (r, c), lens (k,) and its model, image size (2,), finite or not."""

    matrix: FloatArray
    distortion: FloatArray
    size: FloatArray
    projection: ProjectionName = "perspective"


def looks_like_yaml(text: str) -> bool:
    """Return whether a camera file is meant to be YAML."""
    return text.startswith("%YAML") or re.search(r"^camera_matrix\s*:", text, re.M) is not None


def read_yaml_camera(text: str, *, name: str) -> YamlCamera:
    """Return what the YAML of a camera says.

    Parameters
    ----------
    text
        Of the whole file.
    name
        Of the file, for messages.

    Raises
    ------
    InputError
        If it is no such file, or names a lens model that is none of OpenCV's.
    """
    root = root_of(text, name)
    lens = next((key for key in _DISTORTION_NAMES if key in root), _DISTORTION_NAMES[0])
    projection = _projection(root, name)
    for key in _OMNIDIRECTIONAL_KEYS:
        if key in root:
            _refuse(name, f"has '{key}', of an omnidirectional lens model", _OTHER)
    for key in ("camera_matrix", lens, "image_width", "image_height"):
        if key not in root:
            _refuse(name, f"has no '{key}'", "write the file as OpenCV's calibration sample does")
    distortion = _matrix(root[lens], name, lens).ravel()
    _check_count(root, len(distortion), projection, name)
    return YamlCamera(
        matrix=_matrix(root["camera_matrix"], name, "camera_matrix"),
        distortion=distortion,
        size=np.array([number(root[key]) for key in ("image_width", "image_height")]),
        projection=projection,
    )


def _refuse(name: str, what: str, remedy: str) -> NoReturn:
    raise InputError.single(where=name, what=what, remedy=remedy)


def root_of(text: str, name: str) -> Mapping[str, Any]:
    """Return the nodes of the top level by key."""
    if len(text) > YAML_LIMIT:
        _refuse(name, f"is larger than {YAML_LIMIT // 1024**2} MiB", "write the camera alone")
    # OpenCV writes %YAML:1.0, which is no directive of YAML.
    body = re.sub(r"\A%YAML[^\n]*\n", "\n", text)
    try:
        if not _is_shallow(body):
            _refuse(name, "is nested too deeply, or refers to itself", _AGAIN)
        root = yaml.compose(body, Loader=yaml.CSafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        root = None
    if not isinstance(root, yaml.MappingNode):
        _refuse(name, "is not OpenCV's YAML", _AGAIN)
    return by_key(root, name)


def _is_shallow(text: str) -> bool:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > NESTING or isinstance(event, yaml.AliasEvent):
            return False
    return True


def by_key(node: yaml.MappingNode, name: str) -> dict[str, Any]:
    """Return the nodes of a section by key; none is there twice."""
    found: dict[str, Any] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            _refuse(name, "is not OpenCV's YAML", _AGAIN)
        if key.value in found:
            _refuse(name, f"has {shown(key.value)} twice", "keep one of them")
        found[key.value] = value
    return found


def number(node: Any) -> float:
    """Return the number in a node, NaN if it is none."""
    text = node.value if isinstance(node, yaml.ScalarNode) else ""
    return float(text) if _FLOAT.fullmatch(text) else np.nan


def _matrix(node: Any, name: str, key: str) -> FloatArray:
    """Return a matrix; OpenCV 5 writes flat arrays with `sizes` for `rows` and `cols`."""
    parts = by_key(node, name) if isinstance(node, yaml.MappingNode) else {}
    sizes, data = parts.get("sizes"), parts.get("data")
    if isinstance(sizes, yaml.SequenceNode):
        shape = [number(side) for side in sizes.value]
    else:
        shape = [number(parts.get(side)) for side in ("rows", "cols")]
    count = math.prod(shape)
    if isinstance(data, yaml.SequenceNode) and count == len(data.value) <= LONGEST_MATRIX:
        values = np.array([number(item) for item in data.value])
        if np.all(np.isfinite(values)):
            return values.reshape([int(side) for side in shape])
    _refuse(name, f"'{key}' is not a matrix of finite numbers", "write the file again")


def _named_models(root: Mapping[str, Any]) -> dict[str, str]:
    """Return the values of keys that may name a lens model."""
    return {
        key: node.value.strip()
        for key, node in root.items()
        if isinstance(node, yaml.ScalarNode) and _MODEL_KEY.fullmatch(key)
    }


def _projection(root: Mapping[str, Any], name: str) -> ProjectionName:
    """Return the lens model that a file names, perspective if none.

    Raises
    ------
    InputError
        If it is another one, or two of them.
    """
    found: dict[ProjectionName, str] = {}
    for key, value in _named_models(root).items():
        plain = _plain(value)
        if key == "fisheye_model":
            if number(root[key]) != 0:
                found["equidistant"] = f"{key} {value}"
        elif plain in EQUIDISTANT:
            found["equidistant"] = f"{key} {shown(value)}"
        elif plain in BROWN:
            # With fisheye_model a pinhole may be the camera that the lens stands before.
            if plain not in ("pinhole", "perspective"):
                found["perspective"] = f"{key} {shown(value)}"
        elif _OTHERS.search(value) or key.lower() in _SURE_KEYS:
            _refuse(
                name,
                f"{key} {shown(value)} is none of OpenCV's lens models",
                _OTHER,
            )
    if len(found) > 1:
        said = " and ".join(found.values())
        _refuse(name, f"names two lens models: {said}", "check which one the coefficients are of")
    return next(iter(found), "perspective")


def _check_count(
    root: Mapping[str, Any], count: int, projection: ProjectionName, name: str
) -> None:
    """Refuse a number of coefficients that the model named does not have."""
    remedy = "check which model the coefficients are of"
    if projection == "equidistant":
        if fault := coefficients_fault(projection, count):
            _refuse(name, f"has {count} distortion coefficients, and {fault}", remedy)
        return
    for key, value in _named_models(root).items():
        counts = BROWN.get(_plain(value), (count,))
        if count not in counts:
            wanted = " or ".join(map(str, counts))
            what = f"{key} {shown(value)} has {wanted} coefficients, and {count} are given"
            _refuse(name, what, remedy)


def _plain(value: str) -> str:
    return value.lower().replace("-", "_").replace(" ", "_")
