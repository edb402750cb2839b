"""Every fault of a manifest is one message that names file, key and remedy.

Evidence: property (the messages are a contract with the user).
"""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest
from dataset_examples import MANIFEST, assert_problem, problems_of, replaced, write_dataset

from calib.dataset.faults import MANIFEST_LIMIT_BYTES, parse_manifest
from tests.call_count import counted_calls

CHARUCO = 'type = "charuco"\ndictionary = "{}"\nmarker_mm = {}'

# What is replaced in a good manifest, by what, and what the message must then say.
FAULTS = {
    "not TOML": ("resolution_deg = 0.05625", "resolution_deg 0.05625", ["line 17", "not TOML"]),
    "decimal comma": ("0.05625", "0,05625", ["line 17", "'resolution_deg = 0,05625'", "point"]),
    "text without quotes": ('"gaze.csv"', "gaze.csv", ["line 20", "quotes"]),
    "Windows path": ('"gaze.csv"', '"data\\gaze.csv"', ["line 20", "not TOML"]),
    "key twice": ('name = "rig"', 'name = "rig"\nname = "rig"', ["line 3", "once"]),
    "no format": ("format = 1\n", "", ["dataset.toml, format", "missing", "add format = 1"]),
    "later format": ("format = 1", "format = 2", ["format (line 1)", "2", "write format = 1"]),
    "unknown section": ("[encoder]", "[encodr]", ["unknown key 'encodr'", "mean 'encoder'"]),
    "unknown key": ("square_mm", "squaremm", ["[board] squaremm (line 9)", "mean 'square_mm'"]),
    "key of another section": (
        "u_x1c = 0.0002",
        "u_alpha2_deg = 0.0",
        ["[gaze] u_alpha2_deg", "belongs in [encoder]"],
    ),
    "missing key": ("columns = 9\n", "", ["[board] columns", "missing", "add columns = 9"]),
    "text for a number": ("0.05625", '"0,05625"', ["[encoder] resolution_deg", "without quotes"]),
    "number for a text": ('name = "rig"', "name = 7", ["name (line 2)", "not a text", "quotes"]),
    "truth value for a number": ("0.05625", "true", ["[encoder] resolution_deg", "not a number"]),
    "fraction for a count": ("columns = 9", "columns = 9.0", ["[board] columns", "write 9"]),
    "value for a section": ("[certificate]", "certificate = 1\n[x]", ["certificate", "unknown"]),
    "list for a section": ("[encoder]", "[[encoder]]", ["[encoder]", "not a table"]),
    "not a number": ("25.0", "nan", ["[board] square_mm (line 9)", "finite"]),
    "infinite": ("[0, 20]", "[0, inf]", ["[priors] axis_z_mm, item 2 (line 26)", "finite"]),
    "negative step": ("0.05625", "-0.05625", ["[encoder] resolution_deg", "out of range", "above"]),
    "step in arc seconds": ("0.05625", "202.5", ["resolution_deg", "arc seconds", "degrees"]),
    "square in metres": ("25.0", "0.025", ["[board] square_mm", "metres", "millimetres"]),
    "origin by name": (
        'z_from = "c1"',
        'z_from = "lens"',
        ["[gaze] z_from", "no place", "ahead_of_c1_mm"],
    ),
    "origin without u": (
        'z_from = "c1"',
        "z_from = { ahead_of_c1_mm = 35.0 }",
        ["[gaze] z_from", "u_mm"],
    ),
    "per cent": ("u_z_rel = 0.002", "u_z_rel = 2", ["[gaze] u_z_rel", "per cent", "0.01"]),
    "per cent of groups": (
        "u_z_rel = 0.002",
        "u_z_group_rel = 2",
        ["[gaze] u_z_group_rel", "per cent", "0.01"],
    ),
    "negative error of groups": (
        "u_z_rel = 0.002",
        "u_z_group_mm = -1",
        ["[gaze] u_z_group_mm", "-1"],
    ),
    "pixels": ("u_x1c = 0.0002", "u_x1c = 0.1", ["[gaze] u_x1c", "pixels", "fx"]),
    "huge number": ("25.0", "1" + 400 * "0", ["[board] square_mm", "1329 bits"]),
    "number beyond Python's digits": ("25.0", 5000 * "9", ["dataset.toml", "characters long"]),
    "board type": ('"chessboard"', '"circles"', ["[board] type", "'chessboard' or 'charuco'"]),
    "charuco without markers": ('"chessboard"', '"charuco"', ["[board]", "needs dictionary"]),
    "unknown dictionary": (
        'type = "chessboard"',
        CHARUCO.format("DICT_5x5_100", 15),
        ["[board]", "DICT_5x5_100", "mean 'DICT_5X5_100'"],
    ),
    "marker larger than square": (
        'type = "chessboard"',
        CHARUCO.format("DICT_5X5_100", 30),
        ["[board]", "marker_mm = 30", "exchanged"],
    ),
    "marker on a chessboard": ("rows = 7", "rows = 7\nlegacy = true", ["[board]", "chessboard"]),
    "no centre": ("columns = 9", 'columns = 8\ntarget = "centre"', ["[board]", "8 x 7", "[column"]),
    "target off the board": ("rows = 7", "rows = 7\ntarget = [9, 0]", ["[9, 0]", "from 0 to 8"]),
    "target in words": ("rows = 7", 'rows = 7\ntarget = "middle"', ["target (line 9)", "'middle'"]),
    "no intrinsics": (
        "matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]\n",
        "",
        ["[cameras.c1]", "exactly one of images, model and matrix"],
    ),
    "two sources of intrinsics": (
        "image_size = [400, 300]",
        'image_size = [400, 300]\nimages = "*.png"',
        ["[cameras.c1]", "images and matrix are given"],
    ),
    "no image size": ("image_size = [400, 300]\n", "", ["[cameras.c1]", "image_size", "width"]),
    "matrix of two rows": (", [0, 0, 1]]", "]", ["matrix, item 3 (line 13)", "missing"]),
    "matrix transposed": (
        "[[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]",
        "[[421.71, 0, 0], [0, 424.68, 0], [201.27, 155.17, 1]]",
        ["[cameras.c1] matrix", "[0, fy, cy]"],
    ),
    "focal length in mm": ("[[421.71, 0", "[[4.2, 0", ["matrix", "millimetres", "pixels"]),
    "principal point outside": ("201.27", "1201.27", ["[cameras.c1]", "outside", "image_size"]),
    "six coefficients": ("-0.1047]", "-0.1047, 0]", ["[cameras.c1]", "6 coefficients", "5, 8"]),
    "unknown parameter": ("axis_z_mm", "axis_zmm", ["[priors] axis_zmm", "mean 'axis_z_mm'"]),
    "prior of one value": ("[0, 20]", "[20]", ["[priors] axis_z_mm, item 2", "missing"]),
    "prior without width": ("[0, 20]", "[0, 0]", ["[priors] axis_z_mm, item 2", "above 0"]),
    "prior that is a number": ("[0, 20]", "20", ["axis_z_mm", "[mean, standard deviation]"]),
    "prior in degrees": (
        "axis_z_mm = [0, 20]",
        "delta2_rad = [0.762, 0.1]",
        ["[priors]", "delta2_rad", "degrees", "radians"],
    ),
    "tolerance in per cent": ("depth_rel = 0.02", "depth_rel = 2", ["depth_rel", "per cent"]),
    "date": ("2026-01-31", '"31.1.2026"', ["[certificate] date", "2026-01-31"]),
    "decision rule": (
        "date = 2026-01-31",
        'decision_rule = "guard"',
        ["[certificate] decision_rule", "'simple' or 'guard-band'"],
    ),
    "humidity": ("date = 2026-01-31", "humidity_percent = 120", ["humidity_percent", "100"]),
    "line break in a name": ('"rig"', '"a\\nb"', ["name (line 2)", "line break"]),
    "control character": ('"A rig"', '"\\u001b[31mred"', ["title (line 3)", "U+001B"]),
    "control character in a key": ('title = "A rig"', '"\\u001b" = 1', ["unknown key '\\x1b'"]),
    "empty name": ('"rig"', '" "', ["name (line 2)", "empty"]),
}


