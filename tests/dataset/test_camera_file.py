"""Finished camera models: mrcal's and OpenCV's files read as their makers wrote them.

Evidence: independent tool (the mrcal texts were written by mrcal 2.2, the YAML by OpenCV).
"""

from __future__ import annotations

import ast
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_examples import (
    MANIFEST,
    assert_problem,
    assert_readable,
    problems_of,
    replaced,
    write_dataset,
)

from calib.core.errors import InputError
from calib.dataset.camera_file import LITERAL_LIMIT, read_camera
from calib.dataset.contents import given_camera
from calib.dataset.load import load_dataset
from calib.geometry.camera import project

MRCAL = """# OPENCV8
{
    'lensmodel':  'LENSMODEL_OPENCV8',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 421.71, 424.68, 201.27, 155.17,
        -0.3691, 0.2223, -0.0002, 0.0001, -0.1047, 0.01, 0.02, 0.03,],

    # The valid-intrinsics region is a closed polygon
    'valid_intrinsics_region': [
    [ 10, 10 ],
    [ 390, 10 ],
    [ 390, 290 ],
    [ 10, 290 ],
    [ 10, 10 ],
],

    # extrinsics are rt_fromref
    'extrinsics': [ 0, 0, 0, 0, 0, 0,],

    'imagersize': [ 400, 300,],

    # The optimization inputs contain all the data used to compute this model
    'icam_intrinsics': 0,
    'optimization_inputs': b'P)h>@6aWAK2mtey7DoU8{"[(',
}
"""
OPENCV_4 = """%YAML:1.0
---
image_width: 400
image_height: 300
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 421.71, 0., 201.27, 0., 424.68, 155.17, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 8
   cols: 1
   dt: d
   data: [ -0.3691, 0.2223, -2.0000000000000001e-04, 1.0000000000000000e-04, -0.1047, 0.01,
       0.02, 0.03 ]
"""
MATRIX = np.array([[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]])
DISTORTION = np.array([-0.3691, 0.2223, -0.0002, 0.0001, -0.1047, 0.01, 0.02, 0.03])


def opencv_yaml(
    matrix: object = MATRIX, distortion: object = DISTORTION, *, name: str = "dist_coeffs"
) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", 400)
    storage.write("image_height", 300)
    storage.write("camera_matrix", matrix)
    storage.write(name, distortion)
    return storage.releaseAndGetString()


def fault_of(text: str) -> str:
    with pytest.raises(InputError) as caught:
        read_camera(text, name="c1.model")
    (problem,) = caught.value.problems
    assert_readable(problem)
    assert problem.where == "c1.model"
    return str(problem)


@pytest.mark.parametrize(
    "text",
    [MRCAL, MRCAL.replace("\n", "\r\n"), opencv_yaml(), OPENCV_4],
    ids=["mrcal", "CRLF", "OpenCV 5", "OpenCV 4"],
)
def test_camera_is_read_as_written(text: str) -> None:
    camera = read_camera(text, name="c1.model")
    np.testing.assert_array_equal(camera.matrix, MATRIX)
    np.testing.assert_array_equal(camera.distortion, DISTORTION)
    assert camera.image_size == (400, 300)


@pytest.mark.parametrize(("model", "count"), [("PINHOLE", 0), ("OPENCV4", 4), ("OPENCV5", 5)])
def test_lens_models_of_mrcal_that_are_opencvs(model: str, count: int) -> None:
    values = [421.71, 424.68, 201.27, 155.17, *DISTORTION[:count].tolist()]
    text = repr({"lensmodel": f"LENSMODEL_{model}", "intrinsics": values, "imagersize": [400, 300]})
    camera = read_camera(text, name="c1.cameramodel")
    np.testing.assert_array_equal(camera.distortion, DISTORTION[:count])


@pytest.mark.parametrize("shape", [(5, 1), (1, 5), (4, 1), (14, 1)])
def test_distortion_of_opencv_may_lie_or_stand(shape: tuple[int, int]) -> None:
    distortion = np.linspace(-0.01, 0.01, max(shape)).reshape(shape)
    text = opencv_yaml(MATRIX, distortion, name="distortion_coefficients")
    np.testing.assert_array_equal(read_camera(text, name="c1.yml").distortion, distortion.ravel())


