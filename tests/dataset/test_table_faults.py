"""Every fault of a table is one message that names file, line, id, column and remedy.

Evidence: property (the messages are a contract with the user).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from dataset_examples import GAZE, assert_problem, assert_readable, replaced

from calib.core.errors import InputError, Problem
from calib.dataset.cells import NAMED_ROWS
from calib.dataset.readers import read_gaze, read_lengths, read_measurements, read_sweep


def problems_of(
    text: str, read: Callable[..., Any] = read_gaze, name: str = "gaze.csv"
) -> tuple[Problem, ...]:
    with pytest.raises(InputError) as caught:
        read(text, name=name)
    for problem in caught.value.problems:
        assert_readable(problem)
    return caught.value.problems


ROW_2 = "2,0.2635,0.0100,95.006,486.5"

# What is replaced in a good table, by what, and what the message must then say.
FAULTS = {
    "unknown column": ("alpha2_deg", "alpha2deg", ["line 1", "'alpha2deg'", "mean 'alpha2_deg'"]),
    "column in capitals": ("x1c", "X1C", ["line 1", "'X1C'", "mean 'x1c'"]),
    "column of the manifest": ("y1c", "u_x1c", ["line 1", "unknown column 'u_x1c'"]),
    "column twice": ("y1c", "x1c", ["line 1", "'x1c' occurs twice", "rename"]),
    "column without a name": ("y1c", "", ["line 1", "column 3 has no name"]),
    "no id": ("id,", "group,", ["column id is missing"]),
    "no reading": ("alpha2_deg", "z_two_mm", ["column alpha2_deg or ctan_alpha2 is missing"]),
    "no reference": ("z_mm", "z_two_mm", ["column z_mm or stereo is missing"]),
    "no coordinate": ("x1c,y1c", "z_a_mm,z_b_mm", ["column x1c or u1_px or image_c1 is missing"]),
    "y1c alone": ("x1c,y1c", "z_a_mm,y1c", ["x1c", "missing"]),
    "cell too few": (ROW_2, "2,0.2635,0.0100,95.006", ["line 3", "4 cells", "header has 5"]),
    "bare decimal comma": (ROW_2, "2,0.2635,0.0100,95,006,486.5", ["line 3", "6 cells", "comma"]),
    "quoted decimal comma": ("0.2635", '"0,2635"', ["line 3 (id 2), column x1c", "decimal point"]),
    "open quote": ("0.2635", '"0.2635', ["not CSV", "quotation"]),
    "repeated id": (ROW_2, ROW_2.replace("2", "1", 1), ["line 3 (id 1), column id", "in line 2"]),
    "empty id": (ROW_2, ROW_2[1:], ["line 3, column id", "empty"]),
    "formula in an id": (ROW_2, "=cmd|'/C calc'!A0" + ROW_2[1:], ["column id", "formula"]),
    "formula with a sign": (ROW_2, "+A1" + ROW_2[1:], ["column id", "'+A1'", "formula"]),
    "control character in an id": (ROW_2, "\x07" + ROW_2, ["line 3", "column id", "U+0007"]),
    "word for a number": ("486.5", "near", ["line 3 (id 2), column z_mm", "'near'", "485.9"]),
    "unit beside a number": ("486.5", "486.5 mm", ["line 3 (id 2), column z_mm", "'486.5 mm'"]),
    "NaN": ("486.5", "nan", ["line 3 (id 2), column z_mm", "'nan' is not a finite number"]),
    "infinity": ("0.2635", "-inf", ["line 3 (id 2), column x1c", "not a finite number"]),
    "overflow": ("486.5", "1e999", ["line 3 (id 2), column z_mm", "not a finite number"]),
    "underscore": ("486.5", "4_86", ["line 3 (id 2), column z_mm", "not a number"]),
    "foreign digits": ("486.5", "٤٨٦", ["line 3 (id 2), column z_mm", "not a number"]),
    "no coordinate in a row": ("0.2635,0.0100", ",", ["line 3 (id 2)", "none of x1c", "fill one"]),
    "x1c without y1c": ("0.2635,0.0100", "0.2635,", ["line 3 (id 2), column y1c", "empty"]),
    "y1c without x1c": ("0.2635,0.0100", ",0.01", ["line 3 (id 2), column x1c", "empty"]),
    "no reading in a row": ("95.006", "", ["line 3 (id 2)", "none of alpha2_deg"]),
    "no reference in a row": ("486.5", "", ["line 3 (id 2)", "none of z_mm or stereo"]),
    "reading of 0": ("95.006", "0", ["line 3 (id 2), column alpha2_deg", "(0, 180)", "-X"]),
    "reading of 180": ("95.006", "180", ["line 3 (id 2), column alpha2_deg", "(0, 180)"]),
    "depth of 0": ("486.5", "0", ["line 3 (id 2), column z_mm", "0 is not in front of C1"]),
    "negative depth": ("486.5", "-486.5", ["line 3 (id 2), column z_mm", "-486.5"]),
    "one depth in metres": ("486.5", "0.4865", ["line 3 (id 2), column z_mm", "another unit?"]),
    "one depth in um": ("486.5", "486500", ["line 3 (id 2), column z_mm", "another unit?"]),
    "pixels": ("0.2635", "312.4", ["line 3 (id 2), column x1c", "pixels", "u1_px"]),
    "parting lines of sight": ("95.006", "150", ["line 3 (id 2)", "part by 45", "behind"]),
}


@pytest.mark.parametrize(("old", "new", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_fault_is_named(old: str, new: str, said: list[str]) -> None:
    assert_problem(problems_of(replaced(GAZE, old, new)), "gaze.csv", *said)


def scaled(column: int, factor: float) -> str:
    """Return the good table with one column in another unit."""
    header, *rows = GAZE.splitlines()
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[column] = f"{float(row[column]) * factor:.9g}"
    return "\n".join([header, *map(",".join, cells)])


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        (3, 3.14159265 / 180, ["column alpha2_deg", "radians?", "in degrees"]),
        (4, 1e-3, ["column z_mm", "metres?", "millimetres"]),
        (4, 1e3, ["column z_mm", "micrometres?", "millimetres"]),
    ],
)
def test_unit_of_a_whole_column_is_suspected(column: int, factor: float, said: list[str]) -> None:
    (problem,) = problems_of(scaled(column, factor))
    assert_problem((problem,), "gaze.csv", *said)


def test_angle_called_cotangent_is_suspected() -> None:
    problems = problems_of(replaced(GAZE, "alpha2_deg", "ctan_alpha2"))
    assert_problem(problems, "line 2 (id 1), column ctan_alpha2", "angle", "alpha2_deg")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["is empty", "header"]),
        ("\n \n,,\n", ["is empty", "header"]),
        ("id,x1c,y1c,alpha2_deg,z_mm\n\n", ["no rows", "add a row"]),
        (GAZE.split("\n", 1)[1], ["line 1", "numbers", "start with a header: id,"]),
        (GAZE.replace(",", ";").replace(".", ","), ["line 1", "semicolons", "points"]),
        (GAZE.replace(",", "\t"), ["line 1", "tabs", "commas"]),
        ('"' + 200_000 * "a", ["not CSV"]),
    ],
    ids=["empty", "blank", "header only", "no header", "semicolons", "tabs", "endless cell"],
)
def test_no_table(text: str, said: list[str]) -> None:
    assert_problem(problems_of(text), "gaze.csv", *said)


ONE_SOURCE = (
    "id,x1c,y1c,u1_px,v1_px,image_c1,alpha2_deg,ctan_alpha2,z_mm,u_z_mm,stereo,u2_px,image_c2"
)

ROW_FAULTS = {
    "two coordinates": ("1,.1,.1,200,150,,88,,500,,,,", ["x1c and u1_px are given", "give one of"]),
    "image and pixels": ("1,,,200,150,a.png,88,,500,,,,", ["u1_px and image_c1 are given"]),
    "u1 without v1": ("1,,,200,,,88,,500,,,,", ["column v1_px", "is empty", "give both"]),
    "two readings": ("1,.1,.1,,,,88,.03,500,,,,", ["alpha2_deg and ctan_alpha2 are given"]),
    "two references": ("1,.1,.1,,,,88,,500,,p1,,", ["z_mm and stereo are given"]),
    "two residuals": ("1,.1,.1,,,,88,,500,,,200,b.png", ["u2_px and image_c2 are given"]),
    "u_z_mm beside stereo": ("1,.1,.1,,,,88,,,2,p1,,", ["column u_z_mm", "without z_mm"]),
    "negative u_z_mm": ("1,.1,.1,,,,88,,500,-2,,,", ["column u_z_mm", "-2 is negative"]),
    "u_z_mm as large as z_mm": ("1,.1,.1,,,,88,,500,500,,,", ["column u_z_mm", "not smaller"]),
}


@pytest.mark.parametrize(("row", "said"), ROW_FAULTS.values(), ids=ROW_FAULTS.keys())
def test_sources_are_told_apart_row_by_row(row: str, said: list[str]) -> None:
    good = "0,.1,.1,,,,88,,500,,,,"
    (problem,) = problems_of(f"{ONE_SOURCE}\n{good}\n{row}\n")
    assert_problem((problem,), "gaze.csv, line 3 (id 1)", *said)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["1,.1,.1,88,500,9"], ["line 2 (id 1), column depth_row", "'9' is not the id"]),
        (
            ["1,.1,.1,88,500,2", "2,.1,.1,88,500,3", "3,.1,.1,88,500,"],
            ["line 2 (id 1), column depth_row", "'2' takes its own depth from another row"],
        ),
    ],
    ids=["unknown", "chain"],
)
def test_depth_row(rows: list[str], said: list[str]) -> None:
    text = "\n".join(["id,x1c,y1c,alpha2_deg,z_mm,depth_row", *rows])
    assert_problem(problems_of(text), "gaze.csv", *said)


def test_further_reference_out_of_range() -> None:
    text = replaced(GAZE, "y1c", "y1c,z_ruler_mm").replace(",0.0100,", ",0.0100,-5,")
    assert_problem(problems_of(text), "line 2 (id 1), column z_ruler_mm", "-5")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("id,image_c2,alpha2_deg\n1,a.png,88\n", ["column placement is missing"]),
        (
            "id,placement,image_c2,alpha2_deg\n1,p,,88\n",
            ["line 2 (id 1), column image_c2", "empty"],
        ),
        ("id,placement,image_c2,alpha2_deg\n1,p,a.png,\n", ["column alpha2_deg", "empty"]),
        ("id,placement,image_c2,alpha2_deg\n1,p,a.png,190\n", ["column alpha2_deg", "(0, 180)"]),
        ("id,placement,image_c2,alpha2_deg\n1,p,a.png,1.5\n", ["column alpha2_deg", "radians?"]),
        (
            "id,placement,image_c2,alpha2_deg\n1,p,a.png,88\n2,p,a.png,89\n",
            ["line 3 (id 2), column image_c2", "stands in line 2 already", "image of its own"],
        ),
    ],
)
def test_sweep_fault_is_named(text: str, said: list[str]) -> None:
    assert_problem(problems_of(text, read_sweep, "sweep.csv"), "sweep.csv", *said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("id,from,to,length_mm\n1,a,b,500\n", ["column u_length_mm is missing"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,a,500,1\n", ["line 2 (id 1), column to", "same"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,,500,1\n", ["line 2 (id 1), column to", "empty"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,b,,1\n", ["column length_mm", "empty"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,b,-500,1\n", ["column length_mm", "-500"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,b,500,-1\n", ["column u_length_mm", "negative"]),
        ("id,from,to,length_mm,u_length_mm\n1,a,b,1.4,0\n", ["column length_mm", "metres?"]),
    ],
)
def test_length_fault_is_named(text: str, said: list[str]) -> None:
    assert_problem(problems_of(text, read_lengths, "lengths.csv"), "lengths.csv", *said)


def test_measurements_need_height_for_a_position() -> None:
    problems = problems_of("id,x1c,alpha2_deg\n1,0.1,88\n", read_measurements)
    assert_problem(problems, "gaze.csv, column x1c", "no column y1c")


def test_all_faults_of_a_table_are_listed_together() -> None:
    text = GAZE.replace("486.5", "near").replace("95.006", "190").replace("0.0229", "")
    problems = problems_of(text)
    assert_problem(problems, "line 3 (id 2), column z_mm")
    assert_problem(problems, "line 3 (id 2), column alpha2_deg")
    assert_problem(problems, "line 5 (id 4), column x1c")
    assert len(problems) == 3


def test_a_fault_of_all_rows_is_listed_for_a_few_with_their_number() -> None:
    rows = "".join(f"{i},x,0.1,90,500\n" for i in range(1000))
    problems = problems_of("id,x1c,y1c,alpha2_deg,z_mm\n" + rows)
    assert len(problems) == NAMED_ROWS + 1
    assert f"the same in {1000 - NAMED_ROWS} more rows" in problems[-1].what


def test_line_is_counted_as_an_editor_does() -> None:
    """Blank lines and line breaks inside a quoted cell count, as in any editor."""
    text = 'id,group,x1c,y1c,alpha2_deg,z_mm\n\n1,"a\nb",.1,.1,88,500\n2,c,x,.1,88,500\n'
    problems = problems_of(text)
    assert_problem(problems, "line 5 (id 2), column x1c")
    assert_problem(problems, "line 4 (id 1), column group", "line break")
