"""`calib measure` against the formulae, and against files that are not what they should be.

Evidence: independent computation. The expected numbers are the paper's law with the axis offset,
z (x1c + cot a) = L_b + Z_a cot a + e / sin a, and central differences of it; nothing of calib.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping
from math import atan, cos, degrees, hypot, radians, sin, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import call, process

NAMES = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"]
VALUES = [120.0, 0.01, -20.0, 3.0]
COVARIANCE = [
    [1.0, 1e-4, 0.3, -0.8],
    [1e-4, 4e-8, 1e-4, -1e-4],
    [0.3, 1e-4, 2.0, -0.5],
    [-0.8, -1e-4, -0.5, 1.5],
]
U_X1C, STEP, U_ALPHA2, NOISE = 2e-4, 9.8e-4, 1e-4, 1.25
"""As the manifest states them; the noise factor widens all."""

U_X = NOISE * U_X1C
FX, CX, FY, CY = 800.0, 320.5, 810.0, 240.25
DISTORTION = (-0.21, 0.05, 1e-4, -2e-4, 0.01)


def calibration() -> dict[str, Any]:
    """Return a calibration.json with all that measuring needs, and no more."""
    spread = {"normal": 0.0, "width": 0.0}
    return {
        "format": 1,
        "measurement": {
            "model": "axis-offset",
            "names": NAMES,
            "values": VALUES,
            "covariance": COVARIANCE,
            "reading": {
                "x1c": spread,
                "y1c": spread,
                "alpha2_rad": spread,
                "gaze_residual_rad": spread,
            },
            "stated": {"u_x1c": U_X1C, "encoder_step_rad": STEP, "u_alpha2_rad": U_ALPHA2},
            "noise_factor": NOISE,
            "calibrated_depth_mm": [500.0, 1500.0],
            "factor95": 1.96,
        },
        "intrinsics": {
            name: {
                "matrix": [[FX, 0, CX], [0, FY, CY], [0, 0, 1]],
                "distortion": list(DISTORTION),
                "image_size": [640, 480],
            }
            for name in ("c1", "c2")
        },
    }


def law(x: float, reading: float, values: list[float]) -> float:
    """Return z, mm."""
    baseline, delta2, axis_z, eccentricity = values
    a = reading + delta2
    cot = cos(a) / sin(a)
    return (baseline + axis_z * cot + eccentricity / sin(a)) / (x + cot)


def slope(f: Callable[[float], float], at: float, step: float) -> float:
    return (f(at + step) - f(at - step)) / (2 * step)


def gradient(x: float, reading: float) -> tuple[np.ndarray[Any, Any], float, float]:
    """Return dz by the parameters, by x1c and by the reading."""
    by = []
    for i, step in enumerate((1e-3, 1e-6, 1e-3, 1e-3)):
        at = [0.0] * 4
        at[i] = step
        up = [v + s for v, s in zip(VALUES, at, strict=True)]
        down = [v - s for v, s in zip(VALUES, at, strict=True)]
        by.append((law(x, reading, up) - law(x, reading, down)) / (2 * step))
    by_x = slope(lambda v: law(v, reading, VALUES), x, 1e-6)
    by_reading = slope(lambda v: law(x, v, VALUES), reading, 1e-6)
    return np.array(by), by_x, by_reading


def reading_std() -> float:
    return NOISE * sqrt(U_ALPHA2**2 + STEP**2 / 12)


def u_z(x: float, reading: float) -> float:
    by, by_x, by_reading = gradient(x, reading)
    parameters = float(by @ np.array(COVARIANCE) @ by)
    return sqrt(parameters + (by_x * U_X) ** 2 + (by_reading * reading_std()) ** 2)


def distorted(x: float, y: float) -> tuple[float, float]:
    """Return the pixel of a normalised point (Brown's model as OpenCV documents it)."""
    k1, k2, p1, p2, k3 = DISTORTION
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        FX * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + CX,
        FY * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + CY,
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(calibration()))
    return path


def rows_of(text: str) -> dict[str, dict[str, str]]:
    return {row["id"]: row for row in csv.DictReader(io.StringIO(text))}


def numbers(row: Mapping[str, str], *names: str) -> list[float]:
    return [float(row[name]) for name in names]


# The CSV gives 0.1 um; half of it is the rounding.
ROUNDING = 0.51e-4


