"""Pixels that no ray of a lens reaches are named by row. Evidence: property."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.core.errors import InputError
from calib.dataset.load import check_dataset
from calib.dataset.readers import read_gaze
from calib.geometry.camera import Camera, without_ray
from calib.rows.rayless import refuse_rayless

MANIFEST = """\
format = 1
name = "px"
[cameras.c1]
image_size = [640, 480]
matrix = [[300, 0, 320], [0, 300, 240], [0, 0, 1]]
distortion = [-0.4, 0.0, 0, 0]
[cameras.c2]
image_size = [640, 480]
matrix = [[300, 0, 320], [0, 300, 240], [0, 0, 1]]
distortion = [-0.4, 0.0, 0, 0]
[encoder]
resolution_deg = 0.05625
[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = 0.0002
u_z_rel = 0.002
"""

GAZE = """\
id,u1_px,v1_px,alpha2_deg,u2_px,z_mm
1,350,245,86.150,320,485.9
2,400,245,95.006,320,486.5
3,390,245,96.950,320,796.4
4,327,245,85.210,320,805.9
5,325,245,85.859,320,1008.5
6,370,245,94.033,320,998.5
"""

LENS = Camera(np.diag([300.0, 300.0, 1.0]) + np.array([[0, 0, 320], [0, 0, 240], [0, 0, 0]]),
              np.array([-0.4, 0, 0, 0]), (640, 480))  # fmt: skip


def dataset(folder: Path, gaze: str) -> Path:
    (folder / "dataset.toml").write_text(MANIFEST)
    (folder / "gaze.csv").write_text(gaze)
    return folder


def test_good_rows(tmp_path: Path) -> None:
    assert check_dataset(dataset(tmp_path, GAZE)) == ()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("94.033,320", "94.033,639", "column u2_px: 639: the lens of c2 has no ray there"),
        ("6,370,245", "6,10,20", "column u1_px: 10: the lens of c1 has no ray there"),
        ("94.033,320", "94.033,641", "column u2_px: 641 is outside the image of c2"),
        ("6,370,245", "6,370,500", "column v1_px: 500 is outside the image of c1"),
    ],
)
def test_check_names_line_and_id(old: str, new: str, said: str, tmp_path: Path) -> None:
    (problem,) = check_dataset(dataset(tmp_path, GAZE.replace(old, new)))
    assert f"gaze.csv, line 7 (id 6), {said}" in str(problem)


def test_which_pixels_have_no_ray() -> None:
    pixels = np.array([[320, 240], [639, 240], [np.nan, 240], [1, 1]])
    assert without_ray(LENS, pixels).tolist() == [False, True, False, True]


def test_a_run_names_the_rows_of_a_calibrated_lens() -> None:
    """There the lens is known only once its images are solved; many rows are ten, and a number."""
    table = read_gaze(GAZE, name="gaze.csv")
    pixels = np.column_stack([table.u1_px, table.v1_px])
    refuse_rayless(table, LENS, pixels)
    pixels[[2, 5]] = 1.0, 1.0
    with pytest.raises(InputError) as caught:
        refuse_rayless(table, LENS, pixels)
    first, second = caught.value.problems
    assert first.where == "gaze.csv, line 4 (id 3)"
    assert second.where == "gaze.csv, line 7 (id 6)"
    assert "no ray belongs to pixel (1.00, 1.00)" in first.what
