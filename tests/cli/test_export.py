"""Cameras for other tools, and from them.

Evidence: the tools themselves (mrcal, OpenCV) project a point through both exported cameras as our
own projection does; of ROS and Kalibr, closed forms; all formats are read back as given cameras.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from command import call
from scipy.spatial.transform import Rotation

from calib.core.errors import InputError
from calib.core.mrcal_python import mrcal_interpreter
from calib.dataset.camera_file import read_camera
from calib.geometry.camera import Camera, project

SIZE = (640, 480)
MATRIX = [[800.25, 0.0, 320.5], [0.0, 810.5, 240.25], [0.0, 0.0, 1.0]]
BROWN4, BROWN5 = [-0.21, 0.05, 1e-4, -2e-4], [-0.21, 0.05, 1e-4, -2e-4, 0.01]
RATIONAL = [0.3, -0.1, 1e-4, -2e-4, 0.02, 0.5, 0.01, 0.003]
POINTS = np.array([[30.0, -40.0, 900.0], [200.0, 100.0, 1500.0], [-100.0, 50.0, 700.0]])

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.02, -0.3, 0.01]).as_matrix()
POSE[:3, 3] = [120.0, 3.0, -5.0]


def calibration(
    folder: Path, lens: list[float], projection: str = "perspective", **more: Any
) -> Path:
    cameras = {
        name: {
            "source": "given", "matrix": [[f, *MATRIX[0][1:]], *MATRIX[1:]],
            "distortion": lens, "image_size": list(SIZE), "projection": projection,
        }
        for name, f in (("c1", 800.25), ("c2", 790.75))
    }  # fmt: skip
    document: dict[str, Any] = {
        "format": 1,
        "intrinsics": cameras,
        "stereo": {"transform_12": POSE.tolist()},
    }
    path = folder / "calibration.json"
    path.write_text(json.dumps(document | more))
    return path


def camera(lens: list[float], name: str) -> Camera:
    f = {"c1": 800.25, "c2": 790.75}[name]
    return Camera(np.array([[f, *MATRIX[0][1:]], *MATRIX[1:]]), np.array(lens), SIZE)


def seen(lens: list[float], name: str) -> np.ndarray[Any, Any]:
    """Return the pixels of `POINTS`, which are in C1's frame, mm."""
    back = np.linalg.inv(POSE)
    points = POINTS if name == "c1" else POINTS @ back[:3, :3].T + back[:3, 3]
    return project(camera(lens, name), points)


def export(tool: str, lens: list[float], folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    out = folder / tool
    ended = call(capsys, "export", calibration(folder, lens), "--format", tool, "--out", out)
    assert (ended.status, ended.err) == (0, "")
    assert sorted(map(str, out.iterdir())) == sorted(ended.out.split())
    return out


def test_opencv_projects_as_we_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = export("opencv", RATIONAL, tmp_path, capsys)
    stereo = cv2.FileStorage(str(out / "stereo.yaml"), cv2.FILE_STORAGE_READ)
    rotation, shift = stereo.getNode("R").mat(), stereo.getNode("T").mat()
    for name, r, t in (("c1", np.eye(3), np.zeros(3)), ("c2", rotation, shift)):
        storage = cv2.FileStorage(str(out / f"{name}.yaml"), cv2.FILE_STORAGE_READ)
        matrix = storage.getNode("camera_matrix").mat()
        lens = storage.getNode("distortion_coefficients").mat()
        pixels, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(r)[0], t, matrix, lens)
        np.testing.assert_allclose(pixels[:, 0], seen(RATIONAL, name), atol=1e-8)


