"""The rig as Python has it.

Evidence: independent computation (central differences of the law of depth, as written out in
tests/cli/test_measure.py), and equality with the command line.
"""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.cli.main import main

NAMES = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"]
VALUES = np.array([120.0, 0.01, -20.0, 3.0])
COVARIANCE = np.array([
    [1.0, 1e-4, 0.3, -0.8],
    [1e-4, 4e-8, 1e-4, -1e-4],
    [0.3, 1e-4, 2.0, -0.5],
    [-0.8, -1e-4, -0.5, 1.5],
])  # fmt: skip
U_X, U_ALPHA = 2e-4, 1e-4
SPREAD = {"normal": 0.0, "width": 0.0}


def document() -> dict[str, Any]:
    """Return a calibration.json with two models, beside each other with equal weight."""
    reading = {
        "x1c": SPREAD, "y1c": SPREAD, "alpha2_rad": SPREAD, "gaze_residual_rad": SPREAD,
    }  # fmt: skip
    return {
        "format": 1,
        "measurement": {
            "model": "axis-offset", "names": NAMES, "values": VALUES.tolist(),
            "covariance": COVARIANCE.tolist(), "reading": reading,
            "stated": {"u_x1c": U_X, "encoder_step_rad": 0.0, "u_alpha2_rad": U_ALPHA},
            "noise_factor": 1.0, "calibrated_depth_mm": [500.0, 1500.0], "factor95": 1.96,
        },
        "intrinsics": {
            "c1": {
                "matrix": [[800.0, 0, 320.5], [0, 810.0, 240.25], [0, 0, 1]],
                "distortion": [], "image_size": [640, 480],
            },
        },
    }  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document()))
    return path


def position(inputs: np.ndarray) -> np.ndarray:
    """Return x, y, z, mm, by z (x + cot a) = L_b + Z_a cot a + e / sin a."""
    baseline, delta2, axis_z, eccentricity, x, y, reading = inputs
    a = reading + delta2
    cot = np.cos(a) / np.sin(a)
    z = (baseline + axis_z * cot + eccentricity / np.sin(a)) / (x + cot)
    return np.array([x * z, y * z, z])


def test_positions_with_their_covariance(file: Path) -> None:
    x, y, degrees = np.array([0.05, -0.1]), np.array([0.1, -0.05]), np.array([87.0, 80.5])
    points = calib.load(file).measure(x1c=x, y1c=y, alpha2_deg=degrees)
    steps = np.array([1e-3, 1e-6, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6])
    own = np.diag([U_X**2, U_X**2, U_ALPHA**2])
    inputs = np.zeros((7, 7))
    inputs[:4, :4], inputs[4:, 4:] = COVARIANCE, own
    for i in range(2):
        at = np.array([*VALUES, x[i], y[i], np.deg2rad(degrees[i])])
        np.testing.assert_allclose(points.xyz_mm[i], position(at), rtol=1e-12)
        slope = np.column_stack([
            (position(at + s * e) - position(at - s * e)) / (2 * s)
            for s, e in zip(steps, np.eye(7), strict=True)
        ])  # fmt: skip
        covariance = slope @ inputs @ slope.T
        np.testing.assert_allclose(
            points.covariance_mm2[i], covariance, rtol=1e-5, atol=1e-9 * covariance.max()
        )
        u = np.sqrt(np.diagonal(covariance))
        np.testing.assert_allclose(points.std_mm[i], u, rtol=1e-6)


def test_same_as_the_command(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = file.parent / "t.csv"
    table.write_text(
        "id,u1_px,v1_px,alpha2_deg\na,400,300,87\nb,100,80.25,80.5\nc,700,1,88\nd,330,90,120\n"
        "e,350,90,89\n"
    )
    assert main(["measure", str(file), str(table)]) == 3
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    points = calib.load(file).measure(
        u1_px=[400, 100, 700, 330, 350],
        v1_px=[300, 80.25, 1, 90, 90],
        alpha2_deg=[87, 80.5, 88, 120, 89],
    )
    assert points.status == tuple(row["status"] for row in rows)
    assert points.valid.tolist() == [bool(row["z_mm"]) for row in rows]
    assert points.extrapolated.tolist() == [row["extrapolated"] == "yes" for row in rows]
    for i, row in enumerate(rows):
        for name, value in (
            ("x_mm", points.xyz_mm[i, 0]), ("z_mm", points.xyz_mm[i, 2]),
            ("u_z_mm", points.std_mm[i, 2]), ("z_low95_mm", points.low95_mm[i]),
        ):  # fmt: skip
            assert row[name] == ("" if np.isnan(value) else f"{value:.4f}")


def test_many_readings_are_measured_as_few(file: Path) -> None:
    """Property: blocks do not show, in positions and lengths across them."""
    rng = np.random.default_rng(3)
    x, a = rng.uniform(0.02, 0.1, 20_000), rng.uniform(86, 90, 20_000)
    rig = calib.load(file)
    many = rig.measure(x1c=x, y1c=0.01, alpha2_deg=a)
    ends = [0, 19_999]
    few = rig.measure(x1c=x[ends], y1c=0.01, alpha2_deg=a[ends])
    np.testing.assert_array_equal(many.xyz_mm[ends], few.xyz_mm)
    np.testing.assert_allclose(many.covariance_mm2[ends], few.covariance_mm2, rtol=1e-12)
    assert many.length(0, -1) == pytest.approx(few.length(0, 1), rel=1e-12)


def test_depth_of_another(file: Path) -> None:
    rig = calib.load(file)
    points = rig.measure(x1c=[0.05, 0.15], y1c=[0.1, -0.2], alpha2_deg=[87, 88], depth_of=[0, 0])
    z = points.xyz_mm[0, 2]
    np.testing.assert_allclose(points.xyz_mm[1], [0.15 * z, -0.2 * z, z], rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"x1c": [0.1]}, "give x1c and y1c"),
        ({"x1c": [0.1], "y1c": [0.1], "u1_px": [3]}, "give x1c and y1c"),
        ({"x1c": [0.1, 0.2], "y1c": [0.1, 0.1, 0.1]}, "of one length"),
        ({"x1c": [[0.1]], "y1c": [[0.1]]}, "of one length"),
        ({"x1c": ["a"], "y1c": [0.1]}, "not all readings are numbers"),
        ({"x1c": [0.1], "y1c": [0.1], "depth_of": [1]}, "places go from 0 to 0"),
        ({"x1c": [0.1], "y1c": [0.1], "depth_of": [-1]}, "places go from 0 to 0"),
        ({"x1c": [0.1], "y1c": [0.1], "depth_of": [0.0]}, "places go from 0 to 0"),
        ({"x1c": [0.1], "y1c": [0.1], "model": "base"}, "^model base: no one model"),
    ],
)
def test_wrong_arguments(given: dict[str, Any], said: str, file: Path) -> None:
    with pytest.raises(calib.UsageError, match=said):
        calib.load(file).measure(alpha2_deg=[88.0], **given)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e308, -1e300])