def test_positions_and_uncertainties(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,-0.1,-0.05,80.5\nc,0.2,0,95.25\n")
    ended = call(capsys, "measure", file, table)
    assert ended.status == 0
    found = rows_of(ended.out)
    assert list(found) == ["a", "b", "c"]
    for name, x, y, deg in (("a", 0.05, 0.1, 87), ("b", -0.1, -0.05, 80.5), ("c", 0.2, 0, 95.25)):
        reading = radians(deg)
        z, u = law(x, reading, VALUES), u_z(x, reading)
        got = numbers(found[name], "x_mm", "y_mm", "z_mm")
        assert got == pytest.approx([x * z, y * z, z], abs=ROUNDING)
        # Central differences are good to some 1e-7 of the value.
        assert float(found[name]["u_z_mm"]) == pytest.approx(u, rel=1e-6, abs=ROUNDING)
        u_y = hypot(y * u, z * U_X)
        assert float(found[name]["u_y_mm"]) == pytest.approx(u_y, rel=1e-6, abs=ROUNDING)
        # 95 % of inverse depth: it is nearly normal where depth is skewed.
        half = 1.96 * u / z**2
        limits = [1 / (1 / z + half), 1 / (1 / z - half)]
        got = numbers(found[name], "z_low95_mm", "z_high95_mm")
        assert got == pytest.approx(limits, rel=1e-6, abs=ROUNDING)
        assert found[name]["extrapolated"] == ("no" if 500 <= z <= 1500 else "yes")


def test_cotangents_are_readings(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = file.parent / "t.csv"
    table.write_text(f"id,x1c,y1c,ctan_alpha2\na,0.05,0.1,{1 / tan(radians(87)):.15g}\n")
    got = rows_of(call(capsys, "measure", file, table).out)["a"]
    assert float(got["z_mm"]) == pytest.approx(law(0.05, radians(87), VALUES), abs=ROUNDING)


def test_pixels_and_gaze_residual(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x, y, deg, off = 0.12, -0.08, 86.0, 0.004
    u1, v1 = distorted(x, y)
    # The residual is the angle of the undistorted column; on C2's central row only x counts.
    u2, _ = distorted(tan(off), 0.0)
    table = tmp_path / "t.csv"
    table.write_text(
        f"id,u1_px,v1_px,alpha2_deg,u2_px\na,{u1:.9f},{v1:.9f},{deg},{u2:.9f}\n"
        f"b,{u1:.9f},{v1:.9f},{deg},\n"
    )
    found = rows_of(call(capsys, "measure", file, table).out)
    plain, moved = law(x, radians(deg), VALUES), law(x, radians(deg) + off, VALUES)
    # Undistortion is iterated to 1e-9 or so; C2's residual is that of its column alone, in which
    # the lens bends the centre row by 1e-7.
    assert float(found["b"]["z_mm"]) == pytest.approx(plain, rel=1e-6)
    assert float(found["a"]["z_mm"]) == pytest.approx(moved, rel=1e-4)
    assert moved / plain - 1 > 0.01, "the residual matters in this case"


def test_depth_of_another_row(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = file.parent / "t.csv"
    table.write_text(
        "id,x1c,y1c,alpha2_deg,depth_row\ncentre,0.05,0.1,87,centre\ncorner,0.15,-0.2,88,centre\n"
    )
    found = rows_of(call(capsys, "measure", file, table).out)
    z, u = law(0.05, radians(87), VALUES), u_z(0.05, radians(87))
    assert numbers(found["corner"], "x_mm", "y_mm", "z_mm") == pytest.approx(
        [0.15 * z, -0.2 * z, z], abs=ROUNDING
    )
    # x = x1c z with z of another row: its error and the row's own x1c are independent.
    u_x = hypot(0.15 * u, z * U_X)
    assert float(found["corner"]["u_x_mm"]) == pytest.approx(u_x, rel=1e-6, abs=ROUNDING)
    assert found["corner"]["u_z_mm"] == found["centre"]["u_z_mm"]


def test_an_id_of_several_readings_is_no_end_of_a_length_and_no_depth_row(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, pairs = file.parent / "t.csv", file.parent / "l.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\na,0.06,0.1,89\nb,0.25,-0.05,91\n")
    pairs.write_text("id,from,to\np,a,b\nq,b,b2\n")
    ended = call(capsys, "measure", file, table, "--lengths", pairs)
    assert ended.status == 3
    row = rows_of(ended.out)["p"]
    assert row["length_mm"] == ""
    assert row["status"] == "several readings have the id 'a': give each its own"
    table.write_text(
        "id,x1c,y1c,alpha2_deg,depth_row\na,0.05,0.1,87,\na,0.06,0.1,89,\nb,0.25,-0.05,91,a\n"
    )
    found = rows_of(call(capsys, "measure", file, table).out)["b"]
    assert found["z_mm"] == ""
    assert "several rows" in found["status"]


def test_lengths(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, pairs = tmp_path / "t.csv", tmp_path / "l.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,0.25,-0.05,91\n")
    pairs.write_text("id,from,to,length_mm,u_length_mm\np,a,b,200,0.5\nq,b,a,,\n")
    ended = call(capsys, "measure", file, table, "--lengths", pairs)
    assert ended.status == 0, ended.err
    found = rows_of(ended.out)

    def length(values: list[float], errors: list[float]) -> float:
        ax, ay, aa, bx, by, ba = errors
        za = law(0.05 + ax, radians(87) + aa, values)
        zb = law(0.25 + bx, radians(91) + ba, values)
        a = np.array([(0.05 + ax) * za, (0.1 + ay) * za, za])
        b = np.array([(0.25 + bx) * zb, (-0.05 + by) * zb, zb])
        return float(np.linalg.norm(a - b))

    inputs = [*VALUES, *[0.0] * 6]
    steps = [1e-3, 1e-6, 1e-3, 1e-3, *[1e-6] * 6]
    by = []
    for i, step in enumerate(steps):
        ends = []
        for sign in (1, -1):
            moved = list(inputs)
            moved[i] += sign * step
            ends.append(length(moved[:4], moved[4:]))
        by.append((ends[0] - ends[1]) / (2 * step))
    own = [U_X, U_X, reading_std()] * 2
    variance = np.array(by[:4]) @ np.array(COVARIANCE) @ np.array(by[:4])
    variance += sum((d * s) ** 2 for d, s in zip(by[4:], own, strict=True))
    expected = length(VALUES, [0.0] * 6)
    got = numbers(found["p"], "length_mm", "u_length_mm", "reference_mm", "error_mm")
    wanted = [expected, sqrt(float(variance)), 200, expected - 200]
    assert got == pytest.approx(wanted, rel=1e-6, abs=ROUNDING)
    assert found["q"]["length_mm"] == found["p"]["length_mm"]
    assert found["q"]["reference_mm"] == ""


def test_standard_input_and_out(file: Path, tmp_path: Path) -> None:
    table = "id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\n"
    piped = process("measure", file, "-", text=table)
    assert piped.status == 0
    assert float(rows_of(piped.out)["a"]["z_mm"]) == pytest.approx(
        law(0.05, radians(87), VALUES), abs=ROUNDING
    )
    written = process("measure", file, "-", "--out", tmp_path / "out.csv", text=table)
    assert (written.status, written.out) == (0, "")
    assert (tmp_path / "out.csv").read_text() == piped.out
    bad = process("measure", file, "-", text=table + "b,0,0,none\nc,0.05,0.1,87\n")
    assert bad.status == 3
    assert "standard input, line 3 (id b): alpha2_deg 'none'" in bad.err
    assert "1 of 3 rows could not be measured" in bad.err
    rows = rows_of(bad.out)
    assert [rows[name]["status"] for name in "abc"] == [
        "ok",
        "alpha2_deg 'none' is not a number",
        "ok",
    ]
    assert (rows["b"]["z_mm"], rows["c"]["z_mm"]) == ("", rows["a"]["z_mm"])
    strict = process("measure", file, "-", "--strict", text=table + "b,0,0,none\nc,0,0.1,87\n")
    assert strict.status == 2
    assert "line 3 (id b)" in strict.err


BAD_TABLES = {
    "no coordinate": ("id,alpha2_deg\na,89\n", ["x1c"]),
    "not UTF-8": ("id,x1c,y1c,alpha2_deg\n\xe9,0,0,89\n".encode("latin-1"), ["t.csv", "UTF-8"]),
    "a folder": ("folder", ["t.csv", "cannot be read"]),
}


@pytest.mark.parametrize(("text", "said"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_bad_table(
    text: str | bytes,
    said: list[str],
    file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table, out = tmp_path / "t.csv", tmp_path / "out.csv"
    if text == "folder":
        table.mkdir()
    else:
        table.write_bytes(text if isinstance(text, bytes) else text.encode())
    ended = call(capsys, "measure", file, table, "--out", out)
    assert ended.status == 2
    for word in said:
        assert word in ended.err
    assert not out.exists()


GOOD_ROW = "good,{},87"
BAD_ROWS = {
    "rays that part": ("x1c,y1c", "0.05,0.1", "bad,-0.3,0,89", "do not meet"),
    "image": ("x1c,y1c,image_c1", "0.05,0.1,", "bad,,,a.png,89", "takes coordinates"),
    "no coordinate": ("x1c,y1c", "0.05,0.1", "bad,,,89", "none of x1c"),
    "cell too many": ("x1c,y1c", "0.05,0.1", "bad,0,0,89,1", "has 5 cells, the header has 4"),
    "decimal comma": ("x1c,y1c", "0.05,0.1", 'bad,"0,05",0,89', "'0,05'"),
    "radians": ("x1c,y1c", "0.05,0.1", "bad,0.05,0.1,1.5", "radians?"),
    "about 0": ("x1c,y1c", "0.05,0.1", "bad,0.05,0.1,-3", "counted about 0?"),
    "counts": ("x1c,y1c", "0.05,0.1", "bad,0.05,0.1,1547", "times resolution_deg"),
    "outside the picture": (
        "u1_px,v1_px",
        "400,300",
        "bad,700,300,89",
        "outside the picture of c1",
    ),
    "no ray": ("u1_px,v1_px", "400,300", "bad,1e6,300,89", "c1"),
    "no ray of C2": ("u1_px,v1_px,u2_px", "400,300,320", "bad,400,300,1e6,89", "u2_px"),
    "invisible": ("x1c,y1c", "0.05,0.1", "b\u200bad,0,0,89", "U+200B"),
}


@pytest.mark.parametrize(("columns", "cells", "bad", "said"), BAD_ROWS.values(), ids=BAD_ROWS)
def test_one_bad_row_spoils_no_other(
    columns: str, cells: str, bad: str, said: str, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, good = f"id,{columns},alpha2_deg\n", GOOD_ROW.format(cells) + "\n"
    table = file.parent / "t.csv"
    table.write_text(header + good)
    (alone,) = rows_of(call(capsys, "measure", file, table).out).values()
    table.write_text(header + bad + "\n" + good)
    ended = call(capsys, "measure", file, table)
    assert ended.status == 3
    refused, measured = csv.DictReader(io.StringIO(ended.out))
    assert said in refused["status"]
    assert refused["z_mm"] == refused["z_high95_mm"] == refused["extrapolated"] == ""
    assert measured == alone
    assert "line 2 (id " in ended.err
    assert said in ended.err


def test_length_to_nowhere(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, lengths = file.parent / "t.csv", file.parent / "l.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,0.1,0.1,88\n")
    lengths.write_text("id,from,to\np,a,z\nq,a,b\n")
    ended = call(capsys, "measure", file, table, "--lengths", lengths)
    assert ended.status == 3
    rows = rows_of(ended.out)
    assert "'z' is not in the table" in rows["p"]["status"]
    assert (rows["p"]["length_mm"], rows["q"]["status"]) == ("", "ok")


def test_never_more_than_ten_are_named(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = file.parent / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\n" + "".join(f"{i},0,0,x\n" for i in range(5000)))
    ended = call(capsys, "measure", file, table)
    assert ended.status == 3
    assert len(ended.out.splitlines()) == 5001
    assert len(ended.err.splitlines()) == 11
    assert "5000 of 5000 rows could not be measured, the first 10 named above" in ended.err


def test_failed_gates_reach_who_measures(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gates = [
        {"name": "convergence", "passed": True, "detail": "all chains"},
        {"name": "residuals", "passed": False, "detail": "noise 7 times as stated"},
    ]
    file.write_text(json.dumps(calibration() | {"gates": gates}))
    table = file.parent / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,0,0.1,88\n")
    ended = call(capsys, "measure", file, table)
    assert ended.status == 3
    assert "gate residuals FAILED: noise 7 times as stated" in ended.err
    assert "convergence" not in ended.err
    rows = rows_of(ended.out)
    assert float(rows["a"]["z_mm"]) > 0, "the figures still come"
    assert rows["a"]["status"] == "gate failed"
    assert rows["b"]["status"] == "extrapolated, gate failed"
    accepted = call(capsys, "measure", file, table, "--accept-failed")
    assert (accepted.status, accepted.err) == (0, "")
    assert [r["status"] for r in rows_of(accepted.out).values()] == ["ok", "extrapolated"]


WHOLE = json.dumps(calibration())


def changed(path: str, value: Any) -> str:
    """Return a calibration.json with one value changed, by its path with dots."""
    document = json.loads(WHOLE)
    *parents, last = path.split(".")
    at: Any = document
    for key in parents:
        at = at[int(key)] if isinstance(at, list) else at[key]
    if isinstance(at, list):
        at[int(last)] = value
    else:
        at[last] = value
    return json.dumps(document)


DAMAGED = {
    "empty": "",
    "truncated": WHOLE[:-40],
    "not text": b"\x89HDF\r\n\x1a\n\xff",
    "a list": "[1]",
    "a number": "1",
    "no gaze": '{"format": 1}',
    "format 2": changed("format", 2),
    "format as text": changed("format", "1"),
    "format true": changed("format", True),
    "NaN": changed("measurement.values.0", float("nan")),
    "infinity": changed("measurement.covariance.0.0", float("inf")),
    "text for a number": changed("measurement.values.0", "120"),
    "true for a number": changed("measurement.values.0", True),
    "value too few": changed("measurement.values", VALUES[:3]),
    "covariance ragged": changed("measurement.covariance.1", [0.0]),
    "negative variance": changed("measurement.covariance.0.0", -1.0),
    "asymmetric": changed("measurement.covariance.0.1", 0.9),
    "unknown parameter": changed("measurement.names.0", "baseline"),
    "parameter twice": changed("measurement.names.3", "axis_z_mm"),
    "negative spread": changed("measurement.reading.x1c.normal", -1e-4),
    "depths swapped": changed("measurement.calibrated_depth_mm", [1500.0, 500.0]),
    "negative uncertainty": changed("measurement.stated.u_x1c", -1e-4),
    "noise factor of 0": changed("measurement.noise_factor", 0.0),
    "shared errors ragged": changed(
        "measurement.shared", {"names": ["c1.fx"], "factor": [[1.0, 2.0]], "with_parameters": []}
    ),
    "factor of 0": changed("measurement.factor95", 0.0),
    "focal length 0": changed("intrinsics.c1.matrix.0.0", 0.0),
    "three coefficients": changed("intrinsics.c1.distortion", [0.1, 0.1, 0.1]),
    "image of no size": changed("intrinsics.c1.image_size", [0, 480]),
    "a section is a list": changed("measurement", []),
    "nested": "[" * 200_000,
    "nested inside": '{"format": 1, "measurement": ' + '{"a":' * 100_000,
    "digits": '{"format": 1' + "0" * 10_000 + "}",
    "key twice": WHOLE.replace('"values"', '"values": [1, 2, 3, 4], "values"'),
}


@pytest.mark.parametrize("text", DAMAGED.values(), ids=DAMAGED.keys())
def test_damaged_calibration_is_refused(
    text: str | bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table, out = tmp_path / "c.json", tmp_path / "t.csv", tmp_path / "out.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    table.write_text("id,u1_px,v1_px,alpha2_deg\na,400,300,87\n")
    ended = call(capsys, "measure", path, table, "--out", out)
    assert ended.status == 2, ended
    assert ended.err.startswith(f"calib: {path}: ")
    assert len(ended.err) < 400, "one short message"
    assert not out.exists()


def test_huge_calibration_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.json"
    with path.open("wb") as sparse:
        sparse.truncate(10**12)
    ended = call(capsys, "measure", path, tmp_path / "t.csv")
    assert ended.status == 2
    assert "too large" in ended.err


def test_reading_keeps_its_sign(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A negative control of the law above: the printed tangent of eq. (6) is not what is computed.
    table = file.parent / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,80\n")
    z = float(rows_of(call(capsys, "measure", file, table).out)["a"]["z_mm"])
    a = radians(80) + VALUES[1]
    assert abs(z - VALUES[0] / (0.05 + tan(a))) > 100
    assert degrees(atan(1 / (VALUES[0] / z - 0.05))) == pytest.approx(80, abs=2)
