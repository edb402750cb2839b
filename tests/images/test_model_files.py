"""Camera models as text. Evidence: read back by mrcal, by OpenCV and by the dataset reader."""

from __future__ import annotations

import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.core.mrcal_python import DEFAULT_INTERPRETER
from calib.dataset.camera_file import read_camera
from calib.geometry.camera import Camera, intrinsic_vector
from calib.images.intrinsics.model_files import cameramodel_text, opencv_text

MATRIX = np.array([[540.123456789, 0, 322.3], [0, 541.5, 236.8], [0, 0, 1]])
LENS = np.array([-0.25, 0.1, 1e-3, -2e-3, 0.03, 0.2, 0.05, 0.01, 1e-3, -2e-3, 3e-3, 1e-3])
CAMERAS = [Camera(MATRIX, LENS[:count], (640, 480)) for count in (0, 4, 5, 8, 12)]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{len(c.distortion)} coefficients")
@pytest.mark.parametrize("write", [cameramodel_text, opencv_text])
def test_datasets_read_what_is_written(camera: Camera, write: object) -> None:
    again = read_camera(write(camera), name="camera")
    assert again.image_size == camera.image_size
    count = len(intrinsic_vector(camera))
    assert intrinsic_vector(again)[:count] == pytest.approx(intrinsic_vector(camera), rel=1e-11)
    assert not np.any(intrinsic_vector(again)[count:])


def test_mrcal_reads_its_format(tmp_path: Path) -> None:
    (tmp_path / "a.cameramodel").write_text(cameramodel_text(CAMERAS[3]), encoding="utf-8")
    script = (
        "import mrcal, numpy as np\n"
        "m = mrcal.cameramodel('a.cameramodel')\n"
        "assert m.intrinsics()[0] == 'LENSMODEL_OPENCV8'\n"
        "assert tuple(m.imagersize()) == (640, 480)\n"
        "np.save('intrinsics.npy', m.intrinsics()[1])\n"
    )
    subprocess.run([DEFAULT_INTERPRETER, "-I", "-c", script], cwd=tmp_path, check=True)
    read = np.load(tmp_path / "intrinsics.npy")
    assert read == pytest.approx(intrinsic_vector(CAMERAS[3]), rel=1e-11)


def test_opencv_reads_its_format() -> None:
    text = opencv_text(CAMERAS[2])
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert np.array_equal(storage.getNode("camera_matrix").mat(), MATRIX)
    assert storage.getNode("image_width").real() == 640


def test_a_tilted_imager_has_no_mrcal_model() -> None:
    with pytest.raises(ValueError, match="14"):
        cameramodel_text(Camera(MATRIX, np.zeros(14), (640, 480)))
