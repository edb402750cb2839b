"""Slips of hand in tables and manifest, told where they are made. Evidence: property.

The rows are exact ones of a rig (77 mm baseline), spoilt as a whole, as one spoils a table.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_examples import MANIFEST, assert_problem, problems_of, replaced, write_dataset

from calib.dataset.doubts import grid_step
from calib.dataset.load import load_dataset

BASELINE, STEP = 77.0, 0.05625
X1C = np.array([0.10, 0.26, 0.23, -0.30, -0.25, 0.16, -0.12, 0.02])
Z_MM = np.array([485.0, 610.0, 796.0, 805.0, 1008.0, 998.0, 640.0, 720.0])
ALPHA_DEG = STEP * np.round(np.rad2deg(np.arctan2(1.0, BASELINE / Z_MM - X1C)) / STEP)

Change = Callable[[np.ndarray], np.ndarray]


def same(values: np.ndarray) -> np.ndarray:
    return values


def table(*, x1c: Change = same, alpha: Change = same, z: Change = same) -> str:
    rows = zip(x1c(X1C), alpha(ALPHA_DEG), z(Z_MM), strict=True)
    lines = [f"r{i},{x:.6f},0.01,{a:.8g},{d:.7g}" for i, (x, a, d) in enumerate(rows)]
    return "\n".join(["id,x1c,y1c,alpha2_deg,z_mm", *lines]) + "\n"


def warnings_of(folder: Path, gaze: str, manifest: str = MANIFEST) -> tuple[str, ...]:
    return load_dataset(write_dataset(folder, manifest, gaze__csv=gaze)).warnings


def test_clean_rows_say_nothing(tmp_path: Path) -> None:
    assert warnings_of(tmp_path, table()) == ()


READINGS: dict[str, tuple[Change, list[str]]] = {
    "about 0": (lambda a: a - 90, ["count about 0", "add 90 to each"]),
    "about 0, turned": (lambda a: 90 - a, ["the wrong way round", "90 less the reading"]),
    "turned": (lambda a: 180 - a, ["counts the wrong way round", "180 - alpha2_deg"]),
    "counts": (lambda a: np.round(a / STEP), ["counts", "times resolution_deg, 0.05625"]),
    "counts about 0": (
        lambda a: np.round((a - 90) / STEP), ["about 0", "90 plus them times resolution_deg"]
    ),
    "counts, turned": (
        lambda a: np.round((180 - a) / STEP), ["wrong way", "180 less them times resolution_deg"]
    ),
    "from 90 degrees further": (lambda a: a + 180, ["180 degrees further", "take 180 from"]),
    "milliradians": (lambda a: 1000 * np.deg2rad(a), ["milliradians", "0.0572958"]),
    "radians": (np.deg2rad, ["radians?", "give them in degrees"]),
}  # fmt: skip


@pytest.mark.parametrize(("spoil", "said"), READINGS.values(), ids=READINGS.keys())
def test_readings_of_another_convention_are_one_problem(
    spoil: Change, said: list[str], tmp_path: Path
) -> None:
    problems = problems_of(write_dataset(tmp_path, gaze__csv=table(alpha=spoil)))
    assert_problem(problems, "gaze.csv, column alpha2_deg", *said)
    assert len(problems) == 1


def test_a_single_reading_out_of_range_is_named_by_row(tmp_path: Path) -> None:
    def one(alpha: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(alpha)) == 2, -alpha, alpha)

    problems = problems_of(write_dataset(tmp_path, gaze__csv=table(alpha=one)))
    assert_problem(problems, "gaze.csv, line 4 (id r2)", "outside (0, 180)")


def test_readings_without_depths_are_told_by_their_range(tmp_path: Path) -> None:
    text = table(alpha=lambda a: a - 90).replace("z_mm", "stereo").replace("x1c,y1c", "u1_px,v1_px")
    problems = problems_of(write_dataset(tmp_path, gaze__csv=text))
    assert_problem(problems, "count about 0", "add 90 to each, or give 90 less each")


def test_mirrored_coordinates(tmp_path: Path) -> None:
    problems = problems_of(write_dataset(tmp_path, gaze__csv=table(x1c=np.negative)))
    assert_problem(problems, "gaze.csv", "x1c has the wrong sign", "[rig] c2")


def test_turned_readings_whose_lines_of_sight_meet_are_a_warning(tmp_path: Path) -> None:
    global_x, alpha = X1C / 20, np.rad2deg(np.arctan2(1.0, BASELINE / Z_MM - X1C / 20))
    said = warnings_of(tmp_path, table(x1c=lambda _: global_x, alpha=lambda _: 180 - alpha))
    assert any("counts the wrong way round" in text for text in said), said


def test_gon(tmp_path: Path) -> None:
    (said,) = warnings_of(tmp_path, table(alpha=lambda a: a / 0.9))
    assert "gon" in said
    assert "0.9 times the reading" in said


@pytest.mark.parametrize("factor", [10.0, 25.4])
def test_depths_in_cm_or_inches(factor: float, tmp_path: Path) -> None:
    (said,) = warnings_of(tmp_path, table(z=lambda z: z / factor))
    assert "centimetres or inches?" in said
    assert f"a baseline of {BASELINE / factor:.2g}" in said


@pytest.mark.parametrize(
    ("factor", "unit"), [(10.0, "centimetres"), (25.4, "inches"), (0.1, "tenths of a mm")]
)
def test_depths_against_a_stated_baseline(factor: float, unit: str, tmp_path: Path) -> None:
    manifest = replaced(MANIFEST, "axis_z_mm = [0, 20]", "baseline_mm = [77, 3]")
    (said,) = warnings_of(tmp_path, table(z=lambda z: z / factor), manifest)
    assert f"where 77 mm is stated: {unit}?" in said


def test_per_cent_for_parts(tmp_path: Path) -> None:
    manifest = replaced(MANIFEST, "u_z_rel = 0.002", "u_z_rel = 0.2")
    (said,) = warnings_of(tmp_path, table(), manifest)
    assert said == "[gaze] u_z_rel = 0.2 is 20 % of each depth: if 0.2 % is meant, write 0.002"


def test_resolution_in_radians(tmp_path: Path) -> None:
    step = f"{np.deg2rad(STEP):.6g}"
    manifest = replaced(MANIFEST, "resolution_deg = 0.05625", f"resolution_deg = {step}")
    (said,) = warnings_of(tmp_path, table(), manifest)
    assert "in radians, write 0.05625" in said


def test_rounded_readings(tmp_path: Path) -> None:
    """Property: a step coarser than stated makes depths less certain than they are told to be."""
    (said,) = warnings_of(tmp_path, table(alpha=np.round))
    assert "multiples of 1 degrees" in said
    assert "less certain" in said


def test_grid_step() -> None:
    assert grid_step(np.array([90.0, 90.5, 91.0, 87.5, 80.0, 99.5])) == pytest.approx(0.5)
    assert grid_step(np.array([90.0, 90.5, 91.0])) is None, "too few to tell"
    assert grid_step(np.rad2deg(np.linspace(1.5, 1.7, 9))) is None, "of cotangents: on no grid"


@pytest.mark.parametrize(("first", "remedy"), [("sep=;", "commas"), ("SEP=,", "delete it")])
def test_excel_separator_line(first: str, remedy: str, tmp_path: Path) -> None:
    text = table() if first.endswith(",") else table().replace(",", ";")
    (problem,) = problems_of(write_dataset(tmp_path, gaze__csv=f"{first}\n{text}"))
    assert "gaze.csv, line 1" in problem.where
    assert "line for spreadsheets" in problem.what
    assert remedy in problem.remedy
