"""Evidence: simulated truth. What is written must load, and agree with truth.json."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.dataset.load import load_dataset
from calib.geometry.board import Board
from calib.geometry.camera import Camera, project
from calib.geometry.parameters import vector
from calib.geometry.plane import Gaze, depth
from calib.images.detection.board import find_chessboard
from calib.simulate.contents import LENGTHS, SimulationOptions
from calib.simulate.dataset import simulate_dataset
from calib.simulate.plan import plan_dataset
from calib.simulate.scene import IntrinsicViews, SweepPlan, invert

TABLES = SimulationOptions(seed=3, model="encoder", rows=12, validation_rows=7)
IMAGES = SimulationOptions(
    seed=4,
    images=True,
    rows=5,
    validation_rows=3,
    image_size=(640, 480),
    views=IntrinsicViews(count=6),
    sweep=SweepPlan(placements=2, images=4),
)


def truth_of(folder: Path) -> Any:
    return json.loads((folder / "truth.json").read_text())


def digest(folder: Path) -> str:
    lump = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        lump.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return lump.hexdigest()


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images") / "made"
    simulate_dataset(folder, IMAGES)
    return folder


@pytest.mark.parametrize("measured", [False, True])
def test_tables_load_and_follow_the_truth(tmp_path: Path, measured: bool) -> None:
    options = replace(TABLES, residual_measured=measured)
    contents = simulate_dataset(tmp_path / "t", options)
    dataset, truth = load_dataset(tmp_path / "t"), truth_of(tmp_path / "t")
    theta = vector(truth["parameters"])
    np.testing.assert_array_equal(theta, contents.rig.theta)
    for name, table in (("gaze", dataset.gaze), ("validation", dataset.validation)):
        assert table is not None
        rows = [truth["rows"][name][i] for i in table.ids]
        true = Gaze(
            *(np.array([r[k] for r in rows]) for k in ("x1c", "y1c", "alpha2_rad")),
            np.array([r["gaze_residual_rad"] for r in rows]),
        )
        z = np.array([r["z_mm"] for r in rows])
        np.testing.assert_allclose(depth(theta, true), z, rtol=1e-9)
        noise = contents.rig.noise
        assert (
            np.abs(table.x1c - true.x1c).max() < 5 * noise.pixel_px / contents.rig.c1.matrix[0, 0]
        )
        assert np.abs(table.alpha2_rad - true.alpha2).max() < 5 * noise.encoder_rad
        assert np.abs(table.z_mm / z - 1).max() < 5 * noise.z_rel
        assert np.isfinite(table.u2_px).all() == measured
        if measured:
            off = (table.u2_px - contents.rig.c2.matrix[0, 2]) / contents.rig.c2.matrix[0, 0]
            step = contents.rig.resolution_rad
            assert np.abs(off).max() < step + 5 * noise.pixel_px / contents.rig.c2.matrix[0, 0]


def test_known_lengths_join_the_true_targets(tmp_path: Path) -> None:
    simulate_dataset(tmp_path / "t", TABLES)
    dataset, truth = load_dataset(tmp_path / "t"), truth_of(tmp_path / "t")
    lengths, places = dataset.lengths, truth["rows"]["validation"]
    assert lengths is not None
    assert len(lengths.ids) == LENGTHS
    for row in (tmp_path / "t" / "lengths.csv").read_text().splitlines()[1:]:
        _, start, end, length, std = row.split(",")
        true = np.subtract(places[start]["point_mm"], places[end]["point_mm"])
        assert abs(float(length) - np.linalg.norm(true)) < 5 * float(std)


def test_outliers_are_named_in_the_truth(tmp_path: Path) -> None:
    simulate_dataset(tmp_path / "t", replace(TABLES, rows=60, outlier_share=0.5))
    rows = truth_of(tmp_path / "t")["rows"]
    share = np.mean([row["outlier"] for row in rows["gaze"].values()])
    assert abs(share - 0.5) < 5 * 0.5 / np.sqrt(60)
    assert not any(row["outlier"] for row in rows["validation"].values())


def test_image_dataset_loads_with_every_part(images: Path) -> None:
    dataset = load_dataset(images)
    assert len(dataset.images["c1"]) == len(dataset.images["c2"]) == 6
    assert dataset.gaze is not None
    assert dataset.gaze.stereo == dataset.gaze.ids
    assert dataset.validation is not None
    assert np.isfinite(dataset.validation.z_mm).all()
    assert dataset.sweep is not None
    assert len(dataset.sweep.ids) == 8
    assert len(truth_of(images)["images"]) == 2 * 6 + 4 * 5 + 2 * 3 + 8


def test_every_image_shows_the_board_where_the_truth_has_it(images: Path) -> None:
    truth = truth_of(images)
    contents = plan_dataset(IMAGES)
    board = contents.board
    errors = []
    for name, entry in truth["images"].items():
        grey = cv2.imread(str(images / name), cv2.IMREAD_UNCHANGED)
        assert grey.shape == (480, 640)
        assert grey.dtype == np.uint8
        given = truth["cameras"][entry["camera"]]
        camera = Camera(np.array(given["matrix"]), np.array(given["distortion"]), (640, 480))
        pose = np.array(entry["pose"])
        points = board.object_points() @ pose[:3, :3].T + pose[:3, 3]
        errors.append(find_chessboard(grey, board).pixels - project(camera, points))
    found = np.isfinite(errors).all(axis=(1, 2))
    assert found.mean() > 0.9
    # A corner of the smallest boards, 11 px a square, is found to 0.1 px; a neighbour is 11 px off.
    assert np.abs(np.array(errors)[found]).max() < 1


def test_gazed_target_is_on_the_centre_column_within_half_a_count(images: Path) -> None:
    truth, contents = truth_of(images), plan_dataset(IMAGES)
    corner = np.append(contents.board.object_points()[contents.board.target_index], 1)
    allowed = truth["encoder"]["resolution_rad"] / 2 + 5 * truth["noise"]["encoder_rad"]
    for folder, rows in truth["rows"].items():
        for name, row in rows.items():
            c1, c2 = (
                np.array(truth["images"][f"{folder}/{c}/{name}.png"]["pose"]) for c in ("c1", "c2")
            )
            np.testing.assert_allclose((c1 @ corner)[:3], row["point_mm"], atol=1e-9)
            x, _, z = (c2 @ corner)[:3]
            # At C2, off the axis by up to a tenth of the distance, a turn looks that much larger.
            assert abs(np.arctan(x / z)) < 1.1 * allowed
            np.testing.assert_allclose(np.array(row["transform_12"]) @ c2, c1, atol=1e-9)


def test_stereo_pairs_share_the_held_pose_and_the_board(images: Path) -> None:
    truth = truth_of(images)
    held = np.array(truth["stereo"]["transform_12"])
    for name in truth["rows"]["gaze"]:
        c1, c2, gazed = (
            np.array(truth["images"][f"{path}/{name}.png"]["pose"])
            for path in ("stereo/c1", "stereo/c2", "gaze/c1")
        )
        np.testing.assert_allclose(held @ c2, c1, atol=1e-9)
        np.testing.assert_array_equal(c1, gazed)


def test_sweep_turns_about_the_axis_in_the_truth(images: Path) -> None:
    truth = truth_of(images)
    axis = truth["yaw_axis_c2"]
    direction, foot = np.array(axis["direction"]), np.array(axis["foot_mm"])
    first, last = (np.array(truth["images"][f"sweep/0-0{i}.png"]["pose"]) for i in (0, 3))
    turn = first @ invert(last)  # carries C2's points at the last reading to those at the first
    np.testing.assert_allclose(turn[:3, :3] @ direction, direction, atol=1e-9)
    np.testing.assert_allclose(turn[:3, :3] @ foot + turn[:3, 3], foot, atol=1e-6)
    angle = np.arccos((np.trace(turn[:3, :3]) - 1) / 2)
    readings = truth["sweep"]["alpha2_rad"][0]
    assert angle == pytest.approx(readings[-1] - readings[0], abs=1e-9)


def test_the_same_seed_gives_the_same_bytes_and_another_another(
    images: Path, tmp_path: Path
) -> None:
    simulate_dataset(tmp_path / "again", IMAGES)
    simulate_dataset(tmp_path / "other", replace(TABLES, seed=5))
    simulate_dataset(tmp_path / "tables", TABLES)
    assert digest(tmp_path / "again") == digest(images)
    assert digest(tmp_path / "other") != digest(tmp_path / "tables")


def test_more_rows_leave_rig_and_views_as_they_were() -> None:
    fewer, more = plan_dataset(IMAGES), plan_dataset(replace(IMAGES, rows=6))
    np.testing.assert_array_equal(fewer.rig.theta, more.rig.theta)
    for a, b in zip(fewer.shots[:12], more.shots[:12], strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)


def test_charuco_dataset_states_its_board(tmp_path: Path) -> None:
    board = Board("charuco", 8, 6, 20.0, (3, 2), "DICT_5X5_100", 14.0, legacy=True)
    simulate_dataset(tmp_path / "c", replace(IMAGES, board=board, validation_rows=0))
    dataset = load_dataset(tmp_path / "c")
    stated = dataset.manifest.board
    assert stated is not None
    assert (stated.type, stated.columns, stated.rows, stated.legacy) == ("charuco", 8, 6, True)
    assert stated.target_corner == (3, 2)
    assert dataset.validation is None


def test_an_occupied_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("kept")
    with pytest.raises(UsageError, match="exists already"):
        simulate_dataset(tmp_path / "out", TABLES)
    with pytest.raises(UsageError, match="exists already"):
        simulate_dataset(tmp_path / "out" / "mine.txt", TABLES)
    assert [p.name for p in tmp_path.rglob("*")] == ["out", "mine.txt"]


def test_an_empty_folder_is_filled(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    simulate_dataset(tmp_path / "out", TABLES)
    assert load_dataset(tmp_path / "out").gaze is not None


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        assert total == 46
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_dataset(tmp_path / "out", IMAGES, progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot write"):
        simulate_dataset(tmp_path / "file" / "out", TABLES)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "bas"}, "unknown model 'bas'"),
        ({"fixed": {"baseline": 1.0}}, "unknown parameter 'baseline'"),
        ({"fixed": {"baseline_mm": -100.0}}, "baseline_mm = -100"),
        ({"fixed": {"eccentricity_mm": 1e6}}, "ask for a smaller eccentricity"),
        ({"fixed": {"axis_z_mm": float("nan")}}, "axis_z_mm = nan is not finite"),
        ({"rows": 0}, "0 gaze rows"),
        ({"outlier_share": 1.5}, "not between 0 and 1"),
        ({"depth_range_mm": (900.0, 300.0)}, "no range"),
        ({"views": IntrinsicViews(count=0)}, "0 intrinsic views"),
        ({"sweep": SweepPlan(images=1)}, "1 images a placement"),
    ],
)
def test_options_that_make_no_dataset_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        plan_dataset(replace(TABLES, **change))
