"""`calib measure` against the formulae, and against files that are not what they should be.

Evidence: independent computation. The expected numbers are the paper's law with the axis offset,
z (x1c + cot a) = L_b + Z_a cot a + e / sin a, and central differences of it; nothing of calib.
"""

from __future__ import annotations

from math import atan, degrees, hypot, radians, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from command import call, process
from given_calibration import (
    COVARIANCE,
    ROUNDING,
    U_X,
    VALUES,
    distorted,
    law,
    numbers,
    reading_std,
    rows_of,
    u_z,
)


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


def test_a_length_with_an_end_beyond_the_calibrated_depths_says_so(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, pairs = tmp_path / "t.csv", tmp_path / "l.csv"
    table.write_text(
        "id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\nb,0.25,-0.05,91\nfar,0.05,0.1,88.5\nnear,0.05,0.1,60\n"
    )
    depths = rows_of(call(capsys, "measure", file, table).out)
    outside = {name for name, row in depths.items() if row["extrapolated"] == "yes"}
    assert outside == {"far", "near"}
    pairs.write_text("id,from,to\nin,a,b\nfirst,far,a\nlast,b,near\nboth,near,far\n")
    found = rows_of(call(capsys, "measure", file, table, "--lengths", pairs).out)
    said = {name: row["status"] for name, row in found.items()}
    assert said == {
        "in": "ok", "first": "extrapolated", "last": "extrapolated", "both": "extrapolated"
    }  # fmt: skip


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


def test_reading_keeps_its_sign(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A negative control of the law above: the printed tangent of eq. (6) is not what is computed.
    table = file.parent / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0.1,80\n")
    z = float(rows_of(call(capsys, "measure", file, table).out)["a"]["z_mm"])
    a = radians(80) + VALUES[1]
    assert abs(z - VALUES[0] / (0.05 + tan(a))) > 100
    assert degrees(atan(1 / (VALUES[0] / z - 0.05))) == pytest.approx(80, abs=2)
