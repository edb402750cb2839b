"""The intrinsics stage with both backends. Evidence: simulated truth, agreement of independent
tools (mrcal and OpenCV), and negative controls: scenes that must not yield a confident number."""

from __future__ import annotations

from dataclasses import replace

import lens_scenes as scenes
import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError, InputError
from calib.geometry.board import Corners
from calib.geometry.camera import intrinsic_vector
from calib.images.intrinsics.calibrate import Intrinsics, calibrate_intrinsics
from calib.images.intrinsics.gates import LeftOutPictures, intrinsics_gates, orientation_fault

TRUTH = intrinsic_vector(scenes.CAMERA)
FOCAL = 540.0


def calibrate(found: Corners) -> Intrinsics:
    return calibrate_intrinsics(found, scenes.BOARD, camera="c1", seed=0)


@pytest.fixture(scope="module")
def good() -> Intrinsics:
    """Twenty views of a bowed board, one without it, one given twice, one of something else."""
    rng = np.random.default_rng(0)
    pixels = scenes.views(23, rng, warp_mm=(0.5, -0.3)).pixels.copy()
    pixels[3] = np.nan
    pixels[9] = pixels[8]
    pixels[12] += rng.normal(0, 8, (54, 2))
    return calibrate(scenes.corners(pixels))


def test_truth_is_recovered_and_all_gates_pass(good: Intrinsics) -> None:
    assert all(g.passed for g in good.gates), good.gates
    std = np.sqrt(np.diag(good.covariance))
    error = intrinsic_vector(good.camera) - TRUTH
    assert (np.abs(error) < 4 * std).all()
    assert std[0] / FOCAL < 0.002
    assert good.selected.rms_px == pytest.approx(0.05, rel=0.1)


def test_mrcal_is_selected_with_the_simplest_lens_and_solves_the_bow(good: Intrinsics) -> None:
    assert good.selected.backend == "mrcal"
    assert good.selected.lens_model == "LENSMODEL_OPENCV5"
    assert good.selected.board_warp_mm == pytest.approx((0.5, -0.3), abs=0.05)
    assert good.validation.chosen == "plumb-bob"
    assert "by mrcal" in good.selection
    assert {(f.backend, f.lens_model) for f in good.alternatives} >= {
        ("opencv", "plumb-bob"),
        ("mrcal", "LENSMODEL_OPENCV8"),
    }
    assert set(good.model_files) == {"plumb-bob", "rational"}


def test_backends_agree_on_the_same_board_and_not_on_a_flat_one(good: Intrinsics) -> None:
    solved, spline = good.differences[:2]
    assert solved.second == "opencv plumb-bob on mrcal's board"
    assert solved.ratio < 0.3
    assert spline.second == "mrcal splined"
    assert spline.ratio < 2
    flat = next(d for d in good.differences if d.second == "opencv plumb-bob")
    assert flat.rms_px > 10 * solved.rms_px


