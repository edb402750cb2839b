"""The paper's data and results are in the project as printed.

Evidence: published (Xu and Wang 2017, doi 10.1177/1729881417715984). The numbers checked here by
value are those of the printed tables that would show a slip of rows or columns; what follows from
each other in print is checked for all rows.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.dataset.contents import Dataset, given_camera
from calib.dataset.load import load_dataset
from calib.dataset.tables import GazeTable

PROJECT = Path(__file__).parents[2]
PUBLISHED = PROJECT / "tests" / "published" / "xu_wang_2017"
COUNT_DEG = 0.036
ROUNDING = 0.5e-4
"""Of the tables' four decimals."""


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return load_dataset(PROJECT / "datasets" / "xu-wang-2017")


@pytest.fixture(scope="module")
def validation(dataset: Dataset) -> GazeTable:
    assert dataset.validation is not None
    return dataset.validation


@pytest.fixture(scope="module")
def printed() -> dict[str, FloatArray]:
    """Table 2's results by column, NaN where the paper prints none."""
    with (PUBLISHED / "table2.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    ids = columns.pop("id")
    assert ids == [f"{group}-{corner}" for group in range(1, 5) for corner in range(1, 10)]
    return {name: np.array([float(v or "nan") for v in column]) for name, column in columns.items()}


@pytest.fixture(scope="module")
def results() -> dict[str, object]:
    with (PUBLISHED / "results.toml").open("rb") as file:
        return tomllib.load(file)


def test_table_1(dataset: Dataset) -> None:
    gaze = dataset.gaze
    assert gaze is not None
    np.testing.assert_array_equal(gaze.x1c, [0.1018, 0.2635, 0.2353, 0.0229, 0.0162, 0.1624])
    np.testing.assert_array_equal(gaze.z_mm, [485.9, 486.5, 796.4, 805.9, 1008.5, 998.5])
    cotangents = [0.0673, -0.0876, -0.1219, 0.0838, 0.0724, -0.0705]
    np.testing.assert_allclose(1 / np.tan(gaze.alpha2_rad), cotangents, rtol=1e-12)
    assert np.isnan(gaze.y1c).all()


def test_table_2(validation: GazeTable, printed: dict[str, FloatArray]) -> None:
    assert len(validation) == 36
    last = validation.ids.index("4-9")
    assert (validation.x1c[last], validation.y1c[last]) == (0.0044, 0.0234)
    assert 1 / np.tan(validation.alpha2_rad[last]) == pytest.approx(0.0440, rel=1e-12)
    assert validation.groups == tuple(np.repeat(["1", "2", "3", "4"], 9))
    assert validation.depth_row == tuple(f"{group}-5" for group in validation.groups)
    np.testing.assert_array_equal(validation.z_mm, np.repeat([350, 1020, 1620, 2120], 9))
    np.testing.assert_array_equal(validation.references["stereo"], printed["stereo_z_mm"])
    unseen = np.flatnonzero(np.isnan(validation.references["stereo"]))
    assert [validation.ids[i] for i in unseen] == ["1-1", "1-4", "1-7"]


def test_cameras_and_their_pose(dataset: Dataset) -> None:
    c1, c2 = given_camera(dataset, "c1"), given_camera(dataset, "c2")
    assert c1 is not None
    assert c2 is not None
    np.testing.assert_array_equal(c1.matrix, [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]])
    np.testing.assert_array_equal(c2.matrix, [[422.67, 0, 196.20], [0, 425.58, 145.12], [0, 0, 1]])
    np.testing.assert_array_equal(c1.distortion, [-0.3691, 0.2223, -0.0002, 0.0001, -0.1047])
    np.testing.assert_array_equal(c2.distortion, [-0.3730, 0.2813, 0.0008, 0.0001, -0.2299])
    stereo = dataset.manifest.stereo
    assert stereo is not None
    assert stereo.transform is not None
    np.testing.assert_array_equal(np.array(stereo.transform)[:3, 3], [77.1391, -7.9497, 2.3782])


