"""The whole chain on the paper's data, as a user runs it.

Evidence: published (Xu and Wang 2017, doi 10.1177/1729881417715984; values in
tests/published/xu_wang_2017), and what a fit of their Table 1 with the axis offset free yields.
The bounds are those of the rounding in print, or four standard deviations of the estimate.
"""

from __future__ import annotations

import base64
import csv
import json
import re
import tomllib
from decimal import Decimal
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import DATASETS, Ended, process
from dcc_schema import checked, shares, sources, texts
from lxml import html

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


def test_rows_cannot_tell_baseline_from_eccentricity(result: dict[str, Any]) -> None:
    """Said in words, as warning and beside the numbers; no fault, as depth does not hang on it."""
    told = result["identifiability"]["axis-offset"]
    last = told["combinations"][-1]
    assert "cannot distinguish L_b from e" in last["words"]
    assert any(last["words"] in text for text in result["warnings"])
    assert last["singular_value"] < 1 < told["combinations"][-2]["singular_value"]
    assert told["parameters"]["eccentricity_mm"]["decided_by"] == "prior"
    assert "std_rows_and_sweep" not in told["parameters"]["eccentricity_mm"]
    assert told["correlation"][0][3] < -0.99
    (gate,) = (gate for gate in result["gates"] if gate["name"] == "identified")
    assert gate["passed"]
    assert told["depth_std_rel"] < 0.01
    assert result["identifiability"]["base"]["combinations"][-1]["told_by"] == "rows"


def test_digital_certificate_says_what_the_other_files_say(
    result: dict[str, Any], out: Path
) -> None:
    root = checked((out / "certificate.xml").read_bytes())
    (page,) = texts(root, "dcc:document/dcc:dataBase64")
    assert base64.b64decode(page) == (out / "certificate.html").read_bytes()
    assert texts(root, ".//dcc:coreData/dcc:identifications/dcc:identification/dcc:value") == [
        result["dataset"]["sha256"],
        sha256((out / "calibration.json").read_bytes()).hexdigest(),
        "xu-wang-2017",
    ]
    found = sources(root)
    assert len(found) >= 3
    # Coordinates are given and their lens is not calibrated here: no error is shared.
    assert all(names == {"parameters", "x1c", "α2", "α2, resolution"} for names in found)


@pytest.mark.usefixtures("result")
def test_every_parameter_is_printed_alike_on_terminal_report_and_certificate(
    run: Ended, out: Path
) -> None:
    """One value and one uncertainty of each quantity, rounded alike wherever they stand."""
    cells = {name: _rows_of(out / f"{name}.html") for name in ("report", "certificate")}
    shown = re.findall(r"^  (\w+) +(\S+) \+- (\S+)", run.out, flags=re.MULTILINE)
    assert {name for name, *_ in shown} > {"baseline_mm", "delta2_rad", "effective_baseline_mm"}
    for name, *texts_shown in shown:
        places = 3 if name.endswith("_rad") else 0
        figures = [str(Decimal(text).scaleb(places)) for text in texts_shown]
        assert any(" ± ".join(figures) in row for row in cells["report"]), name
        certified = any(figures == row[2:4] for row in cells["certificate"])
        assert certified is (name != "log_noise_scale"), name


def _rows_of(page: Path) -> list[list[str]]:
    """Return the cells of all rows of all tables of a page, with ASCII signs."""
    rows = html.parse(page).getroot().iter("tr")
    return [[cell.text_content().strip().replace("−", "-") for cell in row] for row in rows]


@pytest.mark.usefixtures("result")
def test_shares_of_the_budget_can_be_read(out: Path) -> None:
    """L_b and e are known to 10 mm each, their sum to 0.4 mm: no share of 70,000 per cent."""
    table = shares(checked((out / "certificate.xml").read_bytes()))
    assert len(table) == 5
    for column in table:
        assert len(column) == 7
        assert all(0 <= share <= 100 for share in column)
        assert sum(column) == pytest.approx(100, abs=0.05 * len(column) + 0.01)


def test_posterior_has_converged(result: dict[str, Any]) -> None:
    for model in ("base", "axis-offset"):
        posterior = result["fits"][f"{model}/posterior"]
        assert posterior["converged"]
        for name, found in posterior["parameters"].items():
            assert found["ess"] >= 4000, name
            assert found["rhat"] < 1.01, name
            assert found["q2.5"] < found["q50"] < found["q97.5"]


def test_average_over_the_models_is_that_of_the_clear_winner(
    result: dict[str, Any], out: Path, tmp_path: Path
) -> None:
    """Property: base has lost by 14 nats, so that the average is axis-offset's own result."""
    shares = {share["model"]: share["weight"] for share in result["measurement"]["average"]}
    assert shares.keys() == {score["model"] for score in result["comparison"]}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["axis-offset"] > 0.99
    for one, all_ in zip(
        result["depth_uncertainty"], result["depth_uncertainty_average"], strict=True
    ):
        # Monte Carlo quantiles beside the closed form: 5 % of an interval's length.
        length = one["high95_mm"] - one["low95_mm"]
        assert all_["mean_mm"] == pytest.approx(one["z_mm"], abs=0.05 * length)
        assert all_["low95_mm"] == pytest.approx(one["low95_mm"], abs=0.05 * length)
        assert all_["high95_mm"] == pytest.approx(one["high95_mm"], abs=0.05 * length)
    table = tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\n")
    found = [
        process("measure", out / "calibration.json", table, "--model", model).out.splitlines()[1]
        for model in ("selected", "axis-offset", "average")
    ]
    depths = [float(line.split(",")[3]) for line in found]
    assert depths[0] == depths[1]
    assert depths[2] == pytest.approx(depths[0], rel=1e-4)


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
    """Also in a batch, which calibrates in processes of its own."""
    other = {
        "OPENBLAS_NUM_THREADS": "2",
        "OMP_NUM_THREADS": "2",
        "LC_ALL": "tr_TR.UTF-8",
        "LANG": "tr_TR.UTF-8",
        "TZ": "Asia/Kathmandu",
        "PYTHONHASHSEED": "7",
    }
    again = process("batch", PAPER, "--out", tmp_path / "öther place", env=other)
    assert again.status == 0, again.err
    there = tmp_path / "öther place" / PAPER.name
    for name in ("calibration.json", "results.h5"):
        assert (there / name).read_bytes() == (out / name).read_bytes(), name
    assert result["seed"] == 0
