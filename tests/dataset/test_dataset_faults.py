"""Faults between the parts of a dataset, and of its files: each named with its remedy.

Evidence: property (the messages are a contract with the user; nothing outside the folder is read).
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from dataset_examples import (
    GAZE,
    MANIFEST,
    PNG,
    assert_problem,
    problems_of,
    replaced,
    write_dataset,
)

from calib.core.errors import InputError
from calib.dataset.load import check_dataset, load_dataset

IMAGE_CAMERA = '[cameras.c1]\nimage_size = [400, 300]\nimages = "c1/*.png"\n'
GIVEN_CAMERA = MANIFEST[MANIFEST.index("[cameras.c1]") : MANIFEST.index("[encoder]")]
WITH_IMAGES = replaced(MANIFEST, GIVEN_CAMERA, IMAGE_CAMERA)
C2 = GIVEN_CAMERA.replace("c1", "c2")
STEREO = '[stereo]\nc1 = "s/c1/*.png"\nc2 = "s/c2/*.png"\nalpha2_deg = 87\n'


def views(count: int, folder: str = "c1") -> dict[str, bytes]:
    return {f"{folder}___{i:02d}__png": PNG for i in range(count)}


def without(section: str) -> str:
    start = MANIFEST.index(section)
    return MANIFEST[:start] + MANIFEST[MANIFEST.index("\n\n", start) + 2 :]


def section(name: str, table: str) -> str:
    return f'[{name}]\ntable = "{table}"\n'


RETURNS = (
    "id,of,after,alpha2_deg,change_deg,u_change_deg,u_first_deg,time\n"
    "r01,1,2,87.1,0.001,{},0.002,2026-11-27T23:50:31Z\n"
)

PIXELS = "id,u1_px,v1_px,alpha2_deg,z_mm\n" + "".join(
    f"{i},{200 + i},150,87,{500 + i}\n" for i in range(5)
)
IMAGES = "id,image_c1,alpha2_deg,z_mm\n" + "".join(f"{i},a.png,87,{500 + i}\n" for i in range(5))
LENGTHS = "id,from,to,length_mm,u_length_mm\na,1,{},500,1\n"

# Of a dataset: its manifest, its further files, what the message must say.
FAULTS = {
    "no encoder": (without("[encoder]"), {}, ["dataset.toml", "[encoder] is missing", "[gaze]"]),
    "pixels without camera": (
        without("[cameras.c1]"),
        {"gaze__csv": PIXELS},
        ["[cameras.c1] is missing", "u1_px"],
    ),
    "images without board": (
        without("[board]"),
        {"gaze__csv": IMAGES, "a__png": PNG},
        ["[board] is missing", "image_c1"],
    ),
    "column in C2 without camera": (
        MANIFEST,
        {"gaze__csv": replaced(GAZE, "y1c", "u2_px").replace(",0.0100,", ",200,")},
        ["[cameras.c2] is missing", "u2_px"],
    ),
    "sweep without camera": (
        MANIFEST + section("sweep", "sweep.csv"),
        {"sweep__csv": "id,placement,image_c2,alpha2_deg\n1,p,a.png,88\n", "a__png": PNG},
        ["[cameras.c2] is missing", "[sweep]"],
    ),
    "stereo without C2": (MANIFEST + STEREO, {}, ["[cameras.c2] is missing", "[stereo]"]),
    "validation without gaze": (
        without("[gaze]") + section("validation", "gaze.csv"),
        {},
        ["[gaze] is missing", "[validation]"],
    ),
    "nothing to calibrate": (
        without("[gaze]"),
        {},
        ["neither gaze rows nor images", "nothing to calibrate"],
    ),
    "one row": (
        MANIFEST,
        {"gaze__csv": "\n".join(GAZE.splitlines()[:2])},
        ["gaze.csv", "has 1 row;", "needs 5", "add gazes"],
    ),
    "four rows": (
        MANIFEST,
        {"gaze__csv": "\n".join(GAZE.splitlines()[:5])},
        ["gaze.csv", "has 4 rows;", "needs 5"],
    ),
    "five views": (
        WITH_IMAGES,
        views(5),
        ["[cameras.c1] images", "5 images", "6 views at least"],
    ),
    "other ending": (
        WITH_IMAGES,
        {f"c1___{i}__PNG": PNG for i in range(6)},
        ["[cameras.c1] images", "no image matches 'c1/*.png'", ".PNG"],
    ),
    "no folder": (WITH_IMAGES, {}, ["[cameras.c1] images", "no folder 'c1'", "copy"]),
    "empty image": (WITH_IMAGES, views(6) | {"c1___07__png": b""}, ["'c1/07.png' is empty"]),
    "missing image of a row": (
        MANIFEST,
        {"gaze__csv": replaced(IMAGES, "1,a.png", "1,a.pgn"), "a__png": PNG},
        ["gaze.csv, line 3 (id 1), column image_c1", "no file 'a.pgn'", "mean 'a.png'"],
    ),
    "pixel outside": (
        MANIFEST,
        {"gaze__csv": replaced(PIXELS, "202,150", "202,300")},
        ["gaze.csv, line 4 (id 2), column v1_px", "300 is outside", "0 to 299"],
    ),
    "unknown pair": (
        MANIFEST + C2 + STEREO,
        {
            "gaze__csv": replaced(GAZE, "z_mm", "stereo").replace("485.9", "pose-01.png"),
            "s___c1___pose-01__png": PNG,
            "s___c2___pose-01__png": PNG,
        },
        ["gaze.csv, line 2 (id 1), column stereo", "'pose-01.png'", "mean 'pose-01'"],
    ),
    "pair without stereo": (
        MANIFEST,
        {"gaze__csv": replaced(GAZE, "z_mm", "stereo")},
        ["gaze.csv, line 2 (id 1), column stereo", "add [stereo]"],
    ),
    "stems differ": (
        MANIFEST + C2 + STEREO,
        {"s___c1___left01__png": PNG, "s___c2___right01__png": PNG},
        ["[stereo]", "'s/c1/left01.png' and 's/c2/right01.png'", "same name"],
    ),
    "stem twice": (
        MANIFEST + C2 + replaced(STEREO, "s/c1/*.png", "s/*/1.*"),
        {"s___c1___1__png": PNG, "s___c1___1__jpg": PNG, "s___c2___1__png": PNG},
        ["[stereo] c1", "same stem", "rename"],
    ),
    "even board, target unstated": (
        replaced(MANIFEST, "columns = 9", "columns = 8"),
        {"gaze__csv": IMAGES, "a__png": PNG},
        ["[board] target", "8 x 7", "[column, row]"],
    ),
    "unknown end of a length": (
        MANIFEST + section("lengths", "lengths.csv"),
        {"lengths__csv": LENGTHS.format("9")},
        ["lengths.csv, line 2 (id a), column to", "no row '9'"],
    ),
    "ambiguous end of a length": (
        MANIFEST + section("validation", "validation.csv") + section("lengths", "lengths.csv"),
        {"validation__csv": GAZE, "lengths__csv": LENGTHS.format("2")},
        ["lengths.csv, line 2 (id a), column from", "'1' is a gaze row as well as"],
    ),
    "return without uncertainty": (
        MANIFEST + section("returns", "returns.csv"),
        {"returns__csv": RETURNS.format("0")},
        ["returns.csv, line 2 (id r01), column u_change_deg", "is not above 0"],
    ),
    "missing table": (
        replaced(MANIFEST, '"gaze.csv"', '"gaze.CSV"'),
        {},
        ["dataset.toml, [gaze] table", "no file 'gaze.CSV'", "mean 'gaze.csv'"],
    ),
    "table is a folder": (
        replaced(MANIFEST, '"gaze.csv"', '"data"'),
        {"data___gaze__csv": GAZE},
        ["dataset.toml, [gaze] table", "'data' is a folder"],
    ),
    "absolute path": (
        replaced(MANIFEST, '"gaze.csv"', '"/etc/passwd"'),
        {},
        ["[gaze] table", "'/etc/passwd' is an absolute path", "relative"],
    ),
    "path out of the dataset": (
        replaced(MANIFEST, '"gaze.csv"', '"../gaze.csv"'),
        {},
        ["[gaze] table", "'../gaze.csv' leads out of the dataset folder"],
    ),
    "backslashes": (
        replaced(MANIFEST, '"gaze.csv"', "'data\\gaze.csv'"),
        {},
        ["[gaze] table", "backslashes", "write '/'"],
    ),
    "endless file name": (
        replaced(MANIFEST, '"gaze.csv"', f'"{3000 * "x"}"'),
        {},
        ["[gaze] table", "cannot be read", "too long"],
    ),
    "pattern out of the dataset": (
        replaced(WITH_IMAGES, "c1/*.png", "../*/*.png"),
        {},
        ["[cameras.c1] images", "leads out"],
    ),
    "pattern over trees": (
        replaced(WITH_IMAGES, "c1/*.png", "*/*/*/*.png"),
        {},
        ["[cameras.c1] images", "wildcards in more than 2 places"],
    ),
    "pattern of all folders": (
        replaced(WITH_IMAGES, "c1/*.png", "**/*.png"),
        {},
        ["[cameras.c1] images", "'**'"],
    ),
    "pattern of many stars": (
        replaced(WITH_IMAGES, "c1/*.png", "c1/a**.png"),
        {},
        ["[cameras.c1] images", "'**'"],
    ),
    "error of groups without groups": (
        replaced(MANIFEST, "u_z_rel = 0.002", "u_z_group_rel = 0.002"),
        {},
        ["[gaze] u_z_group_rel", "gaze.csv names no groups", "column group"],
    ),
    "the same of validation rows": (
        f"{MANIFEST}\n{section('validation', 'v.csv')}u_z_group_mm = 1\n",
        {"v__csv": GAZE},
        ["[validation] u_z_group_mm", "v.csv names no groups"],
    ),
    "table in Latin-1": (
        MANIFEST,
        {"gaze__csv": GAZE.encode() + "7,0,0,9°,500\n".encode("latin-1")},
        ["gaze.csv, line 8", "0xB0", "UTF-8"],
    ),
    "table in UTF-16": (MANIFEST, {"gaze__csv": GAZE.encode("utf-16")}, ["gaze.csv", "UTF-16"]),
    "table is a picture": (MANIFEST, {"gaze__csv": b"\x00\x01" * 50}, ["gaze.csv", "NUL"]),
    "cache of another board": (
        replaced(MANIFEST, "square_mm", 'corners = "c.vnl"\nsquare_mm'),
        {"c__vnl": "# filename x y level\nc1/1.png 1 2 0\nc1/1.png 2 2 0\n"},
        ["c.vnl", "c1/1.png", "9 x 7"],
    ),
    "cache of images elsewhere": (
        replaced(MANIFEST, "square_mm", 'corners = "c.vnl"\nsquare_mm'),
        {"c__vnl": "/home/me/1.png - - -\n"},
        ["c.vnl", "'/home/me/1.png' is an absolute path", "relative"],
    ),
    "no cache": (
        replaced(MANIFEST, "square_mm", 'corners = "c.vnl"\nsquare_mm'),
        {},
        ["[board] corners", "no file 'c.vnl'"],
    ),
    "image size differs from model": (
        replaced(MANIFEST, GIVEN_CAMERA, IMAGE_CAMERA.replace("images", "model")),
        {
            "c1___*__png": "{'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': [99, 99, 1, 1],"
            " 'imagersize': [4, 3]}"
        },
        ["[cameras.c1] image_size", "(400, 300) differs from (4, 3)"],
    ),
}


@pytest.mark.parametrize(("manifest", "files", "said"), FAULTS.values(), ids=FAULTS.keys())
def test_fault_is_named(
    tmp_path: Path, manifest: str, files: dict[str, str | bytes], said: list[str]
) -> None:
    write_dataset(tmp_path, manifest, **files)
    problems = problems_of(tmp_path)
    assert_problem(problems, *said)
    with pytest.raises(InputError) as caught:
        load_dataset(tmp_path)
    assert caught.value.problems == problems
    assert caught.value.exit_status == 2


def test_symbolic_link_out_of_the_dataset_is_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text(GAZE)
    folder = write_dataset(tmp_path / "rig", WITH_IMAGES, **views(6))
    (folder / "gaze.csv").unlink()
    (folder / "gaze.csv").symlink_to(secret)
    (folder / "c1" / "07.png").symlink_to(secret)
    problems = problems_of(folder)
    assert_problem(problems, "[gaze] table", "'gaze.csv' is a symbolic link that leads out", "copy")
    assert_problem(problems, "[cameras.c1] images", "'c1/07.png' is a symbolic link")


def test_symbolic_link_inside_the_dataset_is_followed(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "rig", data___rows__csv=GAZE)
    (folder / "gaze.csv").unlink()
    (folder / "gaze.csv").symlink_to("data/rows.csv")
    assert load_dataset(folder).gaze is not None


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path)
    (folder / "gaze.csv").unlink()
    (folder / "gaze.csv").symlink_to("other.csv")
    (folder / "other.csv").symlink_to("gaze.csv")
    assert_problem(problems_of(folder), "[gaze] table", "'gaze.csv'")


def test_pipe_is_not_waited_for(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path)
    (folder / "gaze.csv").unlink()
    os.mkfifo(folder / "gaze.csv")
    done = threading.Event()
    found: list[object] = []

    def check() -> None:
        found.extend(check_dataset(folder))
        done.set()

    threading.Thread(target=check, daemon=True).start()
    assert done.wait(10), "reading a pipe hangs"
    assert "neither a file nor a folder" in str(found[0])


def test_unreadable_file_name(tmp_path: Path) -> None:
    """A name that is not UTF-8 could not be written to any report."""
    folder = write_dataset(tmp_path, WITH_IMAGES, **views(6))
    (folder / "c1" / os.fsdecode(b"\xff.png")).write_bytes(PNG)
    assert_problem(problems_of(folder), "[cameras.c1] images", "U+DCFF", "\\udcff.png")


@pytest.mark.parametrize("name", ["nowhere", "a\x00b", 3000 * "x"])
def test_no_folder(tmp_path: Path, name: str) -> None:
    (problem,) = check_dataset(tmp_path / name)
    assert "cannot be opened" in problem.what
    assert "dataset.toml" in problem.remedy


def test_file_instead_of_folder(tmp_path: Path) -> None:
    write_dataset(tmp_path)
    (problem,) = problems_of(tmp_path / "dataset.toml")
    assert "not a dataset folder" in problem.what


def test_folder_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system is asked by a stand-in: the superuser, who may run the tests, may read all."""
    folder = write_dataset(tmp_path)
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert_problem(problems_of(folder), str(folder), "permission denied", "check the permissions")