def test_matrices_belong_to_the_resized_images(dataset: Dataset) -> None:
    """Principal points lie within a few pixels of the centre of 400 x 300, not of 720 x 576."""
    for camera in dataset.cameras.values():
        assert camera.image_size == (400, 300)
        assert np.hypot(*(camera.matrix[:2, 2] - [199.5, 149.5])) < 7
        assert np.hypot(*(camera.matrix[:2, 2] - [359.5, 287.5])) > 200
    assert dataset.warnings == ()


def test_readings_are_whole_counts_of_0_036_degrees(dataset: Dataset) -> None:
    """All readings of both tables are multiples of 0.036 deg within the rounding of the cotangent.

    By chance, 30 readings would be so with a probability below 1e-20: rounding blurs a reading
    by 0.16 counts at most.
    """
    readings = np.unique(np.concatenate([table.alpha2_rad for table in dataset.rows]))
    assert len(readings) == 30
    counts = np.rad2deg(readings) / COUNT_DEG
    rounding = np.rad2deg(ROUNDING * np.sin(readings) ** 2) / COUNT_DEG
    assert np.all(np.abs(counts - np.round(counts)) <= rounding)
    assert dataset.manifest.encoder is not None
    assert dataset.manifest.encoder.resolution_deg == COUNT_DEG


def test_printed_positions_agree_with_printed_coordinates(
    validation: GazeTable, printed: dict[str, FloatArray]
) -> None:
    """Eq. (5), x = x1c z, with the depth printed once a group, as the paper measured it.

    Rounding leaves 0.05 mm of the result and of the depth, and half the coordinate's last digit.
    """
    z = np.repeat(printed["proposed_z_mm"][::9], 9)
    for axis, coordinate in (("x", validation.x1c), ("y", validation.y1c)):
        error = np.abs(printed[f"proposed_{axis}_mm"] - coordinate * z)
        allowed = 0.05 + np.abs(coordinate) * 0.05 + ROUNDING * z
        assert np.all(error <= allowed), (axis, np.array(validation.ids)[error > allowed])


def test_plates_and_calibration(results: dict[str, dict[str, object]]) -> None:
    calibration = results["calibration"]
    assert calibration["baseline_mm"] == 77.09
    angle = np.rad2deg(np.arctan(float(str(calibration["tan_delta2"]))))
    assert angle == pytest.approx(float(str(calibration["delta2_deg"])), abs=5e-4)
    plates = results["plates"]
    assert plates["measured_mm"] == [1207.2, 529.6, 399.3]
    assert plates["actual_mm"] == [1400, 500, 400]


def test_depth_errors_as_printed_and_corrected(
    results: dict[str, dict[str, list[float]]], printed: dict[str, FloatArray]
) -> None:
    error = printed["proposed_z_mm"][::9] / printed["ruler_z_mm"][::9] - 1
    np.testing.assert_allclose(error, results["depth_error_rel"]["corrected"], atol=5e-4)
    slip = results["depth_error_rel"]["printed"]
    assert [i for i in range(4) if abs(error[i] - slip[i]) > 5e-4] == [3]


@pytest.mark.parametrize("number", [0, 1])
def test_worked_examples_follow_from_eqs_10_to_13(
    results: dict[str, list[dict[str, dict[str, float]]]], number: int
) -> None:
    example = results["worked_example"][number]
    given = {name: value for name, value in example.items() if isinstance(value, int | float)}
    z, base, sine = given["z_mm"], given["baseline_mm"], np.sin(np.deg2rad(given["alpha2_deg"]))
    dz = z / base * given["d_baseline_mm"]
    dz += z**2 / base * (given["d_x1c"] + given["d_alpha2_rad"] / sine**2)
    computed = {"dz_mm": dz, "dz_rel": dz / z}
    for axis, coordinate in (("x", given["x1c"]), ("y", given["y1c"])):
        computed[f"d{axis}_mm"] = z * given["d_x1c"] + coordinate * dz
        computed[f"d{axis}_rel"] = computed[f"d{axis}_mm"] / z
    corrected, printed = example["corrected"], example["printed"]
    for name, value in computed.items():
        digits = 5e-5 if name.endswith("_rel") else 5e-2
        assert value == pytest.approx(corrected[name], abs=digits), name
    slips = {name for name in printed if printed[name] != corrected[name]}
    assert slips == (set(printed) if number == 0 else set())
