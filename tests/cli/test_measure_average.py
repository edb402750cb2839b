"""`calib measure --model`. Evidence: independent computation, the paper's law and SciPy's roots."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from math import cos, hypot, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import call
from scipy.optimize import brentq
from scipy.stats import norm

FACTOR = {"base": 2.2, "axis-offset": 2.0}
WEIGHT = {"base": 0.4, "axis-offset": 0.6}
VALUES = {"base": [123.0, 0.01], "axis-offset": [120.0, 0.01, -20.0, 3.0]}
STD = {"base": [0.5, 1e-4], "axis-offset": [1.0, 2e-4, 2.0, 1.0]}
U_X1C, U_ALPHA2 = 1e-4, 1e-4
ROUNDING = 0.51e-4


def block(model: str) -> dict[str, Any]:
    names = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"][: len(VALUES[model])]
    return {
        "model": model,
        "names": names,
        "values": VALUES[model],
        "covariance": np.diag(np.square(STD[model])).tolist(),
        "noise_factor": 1.0,
        "factor95": FACTOR[model],
    }


def calibration(selected: str = "base", *, average: bool = True) -> dict[str, Any]:
    spread = {"normal": 0.0, "width": 0.0}
    names = ("x1c", "y1c", "alpha2_rad", "gaze_residual_rad")
    measurement = block(selected) | {
        "reading": dict.fromkeys(names, spread),
        "stated": {"u_x1c": U_X1C, "encoder_step_rad": 0.0, "u_alpha2_rad": U_ALPHA2},
        "calibrated_depth_mm": [500.0, 1500.0],
    }
    if average:
        measurement["average"] = [block(name) | {"weight": w} for name, w in WEIGHT.items()]
    return {"format": 1, "measurement": measurement}


def law(x: float, reading: float, values: list[float]) -> float:
    baseline, delta2, axis_z, eccentricity = (*values, 0.0, 0.0)[:4]
    a = reading + delta2
    return (baseline + axis_z * cos(a) / sin(a) + eccentricity / sin(a)) / (x + cos(a) / sin(a))


def depth(model: str, x: float, reading: float) -> tuple[float, float]:
    """Return z and u(z), mm, by central differences."""
    values, std = VALUES[model], STD[model]
    variance = 0.0
    for i, s in enumerate(std):
        ends = []
        for sign in (1, -1):
            moved = list(values)
            moved[i] += sign * s * 1e-3
            ends.append(law(x, reading, moved))
        variance += ((ends[0] - ends[1]) / 2e-3) ** 2
    by_x = law(x + 1e-7, reading, values) - law(x - 1e-7, reading, values)
    by_a = law(x, reading + 1e-7, values) - law(x, reading - 1e-7, values)
    variance += hypot(by_x * U_X1C, by_a * U_ALPHA2) ** 2 / 4e-14
    return law(x, reading, values), sqrt(variance)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "t.csv"
    path.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,-0.05,-0.05,80.5\n")
    return path


def written(folder: Path, document: dict[str, Any]) -> Path:
    path = folder / "calibration.json"
    path.write_text(json.dumps(document))
    return path


def rows_of(text: str) -> dict[str, dict[str, float]]:
    found = {}
    for row in csv.DictReader(io.StringIO(text)):
        found[row["id"]] = {k: float(v) for k, v in row.items() if k.endswith("_mm")}
    return found


def test_average_is_the_mixture(
    tmp_path: Path, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, calibration())
    ended = call(capsys, "measure", file, table, "--model", "average")
    assert (ended.status, ended.err) == (0, "")
    for name, x, deg in (("a", 0.05, 87), ("b", -0.05, 80.5)):
        each = {model: depth(model, x, radians(deg)) for model in WEIGHT}
        mean = sum(w * each[m][0] for m, w in WEIGHT.items())
        variance = sum(w * (each[m][1] ** 2 + (each[m][0] - mean) ** 2) for m, w in WEIGHT.items())
        got = rows_of(ended.out)[name]
        assert got["z_mm"] == pytest.approx(mean, abs=ROUNDING)
        assert got["x_mm"] == pytest.approx(x * mean, abs=ROUNDING)
        assert got["u_z_mm"] == pytest.approx(sqrt(variance), rel=1e-5, abs=ROUNDING)

        def below(inverse: float, each: dict[str, tuple[float, float]] = each) -> float:
            total = 0.0
            for m, w in WEIGHT.items():
                z, u = each[m]
                total += w * float(norm.cdf((inverse - 1 / z) / (FACTOR[m] / 1.959964 * u / z**2)))
            return total

        near, far = (brentq(lambda v, p=p: below(v) - p, 1e-5, 1e-1) for p in (0.975, 0.025))
        assert got["z_low95_mm"] == pytest.approx(1 / near, rel=1e-6)
        assert got["z_high95_mm"] == pytest.approx(1 / far, rel=1e-6)


def test_any_fitted_model_can_be_asked(
    tmp_path: Path, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, calibration())
    asked = call(capsys, "measure", file, table, "--model", "axis-offset")
    selected = call(capsys, "measure", written(tmp_path, calibration("axis-offset")), table)
    assert asked.status == 0
    assert asked.out == selected.out
    assert rows_of(asked.out)["a"]["z_mm"] == pytest.approx(
        depth("axis-offset", 0.05, radians(87))[0], abs=ROUNDING
    )


def test_selected_model_warns_where_the_others_disagree(
    tmp_path: Path, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = call(capsys, "measure", written(tmp_path, calibration()), table)
    assert ended.status == 0
    assert "base 0.40, axis-offset 0.60" in ended.err
    assert "--model average" in ended.err
    certain = calibration()
    certain["measurement"]["average"][0]["weight"] = 1.0
    certain["measurement"]["average"][1]["weight"] = 0.0
    assert call(capsys, "measure", written(tmp_path, certain), table).err == ""
    assert call(capsys, "measure", written(tmp_path, calibration(average=False)), table).err == ""


def test_lengths_over_all_models(
    tmp_path: Path, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Mean and law of total variance of what each model says."""
    file, pairs = written(tmp_path, calibration()), tmp_path / "lengths.csv"
    pairs.write_text("id,from,to\nl,a,b\n")

    def length(model: str) -> dict[str, float]:
        ended = call(capsys, "measure", file, table, "--lengths", pairs, "--model", model)
        (row,) = csv.DictReader(io.StringIO(ended.out))
        return {k: float(row[k]) for k in ("length_mm", "u_length_mm")}

    each = {model: length(model) for model in WEIGHT}
    mean = sum(w * each[m]["length_mm"] for m, w in WEIGHT.items())
    variance = sum(
        w * (each[m]["u_length_mm"] ** 2 + (each[m]["length_mm"] - mean) ** 2)
        for m, w in WEIGHT.items()
    )
    got = length("average")
    assert got["length_mm"] == pytest.approx(mean, abs=2 * ROUNDING)
    assert got["u_length_mm"] == pytest.approx(sqrt(variance), abs=2 * ROUNDING)


