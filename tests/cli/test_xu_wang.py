"""The whole chain on the paper's data, as a user runs it.

Evidence: published (Xu and Wang 2017, doi 10.1177/1729881417715984; values in
tests/published/xu_wang_2017), and what a fit of their Table 1 with the axis offset free yields.
The bounds are those of the rounding in print, or four standard deviations of the estimate.
"""

from __future__ import annotations

import csv
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import DATASETS, Ended, process

from calib.geometry.parameters import vector
from calib.geometry.plane import Gaze, depth

PAPER = DATASETS / "xu-wang-2017"
PUBLISHED = Path(__file__).parents[1] / "published" / "xu_wang_2017"
CENTRES = np.arange(4, 36, 9)
"""The central corners, whose depth the paper measured."""
FILES = ("calibration.json", "results.h5", "run.toml", "report.html")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("xu wang") / "out"


@pytest.fixture(scope="module")
def run(out: Path) -> Ended:
    return process("calibrate", PAPER, "--out", out)


@pytest.fixture(scope="module")
def result(run: Ended, out: Path) -> dict[str, Any]:
    assert run.status == 0, run.err
    document: dict[str, Any] = json.loads((out / "calibration.json").read_text())
    return document


def test_outputs_are_there(result: dict[str, Any], run: Ended, out: Path) -> None:
    assert result["format"] == 1
    for name in FILES:
        assert (out / name).stat().st_size > 500, name
    assert "selected model: axis-offset" in run.out
    assert str(out) in run.out
    assert all(gate["passed"] for gate in result["gates"])
    left = [p for p in out.rglob("*") if p.suffix == ".part"]
    assert not left


def test_linear_calibration_is_the_papers(result: dict[str, Any]) -> None:
    published = tomllib.loads((PUBLISHED / "results.toml").read_text())["calibration"]
    found = result["fits"]["base/linear"]["parameters"]
    # Table 1 is rounded to 0.0001 and 0.1 mm: moving its cells within that moves L_b by 0.06 mm.
    assert found["baseline_mm"]["value"] == pytest.approx(published["baseline_mm"], abs=0.06)
    tangent = np.tan(found["delta2_rad"]["value"])
    assert tangent == pytest.approx(published["tan_delta2"], abs=1e-4)


def test_robust_fit_finds_the_axis_behind(result: dict[str, Any]) -> None:
    fit = result["fits"]["axis-offset/robust"]
    axis = fit["parameters"]["axis_z_mm"]
    assert axis["value"] == pytest.approx(-21, abs=1.5)
    assert fit["sigma_mrad"] < 0.4
    # The base model leaves ten times as much: the offset is in the data, not in the prior.
    assert result["fits"]["base/robust"]["sigma_mrad"] > 2.5
    assert fit["parameters"]["eccentricity_mm"]["identified_by"] == "prior"
    effective = fit["derived"]["effective_baseline_mm"]
    assert abs(effective["value"] - 77.09) < 4 * effective["std"]
    assert result["selected"] == "axis-offset"
    assert any("eccentricity_mm" in text for text in result["warnings"])


def test_posterior_has_converged(result: dict[str, Any]) -> None:
    for model in ("base", "axis-offset"):
        posterior = result["fits"][f"{model}/posterior"]
        assert posterior["converged"]
        for name, found in posterior["parameters"].items():
            assert found["ess"] >= 4000, name
            assert found["rhat"] < 1.01, name
            assert found["q2.5"] < found["q50"] < found["q97.5"]


def test_models_that_the_data_cannot_carry_say_why(result: dict[str, Any]) -> None:
    for model in ("axis-tilt", "encoder"):
        assert "6 rows; 9 are needed" in result["not_fitted"][f"{model}/robust"]


def test_spread_over_one_board(result: dict[str, Any]) -> None:
    first = [row["own_angle_z_mm"] for row in result["validation"] if row["group"] == "1"]
    assert len(first) == 9
    spread = {m: float(np.std([row[m] for row in first], ddof=1)) for m in ("base", "axis-offset")}
    assert spread["axis-offset"] < 2.5
    assert spread["base"] > 8


def table_2() -> tuple[Gaze, dict[str, np.ndarray[Any, Any]]]:
    with (PAPER / "validation.csv").open() as file:
        rows = list(csv.DictReader(file))
    x, y, cot = (np.array([float(r[k]) for r in rows]) for k in ("x1c", "y1c", "ctan_alpha2"))
    with (PUBLISHED / "table2.csv").open() as file:
        printed = list(csv.DictReader(file))
    columns = {
        axis: np.array([float(r[f"proposed_{axis}_mm"] or "nan") for r in printed])
        for axis in "xyz"
    }
    return Gaze(x, y, np.arctan2(1, cot), np.zeros(len(x))), columns


def test_the_papers_parameters_give_its_positions() -> None:
    gaze, printed = table_2()
    assert len(gaze) == 36
    z = depth(vector({"baseline_mm": 77.09, "delta2_rad": float(np.arctan(0.0133))}), gaze)
    # One depth is printed for each board, that of its central corner.
    boards = printed["z"].reshape(4, 9)
    one = boards[np.isfinite(boards)]
    assert len(one) == 4
    assert np.abs(z[CENTRES] - one).max() < 1.8
    every = np.repeat(one, 9)
    assert np.abs(gaze.x1c * every - printed["x"]).max() < 0.2
    assert np.abs(gaze.y1c * every - printed["y"]).max() < 0.2


def test_printed_tangent_of_eq_6_does_not_give_them() -> None:
    # Negative control, and the erratum: with tan(alpha2) as printed no depth comes near.
    gaze, printed = table_2()
    wrong = 77.09 / (np.tan(gaze.alpha2 + np.arctan(0.0133)) + gaze.x1c)
    boards = printed["z"].reshape(4, 9)
    assert np.abs(wrong[CENTRES] - boards[np.isfinite(boards)]).min() > 100


def test_second_run_computes_nothing(result: dict[str, Any], run: Ended, out: Path) -> None:
    before = {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in out.rglob("*") if p.is_file()}
    again = process("calibrate", PAPER, "--out", out)
    assert again.status == 0
    assert again.err == "", "a stage ran"
    assert "up to date" in again.out
    assert again.out.splitlines()[1:] == run.out.splitlines()
    after = {p: (p.stat().st_mtime_ns, p.stat().st_ino) for p in out.rglob("*") if p.is_file()}
    assert after == before
    assert result["selected"] == "axis-offset"


def test_lost_output_is_written_again_without_computing(result: dict[str, Any], out: Path) -> None:
    wanted = (out / "calibration.json").read_bytes()
    (out / "calibration.json").write_bytes(wanted[:100])
    again = process("calibrate", PAPER, "--out", out)
    assert again.status == 0
    assert again.err.split() == ["report"]
    assert (out / "calibration.json").read_bytes() == wanted
    assert result["format"] == 1


def test_same_seed_same_bytes_elsewhere(result: dict[str, Any], out: Path, tmp_path: Path) -> None:
    other = {
        "OPENBLAS_NUM_THREADS": "2",
        "OMP_NUM_THREADS": "2",
        "LC_ALL": "tr_TR.UTF-8",
        "LANG": "tr_TR.UTF-8",
        "TZ": "Asia/Kathmandu",
        "PYTHONHASHSEED": "7",
    }
    again = process("calibrate", PAPER, "--out", tmp_path / "öther place", env=other)
    assert again.status == 0, again.err
    for name in ("calibration.json", "results.h5"):
        assert (tmp_path / "öther place" / name).read_bytes() == (out / name).read_bytes(), name
    assert result["seed"] == 0