@pytest.mark.parametrize(("old", "new", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_fault_is_named(tmp_path: Path, old: str, new: str, said: list[str]) -> None:
    write_dataset(tmp_path, replaced(MANIFEST, old, new))
    assert_problem(problems_of(tmp_path), "dataset.toml", *said)


STEREO = """
[cameras.c2]
image_size = [400, 300]
matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]

[stereo]
"""
TRANSFORM = "transform = [[{}, 0, 0, {}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, {}]]\n"

STEREO_FAULTS = {
    "nothing": ("alpha2_deg = 87", ["[stereo]", "neither image pairs nor a transform"]),
    "one camera": ('c1 = "a/*.png"\nalpha2_deg = 87', ["[stereo]", "only one of c1 and c2"]),
    "no reading": ('c1 = "a/*.png"\nc2 = "b/*.png"', ["[stereo]", "alpha2_deg is missing"]),
    "reading of 0": (TRANSFORM.format(1, 77, 1) + "alpha2_deg = 0", ["alpha2_deg", "above 0"]),
    "no rotation": (TRANSFORM.format(2, 77, 1), ["[stereo] transform", "no rotation"]),
    "mirrored": (TRANSFORM.format(-1, 77, 1), ["[stereo] transform", "no rotation"]),
    "last row": (TRANSFORM.format(1, 77, 0), ["[stereo] transform", "last row"]),
    "inverse": (TRANSFORM.format(1, -77, 1), ["X = -77", "+X side", "inverse of OpenCV's"]),
    "metres": (TRANSFORM.format(1, 0.077, 1), ["0.077 looks like metres", "millimetres"]),
}


@pytest.mark.parametrize(("section", "said"), STEREO_FAULTS.values(), ids=STEREO_FAULTS.keys())
def test_stereo_fault_is_named(tmp_path: Path, section: str, said: list[str]) -> None:
    write_dataset(tmp_path, MANIFEST + STEREO + section)
    assert_problem(problems_of(tmp_path), "dataset.toml", *said)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", ["format", "missing"]),
        (MANIFEST.encode("utf-16"), ["UTF-16", "UTF-8"]),
        (MANIFEST.replace("A rig", "Prüfstand").encode("latin-1"), ["line 3", "0xFC", "UTF-8"]),
        (b"name = 1\x00", ["NUL", "plain text"]),
        (b"a = " + 3000 * b"[", ["not TOML"]),
        (b'a = """\nb', ["not TOML", "Unterminated string"]),
        (b"#" * (MANIFEST_LIMIT_BYTES + 1), ["larger than 64 KiB"]),
        (b"#" + b"-" * 5000, ["line 1", "5001 characters long"]),
    ],
    ids=["empty", "UTF-16", "Latin-1", "NUL", "nesting", "open string", "64 KiB", "long line"],
)
def test_unreadable_manifest(tmp_path: Path, data: bytes, said: list[str]) -> None:
    write_dataset(tmp_path, data)
    assert_problem(problems_of(tmp_path), "dataset.toml", *said)


