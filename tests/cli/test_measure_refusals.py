"""`calib measure`: tables and rows that cannot be measured, calibrations that cannot be believed.

Evidence: each fault is named in one line with its place, and spoils nothing else.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from command import call
from given_calibration import VALUES, calibration, rows_of

BAD_TABLES = {
    "no coordinate": ("id,alpha2_deg\na,89\n", ["x1c"]),
    "not UTF-8": ("id,x1c,y1c,alpha2_deg\na,0,0,89\n".encode("utf-16"), ["t.csv", "UTF-8"]),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0", ["t.csv", "UTF-8"]),
    "open header": ('id,x1c,y1c,"alpha2_deg\na,0,0,89\n', ["t.csv, line 1", "quotation mark"]),
    "endless header": ("id,x1c,y1c,alpha2_deg" + 300_000 * ",", ["t.csv, line 1", "longer than"]),
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


SPOILT = {
    "quotation mark not closed": (b'bad,"0.05,0.1,87', "quotation mark"),
    "quotation mark within": (b'bad,"0.05"x,0.1,87', "quotation mark"),
    "other encoding": (b"bad\xe9,0.05,0.1,87", "UTF-8"),
    "NUL": (b"bad,0.05,\0,87", "UTF-8"),
    "endless cell": (b"bad,0.05," + 250_000 * b"1" + b",87", "longer than 100,000 characters"),
    "endless id": (3_000_000 * b"bad", "longer than 100,000 characters"),
    "empty": (b",,,", "is empty"),
}


@pytest.mark.parametrize(("bad", "said"), SPOILT.values(), ids=SPOILT)
def test_a_spoilt_line_is_one_row(
    bad: bytes, said: str, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Negative control: these ended the table, with no row measured."""
    table = file.parent / "t.csv"
    head, good = b"id,x1c,y1c,alpha2_deg\n", b'"5"" plate",0.05,0.1,87\n'
    table.write_bytes(head + good)
    (alone,) = rows_of(call(capsys, "measure", file, table).out).values()
    # What a spreadsheet leaves at the end is no row.
    table.write_bytes(head + good + bad + b"\n" + good + b",,,\n\n,,,")
    ended = call(capsys, "measure", file, table)
    assert ended.status == 3
    first, refused, last = csv.DictReader(io.StringIO(ended.out))
    assert first == last == alone
    assert said in refused["status"]
    assert refused["z_mm"] == ""
    assert bad.startswith(b",") or refused["id"].startswith("bad")
    assert len(ended.err) < 400, "no message repeats an endless id"


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