def test_views_and_detectors_are_accounted_for(good: Intrinsics) -> None:
    assert good.detectors == {"cascade:classic": 22, "none": 1}
    assert good.rejected_views == ("12.png",)
    assert good.selected.rejected == pytest.approx(54, abs=10)
    assert any("in 1 of 23 intrinsic images (03.png)" in w for w in good.warnings)
    assert any("repeats" in w and "09.png" in w for w in good.warnings)
    assert any("12.png contradict the other images" in w for w in good.warnings)
    residuals = next(gate for gate in good.gates if gate.name == "c1-residuals")
    assert residuals.passed
    assert '1 of 23 pictures left out: "12.png"' in residuals.detail
    assert "0.0 % of corners rejected" in residuals.detail
    assert good.uncertainty.std_px.shape == good.differences[0].expected_px.shape
    assert 0.5 < good.coverage.share < 0.9


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No mrcal on this machine."""
    monkeypatch.setenv("CALIB_MRCAL_PYTHON", "/nonexistent/python")


@pytest.mark.usefixtures("alone")
def test_without_mrcal_opencv_goes_on_alone() -> None:
    found = scenes.views(15, np.random.default_rng(2))
    result = calibrate(found)
    assert result.selected.backend == "opencv"
    assert result.mrcal_version is None
    assert any("apt install python3-mrcal" in w for w in result.warnings)
    assert not any(g.name == "c1-backends" for g in result.gates)
    error = intrinsic_vector(result.camera) - TRUTH
    assert (np.abs(error) < 4 * np.sqrt(np.diag(result.covariance))).all()
    again = calibrate(found)
    assert np.array_equal(intrinsic_vector(again.camera), intrinsic_vector(result.camera))


def test_too_few_views_are_refused_with_the_count() -> None:
    pixels = scenes.views(12, np.random.default_rng(3)).pixels
    pixels[5:] = np.nan
    pixels[4] = pixels[0]
    with pytest.raises(InputError, match=r"4 different views of 12, and 6 are needed"):
        calibrate(scenes.corners(pixels))


def parallel(_: np.random.Generator) -> FloatArray:
    return np.eye(3)


def leaning(_: np.random.Generator) -> FloatArray:
    return scenes.tilted(np.random.default_rng(5), low_deg=25, high_deg=25)


def at_one_place(rng: np.random.Generator) -> FloatArray:
    return np.array([10.0, -5, 480]) + rng.normal(0, 2, 3)


def verdict(found: Corners) -> str:
    """What the stage says against a scene: its failed gates, or its refusal."""
    try:
        result = calibrate(found)
    except EstimationError as refusal:
        return str(refusal)
    # Whatever number comes out, it does not claim to be known.
    focal, std = result.camera.matrix[0, 0], np.sqrt(result.covariance[0, 0])
    assert abs(focal - FOCAL) < 4 * std or std > 0.05 * focal
    return "; ".join(f"{g.name}: {g.detail}" for g in result.gates if not g.passed)


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize(
    ("turn", "place", "words"),
    [
        (parallel, scenes.anywhere, "all boards are parallel to the imager"),
        (leaning, scenes.anywhere, "all boards are parallel to each other"),
        (leaning, at_one_place, "at one place in one attitude"),
        (scenes.tilted, at_one_place, "the board stood at one place"),
    ],
    ids=["parallel to the imager", "parallel to each other", "one attitude", "one place"],
)
def test_poor_scenes_are_recognised_and_named(
    turn: scenes.Draw, place: scenes.Draw, words: str
) -> None:
    found = scenes.views(12, np.random.default_rng(4), turn=turn, place=place)
    assert words in verdict(found)


def test_boards_parallel_to_the_imager_are_recognised_with_mrcal_too() -> None:
    found = scenes.views(12, np.random.default_rng(8), turn=parallel)
    assert "all boards are parallel to the imager" in verdict(found)


@pytest.mark.usefixtures("alone")
def test_a_board_that_changes_its_shape_fails_the_residuals() -> None:
    rng = np.random.default_rng(6)
    found = scenes.views(12, rng)
    bad = replace(found, pixels=found.pixels + rng.normal(0, 4, found.pixels.shape))
    assert "c1-residuals" in verdict(bad)


@pytest.mark.parametrize(("out", "passes"), [(0, True), (1, True), (4, True), (5, False)])
def test_a_few_pictures_left_out_fail_no_gate_and_many_do(
    good: Intrinsics, out: int, passes: bool
) -> None:
    """Of twenty pictures; the advice names those that are left out, not columns and rows first."""
    residuals = np.full((20, 54, 2), 0.1)
    residuals[:out] = np.nan
    fit = replace(good.selected, residuals=residuals, rejected=54 * out)
    left_out = LeftOutPictures(tuple(f"{i:02}.png" for i in range(out)), 54 * out)
    gates = intrinsics_gates(
        "c1", fit, good.coverage, good.validation, agreement=None, left_out=left_out
    )
    gate = next(gate for gate in gates if gate.name == "c1-residuals")
    assert gate.passed == passes
    if not passes:
        assert 'write exclude = ["00.png", "01.png"' in gate.detail
        assert "of another camera?" in gate.detail


def test_orientation_fault_tells_the_cases_apart() -> None:
    rng = np.random.default_rng(7)
    poses = np.concatenate([rng.normal(0, 0.3, (10, 3)), rng.normal(0, 100, (10, 3))], axis=1)
    poses[:, 5] += 600
    assert orientation_fault(poses) is None
    poses[:, :3] = rng.normal(0, 0.01, (10, 3))
    assert "parallel to the imager" in str(orientation_fault(poses))
    poses[:, 0] += 0.5
    assert "parallel to each other" in str(orientation_fault(poses))
    poses[:, 3:] = [0, 0, 600]
    assert "one place in one attitude" in str(orientation_fault(poses))


@pytest.mark.slow
def test_stated_uncertainty_covers_the_truth_with_mrcal_too() -> None:
    """Pulls over 24 simulated calibrations of 16 views; the rms of each is known to 14 %."""
    pulls, chosen = [], []
    for seed in range(24):
        result = calibrate(scenes.views(16, np.random.default_rng(100 + seed)))
        std = np.sqrt(np.diag(result.covariance))[:4]
        pulls.append((intrinsic_vector(result.camera)[:4] - TRUTH[:4]) / std)
        chosen.append(result.validation.chosen)
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert (rms > 0.6).all(), rms
    assert (rms < 1.4).all(), rms
    # A larger lens model than the true one is taken in some 2 % of cases.
    assert chosen.count("plumb-bob") >= 21