@pytest.mark.parametrize("name", ["x1c", "y1c", "u1_px", "v1_px", "alpha2_deg", "u2_px"])
def test_a_value_that_is_none_spoils_its_own_reading_alone(
    name: str, value: float, file: Path
) -> None:
    """Negative control: a missing y1c passed for 0 mm with its uncertainty, u2_px for gazed at."""
    by_pixel = {"u1_px": [350.0, 300.0], "v1_px": [240.0, 230.0]}
    given: dict[str, list[float]] = {"x1c": [0.1, 0.05], "y1c": [0.1, 0.0]}
    given = by_pixel if name in ("u1_px", "v1_px") else given
    given = given | {"alpha2_deg": [87.0, 87.0]}
    given = given | ({"u2_px": [320.0, 320.0]} if name == "u2_px" else {})
    rig = calib.load(file)
    sound = rig.measure(**given)
    for model in ("selected", "average"):
        if model == "average" and not rig.measuring.shares:
            continue
        points = rig.measure(**(given | {name: [value, given[name][1]]}), model=model)
        assert points.valid.tolist() == [False, bool(sound.valid[1])]
        assert points.status[1] == sound.status[1]
        assert name in points.status[0]
        assert np.isnan(points.covariance_mm2[0]).all()
        assert np.isnan(points.length(0, 1)).all()


def test_what_it_says_of_itself_is_one_line(file: Path) -> None:
    rig = calib.load(file)
    points = rig.measure(x1c=[0.05, np.nan], y1c=0.1, alpha2_deg=87)
    assert repr(rig).startswith("Rig(calibrated from ")
    assert max(len(repr(rig)), len(repr(points))) < 200
    assert repr(points).endswith("1 not measured)")
    with pytest.raises(IndexError, match="no points 0 and 2 among 2"):
        points.length(0, 2)


@pytest.mark.parametrize("degrees", [0.0, 180.0, -5.0, float("nan"), float("inf"), 400.0])
def test_what_is_no_reading_is_not_measured(degrees: float, file: Path) -> None:
    points = calib.load(file).measure(x1c=[0.1, 0.05], y1c=0, alpha2_deg=[degrees, 87])
    assert points.valid.tolist() == [False, True]
    assert np.isnan(points.covariance_mm2[0]).all()


def test_failed_gates_warn(file: Path) -> None:
    gates = [{"name": "residuals", "passed": False, "detail": "noise 7 times as stated"}]
    file.write_text(json.dumps(document() | {"gates": gates}))
    with pytest.warns(calib.FailedGates, match="residuals .noise 7 times"):
        rig = calib.load(file)
    assert rig.failed_gates == ("residuals",)
    assert calib.load(file, accept_failed=True).failed_gates == ("residuals",)


def test_import_is_light() -> None:
    """Property: no library beyond the standard one before a name is used."""
    code = "import sys, calib; print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(re.findall(r"'(\w+)'", done.stdout))
    assert loaded & {"numpy", "scipy", "cv2", "pydantic", "matplotlib", "emcee"} == set()
    assert set(calib.__all__) <= set(dir(calib))


def test_types_from_outside(tmp_path: Path) -> None:
    """Property: a program that uses the package is type-checked against it."""
    program = tmp_path / "program.py"
    program.write_text(
        "import calib\n"
        "rig = calib.load('c.json')\n"
        "points = rig.measure(x1c=[0.1], y1c=[0.1], alpha2_deg=[88.0])\n"
        "reveal_type(points.xyz_mm)\n"
        "reveal_type(points.length(0, 1))\n"
        "reveal_type(calib.calibrate('d').passed)\n"
        "rig.measure(x1c=[0.1])\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental", str(program)],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    said = done.stdout
    assert "dtype[floating[_64Bit]]" in said or "float64" in said, said
    assert 'Revealed type is "tuple[float, float]"' in said.replace("builtins.", "")
    assert 'Revealed type is "bool"' in said.replace("builtins.", "")
    assert 'Missing named argument "alpha2_deg"' in said