MRCAL_FAULTS = {
    "splined": ("LENSMODEL_OPENCV8", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3", "mrcal-convert"),
    "stereographic": ("LENSMODEL_OPENCV8", "LENSMODEL_STEREOGRAPHIC", "mrcal-convert-lensmodel"),
    "lens model of another length": ("LENSMODEL_OPENCV8", "LENSMODEL_OPENCV5", "has 9"),
    "word": ("421.71", "fx", "not a mrcal model"),
    "call": ("421.71", "__import__('os')", "not a mrcal model"),
    "arithmetic": ("421.71", "9+-9", "not a mrcal model"),
    "infinite": ("421.71", "1e999", "finite"),
    "text": ("421.71", "'421.71'", "finite"),
    "huge": ("421.71", "9" * 400, "finite"),
    "no numbers": ("[ 400, 300,]", "{}", "imagersize"),
    "one size": ("[ 400, 300,]", "[ 400,]", "image size"),
    "half a pixel": ("[ 400, 300,]", "[ 400.5, 300,]", "image size"),
    "negative focal length": ("421.71", "-421.71", "focal lengths"),
    "open bracket": ("'imagersize': [", "'imagersize': [[[[[[", "not a mrcal model"),
    "nesting": ("'imagersize': [", "'imagersize': " + 90 * "[" + 90 * "]" + ", 'a': [", "mrcal"),
    "a key twice": ("'extrinsics'", "'imagersize': [ 4, 3,],\n    'extrinsics'", "twice"),
    "signs": ("421.71", 5000 * "-" + "1", "not a mrcal model"),
    "too long": ("# OPENCV8", "#" * LITERAL_LIMIT, "not a mrcal model"),
}


@pytest.mark.parametrize(("old", "new", "said"), MRCAL_FAULTS.values(), ids=MRCAL_FAULTS.keys())
def test_mrcal_fault_is_named(old: str, new: str, said: str) -> None:
    assert said in fault_of(MRCAL.replace(old, new, 1))


def test_mrcals_parser_is_never_eval() -> None:
    """What literal_eval would refuse anyway does not even reach Python's parser."""
    text = MRCAL.replace("421.71", "(lambda: 0)()")
    with pytest.raises(ValueError, match="malformed"):
        ast.literal_eval(text[text.index("{") :])
    assert "not a mrcal model" in fault_of(text)


YAML_FAULTS = {
    "no matrix": ("camera_matrix", "K", "no 'camera_matrix'"),
    "no distortion": ("dist_coeffs", "D", "no 'distortion_coefficients'"),
    "no size": ("image_width", "width", "no 'image_width'"),
    "matrix too large": ("rows: 3", "rows: 300000000", "'camera_matrix' is not a matrix"),
    "matrix that is a number": ("!!opencv-matrix", "1\nx:", "'camera_matrix' is not"),
    "word": ("421.7", "x", "'camera_matrix'"),
    "skewed": ("cols: 3", "cols: 1", "matrix"),
    "broken": ("data: [", "data: [[[", "OpenCV"),
    "endless": ("image_width: 400", "image_width: 1e400", "image size"),
    "half a pixel": ("image_width: 400", "image_width: 400.5", "image size"),
    "fisheye": ("image_width", "fisheye_model: 1\nimage_width", "equidistant lenses have 4"),
    "two models": (
        "image_width",
        "fisheye_model: 1\ndistortion_model: plumb_bob\nimage_width",
        "names two lens models: fisheye_model 1 and distortion_model",
    ),
    "omnidirectional": ("image_width", "xi: 1.2\nimage_width", "has 'xi', of an omnidirectional"),
    "a key twice": ("image_width: 400", "image_width: 400\nimage_width: 500", "twice"),
    "a key of a matrix twice": ("rows: 3", "rows: 3\n   rows: 3", "twice"),
    "itself": ("image_width: 400", "a: &a 400\nimage_width: *a", "refers to itself"),
}


@pytest.mark.parametrize(("old", "new", "said"), YAML_FAULTS.values(), ids=YAML_FAULTS.keys())
def test_yaml_fault_is_named(old: str, new: str, said: str) -> None:
    text = opencv_yaml()
    assert old in text
    assert said in fault_of(text.replace(old, new, 1))


DEEP = 40_000
NESTED = {
    "lists": "[" * DEEP + "]" * DEEP,
    "tables": "{b: " * DEEP + "}" * DEEP,
    "lists in lines": "\n" + "- " * DEEP + "1",
    "keys": "a: " * DEEP + "1",
    "indented": "\n" + "".join(f"{' ' * i}b:\n" for i in range(2000)),
}


@pytest.mark.parametrize("nested", NESTED.values(), ids=NESTED.keys())
def test_deeply_nested_yaml_is_refused(nested: str) -> None:
    """OpenCV's parser ends the process on these, one of them in 40,000 levels."""
    text = opencv_yaml()
    assert "c1.model" in fault_of(text.replace("image_width", f"a: {nested}\nimage_width", 1))


def test_yaml_that_opencv_never_finishes() -> None:
    text = f"%YAML:1.0\n---\na: !!binary |\n  {'A' * 1000}\n"
    assert "no 'camera_matrix'" in fault_of(text)


@pytest.mark.parametrize("seed", range(100))
def test_damaged_yaml_is_read_or_refused(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(OPENCV_4.encode())
    for _ in range(rng.integers(1, 6)):
        at = int(rng.integers(len(data)))
        kind = rng.integers(3)
        if kind == 0:
            data[at] = int(rng.integers(1, 128))
        elif kind == 1:
            del data[at : at + int(rng.integers(1, 30))]
        else:
            start = int(rng.integers(len(data)))
            data[at:at] = data[start : start + int(rng.integers(1, 60))]
    try:
        camera = read_camera(data.decode(), name="c1.model")
    except InputError as error:
        assert_readable(error.problems[0])
    else:
        assert np.isfinite(camera.matrix).all()
        assert np.isfinite(camera.distortion).all()


def with_model(key: str, value: str, count: int = 4) -> str:
    text = opencv_yaml(MATRIX, np.full((count, 1), 1e-3))
    return text.replace("image_width", f"{key}: {value}\nimage_width", 1)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("distortion_model", "equidistant6"),
        ("distortion_model", "of_our_own"),
        ("camera_model", "double_sphere"),
        ("model_type", "MEI"),
        ("camera_model", "omni"),
        ("lens_model", "LENSMODEL_SPLINED_STEREOGRAPHIC"),
        ("distortion_type", "fov"),
        ("projection", "equisolid"),
    ],
)
def test_named_lens_model_that_is_none_of_opencvs_is_refused(key: str, value: str) -> None:
    problem = fault_of(with_model(key, value))
    assert key in problem
    assert value.strip('"') in problem