@pytest.mark.parametrize(
    ("model", "average", "words"),
    [
        ("encoder", True, "selected, base, axis-offset"),
        ("average", False, "calibrate again"),
    ],
)
def test_models_that_are_not_there(
    model: str,
    average: bool,
    words: str,
    tmp_path: Path,
    table: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = written(tmp_path, calibration(average=average))
    ended = call(capsys, "measure", file, table, "--model", model)
    assert ended.status == 2
    assert words in ended.err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"weight": 0.7}, "do not add up to 1"),
        ({"names": ["baseline_mm"]}, "do not belong together"),
        ({"with_parameters": [[1.0], [0.0]]}, "do not match"),
    ],
)
def test_damaged_shares_are_refused(
    change: dict[str, Any],
    words: str,
    tmp_path: Path,
    table: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    document = calibration()
    document["measurement"]["average"][0] |= change
    ended = call(capsys, "measure", written(tmp_path, document), table)
    assert ended.status == 2
    assert words in ended.err


def test_measuring_loads_no_library_that_it_does_not_need(tmp_path: Path, table: Path) -> None:
    """One row is answered at once; all models are asked, but only one carries weight."""
    document = calibration("axis-offset")
    for share, weight in zip(document["measurement"]["average"], (1e-9, 1 - 1e-9), strict=True):
        share["weight"] = weight
    code = (
        "import sys; from calib.cli.main import main\n"
        f"assert main(['measure', {str(written(tmp_path, document))!r}, {str(table)!r}]) == 0\n"
        "print('LOADED', *sorted(sys.modules))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split("LOADED")[1].split())
    assert "numpy" in loaded
    assert not loaded & {"scipy", "cv2", "matplotlib", "h5py", "numpy.polynomial"}