@pytest.mark.parametrize("lens", [[], BROWN4, BROWN5, RATIONAL])
def test_mrcal_projects_as_we_do(
    lens: list[float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = export("mrcal", lens, tmp_path, capsys)
    program = (
        "import sys, json, numpy as np, mrcal\n"
        "p = np.array(json.loads(sys.argv[2])) / 1000\n"
        "m = mrcal.cameramodel(sys.argv[1])\n"
        "p = mrcal.transform_point_rt(m.extrinsics_rt_fromref(), p)\n"
        "q = mrcal.project(p, *m.intrinsics())\n"
        "print(json.dumps(q.tolist()))\n"
    )
    for name in ("c1", "c2"):
        model, points = out / f"{name}.cameramodel", json.dumps(POINTS.tolist())
        done = subprocess.run(
            [mrcal_interpreter(), "-c", program, model, points],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        np.testing.assert_allclose(json.loads(done.stdout), seen(lens, name), atol=1e-7)


def test_ros(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = export("ros", BROWN5, tmp_path, capsys)
    info = yaml.safe_load((out / "c2.yaml").read_text())
    assert (info["image_width"], info["image_height"]) == SIZE
    assert info["distortion_model"] == "plumb_bob"
    assert info["distortion_coefficients"] == {"rows": 1, "cols": 5, "data": BROWN5}
    assert info["projection_matrix"]["data"][:3] == [790.75, 0.0, 320.5]
    transform = yaml.safe_load((out / "transform.yaml").read_text())["transform"]
    q, t = transform["rotation"], transform["translation"]
    turned = Rotation.from_quat([q[k] for k in "xyzw"]).as_matrix()
    np.testing.assert_allclose(turned, POSE[:3, :3], atol=1e-12)
    np.testing.assert_allclose([1000 * t[k] for k in "xyz"], POSE[:3, 3], rtol=1e-12)


def test_kalibr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = export("kalibr", BROWN4, tmp_path, capsys)
    chain = yaml.safe_load((out / "camchain.yaml").read_text())
    assert chain["cam1"]["intrinsics"] == [790.75, 810.5, 320.5, 240.25]
    assert chain["cam1"]["distortion_coeffs"] == BROWN4
    pose = np.array(chain["cam1"]["T_cn_cnm1"])
    pose[:3, 3] *= 1000
    np.testing.assert_allclose(pose @ POSE, np.eye(4), atol=1e-9)


@pytest.mark.parametrize(
    ("tool", "file", "lens"),
    [
        ("opencv", "{}.yaml", RATIONAL), ("mrcal", "{}.cameramodel", BROWN5),
        ("ros", "{}.yaml", BROWN5), ("ros", "{}.yaml", RATIONAL), ("ros", "{}.yaml", BROWN4),
        ("kalibr", "camchain.yaml", BROWN4), ("kalibr", "camchain.yaml", []),
    ],
)  # fmt: skip
def test_what_is_exported_can_be_given(
    tool: str, file: str, lens: list[float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = export(tool, lens, tmp_path, capsys)
    for name in ("c1", "c2"):
        path = out / file.format(name)
        found = read_camera(path.read_text(), name=path.name, camera=name)
        assert found.image_size == SIZE
        np.testing.assert_allclose(found.matrix, camera(lens, name).matrix, rtol=1e-12)
        padded = np.pad(lens, (0, len(found.distortion) - len(lens)))
        np.testing.assert_allclose(found.distortion, padded, rtol=1e-11)


@pytest.mark.parametrize(
    ("tool", "lens", "said"),
    [
        ("kalibr", BROWN5, "no k3, which is 0.01 for c1"),
        ("kalibr", RATIONAL, "no lens model with the 8"),
        ("ros", [*RATIONAL, 0.0, 0.0, 0.0, 1e-3], "no lens model with the 12"),
    ],
)
def test_what_a_tool_cannot_say_is_refused(
    tool: str, lens: list[float], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    ended = call(capsys, "export", calibration(tmp_path, lens), "--format", tool, "--out", out)
    assert ended.status == 2
    assert said in ended.err
    assert not out.exists()


FISHEYE = [-0.02, 0.004, -0.002, 3e-4]


@pytest.mark.parametrize(
    ("tool", "file"), [("opencv", "{}.yaml"), ("ros", "{}.yaml"), ("kalibr", "camchain.yaml")]
)
def test_fisheye_comes_back_as_it_went(
    tool: str, file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / tool
    source = calibration(tmp_path, FISHEYE, "equidistant")
    assert call(capsys, "export", source, "--format", tool, "--out", out).status == 0
    for name in ("c1", "c2"):
        path = out / file.format(name)
        found = read_camera(path.read_text(), name=path.name, camera=name)
        assert (found.projection, found.image_size) == ("equidistant", SIZE)
        np.testing.assert_allclose(found.matrix, camera(FISHEYE, name).matrix, rtol=1e-12)
        np.testing.assert_allclose(found.distortion, FISHEYE, rtol=1e-11)


def test_mrcal_has_no_fisheye(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    source = calibration(tmp_path, FISHEYE, "equidistant")
    ended = call(capsys, "export", source, "--format", "mrcal", "--out", out)
    assert (ended.status, ended.err.count("\n")) == (2, 1)
    assert "mrcal has no equidistant (fisheye) lens model, which c1 has" in ended.err
    assert not out.exists()


def test_failed_gates_reach_who_exports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gates = [{"name": "intrinsics c1", "passed": False, "detail": "rms 3 px"}]
    arguments = ["export", calibration(tmp_path, BROWN5, gates=gates), "--format", "opencv"]
    ended = call(capsys, *arguments, "--out", tmp_path / "a")
    assert ended.status == 3
    assert "gate intrinsics c1 FAILED: rms 3 px" in ended.err
    assert (tmp_path / "a" / "c1.yaml").exists()
    assert call(capsys, *arguments, "--out", tmp_path / "b", "--accept-failed").status == 0


KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.0001, -0.0002]
  distortion_model: radtan
  intrinsics: [800.0, 810.0, 320.5, 240.25]
  resolution: [640, 480]
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("radtan", "fov", "is not one of"),
        ("  distortion_model: radtan\n", "", "'cam0' has no 'distortion_model'"),
        ("pinhole", "omni", "camera_model 'omni' is not one of pinhole"),
        ("[800.0, ", "[0.5, 800.0, ", "'intrinsics' has not four numbers"),
        ("[640, 480]", "[640]", "image size"),
        ("cam0:", "cam0: 3\ncam1:", "'cam0' is no section"),
    ],
)
def test_faults_of_kalibr_files(old: str, new: str, said: str) -> None:
    alone = read_camera(KALIBR, name="chain.yaml", camera="c2")
    assert alone.matrix[0, 0] == 800.0
    with pytest.raises(InputError, match=said):
        read_camera(KALIBR.replace(old, new, 1), name="chain.yaml")