@pytest.mark.parametrize(
    ("value", "count"), [("plumb_bob", 5), ("rational_polynomial", 8), ("radial-tangential", 4)]
)
def test_named_lens_model_that_is_opencvs_is_read(value: str, count: int) -> None:
    camera = read_camera(with_model("distortion_model", value, count), name="c1.model")
    np.testing.assert_array_equal(camera.distortion, np.full(count, 1e-3))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("distortion_model", "equidistant"),
        ("distortion_model", '"fisheye"'),
        ("fisheye_model", "1"),
        ("camera_model", "KANNALA_BRANDT"),
        ("Camera.type", '"KannalaBrandt8"'),
    ],
)
def test_fisheye_is_read_as_what_it_is(key: str, value: str) -> None:
    camera = read_camera(with_model(key, value), name="c1.model")
    assert camera.projection == "equidistant"
    rays = np.array([[0.0, 0.0, 1.0], [0.4, -0.3, 1.0], [2.0, 1.5, 1.0]])
    still = np.zeros(3)
    expected = cv2.fisheye.projectPoints(rays[None], still, still, MATRIX, np.full(4, 1e-3))[0][0]
    np.testing.assert_allclose(project(camera, rays), expected, atol=1e-9)
    assert "has 5 distortion coefficients" in fault_of(with_model(key, value, 5))


def test_a_pinhole_says_that_it_is_no_fisheye() -> None:
    text = with_model("fisheye_model", "0")
    assert read_camera(text, name="c1.model").projection == "perspective"


def test_name_and_number_of_coefficients_disagree() -> None:
    assert "plumb_bob" in fault_of(with_model("distortion_model", "plumb_bob", 8))


