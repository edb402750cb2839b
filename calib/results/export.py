"""Cameras and their pose in the formats of other tools.

Lengths are mm where the tool has no unit of its own (OpenCV), and m where it has (mrcal's boards,
ROS, Kalibr). All four put the origin of pixels at the centre of the top-left one, as here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.geometry.camera import Camera, intrinsic_vector
from calib.geometry.lens import PROJECTIONS, ProjectionName
from calib.images.intrinsics.model_files import cameramodel_text, opencv_text
from calib.instrument.calibration_file import Cameras

_M = 1e-3


def opencv(found: Cameras) -> dict[str, str]:
    """Return files for ``cv2.FileStorage``; R and T of stereo.yaml are those of stereoRectify."""
    import cv2

    files = {f"{name}.yaml": opencv_text(camera) for name, camera in found.cameras.items()}
    if found.transform_12 is not None:
        back = np.linalg.inv(found.transform_12)
        flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
        storage = cv2.FileStorage("stereo.yml", flags)
        storage.writeComment("x2 = R x1 + T, mm, as cv2.stereoCalibrate and stereoRectify have it")
        storage.write("R", np.ascontiguousarray(back[:3, :3]))
        storage.write("T", np.ascontiguousarray(back[:3, 3:]))
        files["stereo.yaml"] = str(storage.releaseAndGetString())
    return files


def mrcal(found: Cameras) -> dict[str, str]:
    """Return ``.cameramodel`` files whose reference frame is that of C1, lengths in m."""
    files = {}
    for name, camera in found.cameras.items():
        pose = np.zeros(6)
        if name == "c2" and found.transform_12 is not None:
            back = np.linalg.inv(found.transform_12)
            pose[:3] = Rotation.from_matrix(back[:3, :3]).as_rotvec()
            pose[3:] = back[:3, 3] * _M
        _lens(camera, name, {"perspective": (0, 4, 5, 8, 12)}, "mrcal")
        files[f"{name}.cameramodel"] = cameramodel_text(camera, extrinsics=pose)
    return files


def ros(found: Cameras) -> dict[str, str]:
    """Return ``camera_info`` files, and the pose of C2 as the arguments of a static transform."""
    files = {f"{name}.yaml": _camera_info(camera, name) for name, camera in found.cameras.items()}
    if found.transform_12 is not None:
        x, y, z, w = Rotation.from_matrix(found.transform_12[:3, :3]).as_quat().tolist()
        tx, ty, tz = (found.transform_12[:3, 3] * _M).tolist()
        transform = {
            "header": {"frame_id": "c1_optical"},
            "child_frame_id": "c2_optical",
            "transform": {
                "translation": {"x": tx, "y": ty, "z": tz},
                "rotation": {"x": x, "y": y, "z": z, "w": w},
            },
        }
        files["transform.yaml"] = _yaml(transform)
    return files


def _camera_info(camera: Camera, name: str) -> str:
    """Return a camera as camera_calibration_parsers of ROS reads it."""
    lens = _lens(camera, name, {"perspective": (0, 4, 5, 8), "equidistant": (4,)}, "ROS")
    width, height = camera.image_size
    model: str = "equidistant" if camera.projection == "equidistant" else "rational_polynomial"
    if camera.projection == "perspective" and len(lens) < 8:
        model, lens = "plumb_bob", np.pad(lens, (0, 5))[:5]
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])
    return _yaml(
        {
            "image_width": width,
            "image_height": height,
            "camera_name": name,
            "camera_matrix": _matrix(camera.matrix),
            "distortion_model": model,
            "distortion_coefficients": _matrix(lens[None]),
            "rectification_matrix": _matrix(np.eye(3)),
            "projection_matrix": _matrix(projection),
        }
    )


def kalibr(found: Cameras) -> dict[str, str]:
    """Return a camchain: cam0 is C1, cam1 is C2."""
    chain: dict[str, object] = {}
    for name, camera in found.cameras.items():
        lens = _lens(camera, name, {"perspective": (0, 4, 5), "equidistant": (4,)}, "Kalibr")
        if len(lens) == 5 and lens[4] != 0:
            raise UsageError(
                f"--format kalibr: its radtan model has no k3, which is {lens[4]:g} for {name}; "
                "export to another format, or calibrate with four coefficients"
            )
        section: dict[str, object] = {
            "camera_model": "pinhole",
            "intrinsics": _numbers(intrinsic_vector(camera)[:4]),
            "distortion_model": "radtan" if camera.projection == "perspective" else "equidistant",
            "distortion_coeffs": _numbers(np.pad(lens, (0, 4))[:4]),
            "resolution": list(camera.image_size),
            "rostopic": f"/{name}/image_raw",
        }
        if name == "c2" and "cam0" in chain and found.transform_12 is not None:
            pose = np.linalg.inv(found.transform_12)
            pose[:3, 3] *= _M
            section["T_cn_cnm1"] = [_numbers(row) for row in pose]
        chain[f"cam{len(chain)}"] = section
    return {"camchain.yaml": _yaml(chain)}


FORMATS: Mapping[str, Callable[[Cameras], dict[str, str]]] = MappingProxyType(
    {"opencv": opencv, "mrcal": mrcal, "ros": ros, "kalibr": kalibr}
)


def marked(text: str, comment: str) -> str:
    """Return a file with a line of comment; OpenCV's YAML has a directive and `---` before it."""
    head, line, rest = text.partition("---\n") if text.startswith("%YAML") else ("", "", text)
    return f"{head}{line}{comment}\n{rest}"


def _lens(
    camera: Camera, name: str, known: Mapping[ProjectionName, tuple[int, ...]], tool: str
) -> FloatArray:
    """Return the distortion, if the tool knows the lens model with as many coefficients."""
    count = len(camera.distortion)
    if camera.projection not in known:
        words = PROJECTIONS[camera.projection].words
        raise UsageError(
            f"--format {tool.lower()}: {tool} has no {words} lens model, which {name} has; export "
            "to another format"
        )
    if count not in known[camera.projection]:
        raise UsageError(
            f"--format {tool.lower()}: {tool} has no lens model with the {count} of OpenCV's "
            f"coefficients that {name} has; export to another format"
        )
    return camera.distortion


def _matrix(values: FloatArray) -> dict[str, object]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": _numbers(values.ravel())}


def _numbers(values: FloatArray) -> list[float]:
    return [float(f"{v:.12g}") for v in values]


def _yaml(content: Mapping[str, object]) -> str:
    text: str = yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=100)
    return text