def test_image_folder_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_dataset(tmp_path, manifest=WITH_IMAGES)
    (folder / "c1").mkdir()

    def refuse(_: Path) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert_problem(problems_of(folder), "images", "no image matches", "check its permissions")


def test_folder_without_manifest(tmp_path: Path) -> None:
    (problem,) = problems_of(tmp_path)
    assert problem.where == str(tmp_path)
    assert "holds no dataset.toml" in problem.what


def test_manifest_that_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").mkdir()
    assert_problem(problems_of(tmp_path), "'dataset.toml' is a folder")


def test_problems_of_all_parts_are_listed_together(tmp_path: Path) -> None:
    manifest = WITH_IMAGES + section("validation", "validation.csv") + section("sweep", "no.csv")
    write_dataset(
        tmp_path,
        manifest,
        gaze__csv=replaced(IMAGES, "503", "-503"),
        validation__csv=replaced(GAZE, "1008.5", "nan"),
        **views(2),
    )
    problems = problems_of(tmp_path)
    assert_problem(problems, "gaze.csv, line 5 (id 3), column z_mm")
    assert_problem(problems, "gaze.csv", "column image_c1", "no file 'a.png'")
    assert_problem(problems, "validation.csv, line 6 (id 5), column z_mm")
    assert_problem(problems, "[sweep] table", "no file 'no.csv'")
    assert_problem(problems, "[cameras.c1] images", "2 images")
    assert_problem(problems, "[cameras.c2] is missing")