def test_manifest_of_50_mb_is_refused_unread(tmp_path: Path) -> None:
    write_dataset(tmp_path, b"")
    with (tmp_path / "dataset.toml").open("wb") as file:
        file.truncate(50_000_000)
    tracemalloc.start()
    (problem,) = problems_of(tmp_path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "larger than 64 KiB" in str(problem)
    assert peak < 1_000_000


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(f"[k{i}." + ".".join(["a"] * 1900) + "]" for i in range(16)),
        "\n".join(f"k{i}." + ".".join(["a"] * 1900) + " = 1" for i in range(16)),
        "\n".join(f"key_{i} = 1" for i in range(5000)),
        ("\n" + " " * 3900) * 16 + "x",
    ],
    ids=["deep headers", "dotted keys", "unknown keys", "blanks"],
)
def test_hostile_manifest_does_not_hang(text: str) -> None:
    """Of each kind the largest that the limits admit; without limits these took minutes."""
    assert len(text) <= MANIFEST_LIMIT_BYTES
    with counted_calls() as count:
        parsed = parse_manifest(text.encode())
    assert parsed.manifest is None
    assert count() < 10 * MANIFEST_LIMIT_BYTES


def test_all_faults_are_listed_together(tmp_path: Path) -> None:
    manifest = MANIFEST.replace("square_mm", "squaremm").replace("0.05625", "-1")
    write_dataset(tmp_path, manifest, gaze__csv="id,x1c\n1,0.1\n")
    problems = problems_of(tmp_path)
    assert_problem(problems, "[board] squaremm")
    assert_problem(problems, "[encoder] resolution_deg")
    assert_problem(problems, "gaze.csv", "alpha2_deg or ctan_alpha2 is missing")
    assert_problem(problems, "gaze.csv", "z_mm or stereo is missing")


def test_many_faults_are_cut_short_with_their_number() -> None:
    parsed = parse_manifest("\n".join(f"key_{i} = 1" for i in range(100)).encode())
    # 100 unknown keys and two missing ones, of which 10 are listed.
    assert len(parsed.problems) == 11
    assert "92 more problems" in str(parsed.problems[-1])
