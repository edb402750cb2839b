"""On which side C2 stands: what contradicts the manifest is told, and the other side named.

Evidence: property; negative controls.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from dataset_examples import GAZE, MANIFEST, assert_problem, problems_of, write_dataset

from calib.dataset.load import load_dataset

LEFT = '[rig]\nc2 = "left"\nserial = "7"\n'
GAZE_LEFT = "\n".join(
    [
        GAZE.splitlines()[0],
        *(
            f"{i},{-float(x):.4f},{y},{180 - float(alpha):.3f},{z}"
            for i, x, y, alpha, z in (line.split(",") for line in GAZE.splitlines()[1:])
        ),
    ]
)
STEREO = """
[cameras.c2]
image_size = [400, 300]
matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]

[stereo]
transform = [[1, 0, 0, {}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def test_a_left_rig_is_read(tmp_path: Path) -> None:
    manifest = MANIFEST + LEFT + STEREO.format(-77)
    dataset = load_dataset(write_dataset(tmp_path, manifest, gaze__csv=GAZE_LEFT))
    assert dataset.manifest.rig.is_left
    assert dataset.manifest.rig.serial == "7"


@pytest.mark.parametrize(
    ("rig", "x", "said"),
    [
        ("", -77, ["X = -77", "+X side", 'c2 = "left" in [rig]', "inverse of OpenCV's"]),
        (LEFT, 77, ["X = 77", "-X side", 'c2 = "right" in [rig]', "inverse of OpenCV's"]),
    ],
)
def test_pose_on_the_other_side(tmp_path: Path, rig: str, x: float, said: list[str]) -> None:
    gaze = GAZE_LEFT if rig else GAZE
    write_dataset(tmp_path, MANIFEST + rig + STEREO.format(x), gaze__csv=gaze)
    assert_problem(problems_of(tmp_path), "dataset.toml", "[stereo] transform", *said)


@pytest.mark.parametrize(("rig", "mean", "other"), [("", -77, "left"), (LEFT, 77, "right")])
def test_prior_on_the_other_side(tmp_path: Path, rig: str, mean: float, other: str) -> None:
    manifest = MANIFEST.replace("[priors]\n", f"[priors]\nbaseline_mm = [{mean}, 5]\n")
    write_dataset(tmp_path, manifest + rig, gaze__csv=GAZE_LEFT if rig else GAZE)
    assert_problem(problems_of(tmp_path), "[priors] baseline_mm", f'c2 = "{other}" in [rig]')


@pytest.mark.parametrize(
    ("rig", "row", "said"),
    [
        ("", "7,-0.7,0.01,120,900", ["below 90", 'c2 = "left" in [rig]']),
        (LEFT, "7,0.7,0.01,60,900", ["above 90", 'c2 = "right" in [rig]']),
    ],
)
def test_lines_of_sight_that_part(tmp_path: Path, rig: str, row: str, said: list[str]) -> None:
    table = (GAZE_LEFT if rig else GAZE).rstrip() + f"\n{row}\n"
    write_dataset(tmp_path, MANIFEST + rig, gaze__csv=table)
    assert_problem(problems_of(tmp_path), "gaze.csv", "line 8 (id 7)", "part by 65", *said)


def test_lines_of_sight_are_judged_for_the_stated_side_in_spite_of_other_faults(
    tmp_path: Path,
) -> None:
    write_dataset(tmp_path, MANIFEST + LEFT + "wrong = 1\n", gaze__csv=GAZE_LEFT)
    (problem,) = problems_of(tmp_path)
    assert "wrong" in problem.what


def test_two_serial_numbers(tmp_path: Path) -> None:
    manifest = MANIFEST.replace("date =", 'serial = "8"\ndate =') + LEFT
    write_dataset(tmp_path, manifest, gaze__csv=GAZE_LEFT)
    assert_problem(problems_of(tmp_path), "[certificate] serial", "'8'", "'7'", "state it once")


def test_an_unknown_side_is_refused(tmp_path: Path) -> None:
    write_dataset(tmp_path, MANIFEST + LEFT.replace("left", "port"), gaze__csv=GAZE_LEFT)
    assert_problem(problems_of(tmp_path), "[rig] c2", "'right' or 'left'")