def test_model_of_the_camera_itself_is_no_lens_model() -> None:
    text = with_model("camera_model", "acA1300-60gm")
    assert read_camera(text, name="c1.model").image_size == (400, 300)


ROS = """image_width: 400
image_height: 300
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [421.71, 0, 201.27, 0, 424.68, 155.17, 0, 0, 1]
distortion_model: rational_polynomial
distortion_coefficients:
  rows: 1
  cols: 8
  data: [-0.3691, 0.2223, -0.0002, 0.0001, -0.1047, 0.01, 0.02, 0.03]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""


def test_camera_info_of_ros() -> None:
    camera = read_camera(ROS, name="left.yaml")
    np.testing.assert_array_equal(camera.matrix, MATRIX)
    np.testing.assert_array_equal(camera.distortion, DISTORTION)
    assert "equidistant" in fault_of(ROS.replace("rational_polynomial", "equidistant"))
    wide = ROS.replace("rational_polynomial", "equidistant").replace("cols: 8", "cols: 4")
    camera = read_camera(wide.replace(", -0.1047, 0.01, 0.02, 0.03", ""), name="left.yaml")
    assert camera.projection == "equidistant"


SLIPS = {
    "exchanged": ([201.27, 0, 151.0], [0, 424.68, 199.0], [-0.3, 0.1], "exchanged"),
    "millimetres": ([4.2, 0, 201.27], [0, 4.2, 155.17], [-0.3, 0.1], "millimetres"),
    "MATLAB": ([421.7, 0, 201.27], [0, 424.7, 155.17], [-0.3, 0.1, -0.08, 1e-4, 2e-4], "MATLAB"),
}


@pytest.mark.parametrize(("first", "second", "lens", "said"), SLIPS.values(), ids=SLIPS.keys())
def test_slip_of_hand_in_a_camera(
    first: list[float], second: list[float], lens: list[float], said: str, tmp_path: Path
) -> None:
    """The same words for a file and for a matrix in the manifest."""
    lens = lens + [0.0] * (5 - len(lens))
    matrix = np.array([first, second, [0, 0, 1]])
    assert said in fault_of(opencv_yaml(matrix, np.array(lens)))
    manifest = replaced(
        MANIFEST, "[[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]", str(matrix.tolist())
    )
    manifest = replaced(manifest, "[-0.3691, 0.2223, -0.0002, 0.0001, -0.1047]", str(lens))
    assert_problem(problems_of(write_dataset(tmp_path, manifest)), "[cameras.c1]", said)


def test_order_of_coefficients_is_doubted_where_it_may_be_meant(tmp_path: Path) -> None:
    lens = "[-0.3691, 0.2223, 0.0, -0.0002, 0.0001]"
    manifest = replaced(MANIFEST, "[-0.3691, 0.2223, -0.0002, 0.0001, -0.1047]", lens)
    (doubt,) = (w for w in load_dataset(write_dataset(tmp_path, manifest)).warnings if "k3" in w)
    assert "MATLAB" in doubt


def test_yaml_without_finite_numbers() -> None:
    assert "'camera_matrix' is not a matrix of finite" in fault_of(opencv_yaml(MATRIX * np.nan))


def test_yaml_of_another_kind() -> None:
    assert "neither" in fault_of("image_width: 400\nmatrix:\n  rows: 3\n")


def test_six_distortion_coefficients_are_none_of_opencvs() -> None:
    assert "6 distortion coefficients" in fault_of(opencv_yaml(MATRIX, np.zeros(6)))


def test_models_of_a_dataset(tmp_path: Path) -> None:
    manifest = replaced(
        MANIFEST,
        "matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]\n"
        "distortion = [-0.3691, 0.2223, -0.0002, 0.0001, -0.1047]\n",
        'model = "models/c1.cameramodel"\n[cameras.c2]\nmodel = "models/c2.yml"\n',
    )
    files = {"models___c1__cameramodel": MRCAL, "models___c2__yml": opencv_yaml()}
    dataset = load_dataset(write_dataset(tmp_path, manifest, **files))
    for name in ("c1", "c2"):
        camera = given_camera(dataset, name)
        assert camera is not None
        np.testing.assert_array_equal(camera.matrix, MATRIX)
    (tmp_path / "models" / "c2.yml").write_text("nothing")
    assert_problem(problems_of(tmp_path), "models/c2.yml", "neither a mrcal")
