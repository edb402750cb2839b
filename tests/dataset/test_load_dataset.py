"""What is in a dataset reaches the toolchain unchanged, and its fingerprint covers all of it.

Evidence: property.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from dataset_examples import GAZE, MANIFEST, PNG, assert_problem, png, replaced, write_dataset

from calib.core.errors import InputError
from calib.dataset.faults import parse_manifest
from calib.dataset.folder import by_star
from calib.dataset.load import check_dataset, load_dataset
from calib.dataset.manifest import Manifest
from calib.dataset.readers import read_gaze, read_lengths, read_measurements, read_sweep

GIVEN_CAMERA = MANIFEST[MANIFEST.index("[cameras.c1]") : MANIFEST.index("[encoder]")]

IMAGE_MANIFEST = (
    replaced(
        MANIFEST,
        GIVEN_CAMERA,
        """[cameras.c1]
image_size = [400, 300]
images = "intrinsics/c1/*.png"

[cameras.c2]
image_size = [400, 300]
images = "intrinsics/c2/*.png"

[stereo]
c1 = "stereo/c1/*.png"
c2 = "stereo/c2/*.png"
alpha2_deg = 87.01875

""",
    )
    + '[validation]\ntable = "validation.csv"\nreference = "ruler"\n'
    + '[sweep]\ntable = "sweep.csv"\n[lengths]\ntable = "lengths.csv"\n'
)


def image_dataset(folder: Path, manifest: str = IMAGE_MANIFEST) -> Path:
    images = {f"intrinsics___{c}___{i}__png": PNG for c in ("c1", "c2") for i in range(6)}
    images |= {f"stereo___{c}___p{i}__png": PNG for c in ("c1", "c2") for i in range(5)}
    images |= {f"{name}__png": PNG for name in ("g", "s1", "s2")}
    # A row's picture by C2 is another than that of its pair.
    images["h__png"] = png(data=bytes([0, *[9] * 400]) * 300)
    rows = "".join(f"{i},g.png,{86 + i},h.png,p{i}\n" for i in range(5))
    return write_dataset(
        folder,
        manifest,
        gaze__csv="id,image_c1,alpha2_deg,image_c2,stereo\n" + rows,
        validation__csv=GAZE.replace("\n", "\nv").removesuffix("v"),
        sweep__csv="id,placement,image_c2,alpha2_deg\n1,p,s1.png,80\n2,p,s2.png,90\n",
        lengths__csv="id,from,to,length_mm,u_length_mm\na,v1,v3,420.5,0.2\n",
        **images,
    )


def manifest_of(text: str) -> Manifest:
    parsed = parse_manifest(text.encode())
    assert parsed.problems == ()
    assert parsed.manifest is not None
    return parsed.manifest


def test_table_reaches_the_toolchain_unchanged() -> None:
    table = read_gaze(GAZE, name="gaze.csv")
    assert table.file == "gaze.csv"
    assert table.line == (2, 3, 4, 5, 6, 7)
    assert table.ids == table.groups == ("1", "2", "3", "4", "5", "6")
    np.testing.assert_array_equal(table.x1c, [0.1018, 0.2635, 0.2353, 0.0229, 0.0162, 0.1624])
    np.testing.assert_array_equal(table.y1c, np.full(6, 0.01))
    np.testing.assert_array_equal(table.alpha2_rad[:2], np.deg2rad([86.150, 95.006]))
    np.testing.assert_array_equal(table.z_mm, [485.9, 486.5, 796.4, 805.9, 1008.5, 998.5])
    assert np.isnan([table.u1_px, table.v1_px, table.u2_px, table.u_z_mm]).all()
    assert table.image_c1 == table.image_c2 == table.stereo == table.depth_row == (None,) * 6
    assert table.references == {}


def test_sources_may_change_from_row_to_row() -> None:
    table = read_gaze(
        "id,group,x1c,y1c,u1_px,v1_px,image_c1,alpha2_deg,ctan_alpha2,u2_px,image_c2,z_mm,u_z_mm,"
        "stereo,z_ruler_mm,depth_row\n"
        "a,day 1,.1,.2,,,,90,,,,500,1.5,,499,\n"
        "b,day 1,,,200,150,,,1,210,,,,p7,,a\n"
        "c,,,,,,c.png,,-1,,d.png,600,,,,c\n",
        name="gaze.csv",
    )
    assert table.groups == ("day 1", "day 1", "c")
    np.testing.assert_allclose(np.rad2deg(table.alpha2_rad), [90, 45, 135], rtol=1e-15)
    np.testing.assert_array_equal(table.u1_px, [np.nan, 200, np.nan])
    np.testing.assert_array_equal(table.z_mm, [500, np.nan, 600])
    np.testing.assert_array_equal(table.u_z_mm, [1.5, np.nan, np.nan])
    assert table.image_c1 == (None, None, "c.png")
    assert table.stereo == (None, "p7", None)
    assert table.depth_row == (None, "a", "c")
    assert list(table.references) == ["ruler"]
    np.testing.assert_array_equal(table.references["ruler"], [499, np.nan, np.nan])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\n", "\n\n") + ",,,,\n",
        lambda text: text.replace(",", " , "),
        lambda text: "\n".join(
            ",".join(f'"{cell}"' for cell in line.split(",")) for line in text.splitlines()
        ),
        lambda text: text.rstrip("\n"),
    ],
    ids=["BOM", "CRLF", "CR", "blank lines", "blanks", "quotes", "no last line end"],
)
def test_what_spreadsheets_and_editors_do_is_accepted(change: Callable[[str], str]) -> None:
    plain, changed = (read_gaze(text, name="gaze.csv") for text in (GAZE, change(GAZE)))
    assert plain.ids == changed.ids
    np.testing.assert_array_equal(plain.x1c, changed.x1c)
    np.testing.assert_array_equal(plain.z_mm, changed.z_mm)


def test_height_may_be_unknown() -> None:
    table = read_gaze("id,x1c,alpha2_deg,z_mm\n1,0.1,88,500\n", name="gaze.csv")
    assert np.isnan(table.y1c).all()


def test_measurements_need_no_depth() -> None:
    table = read_measurements("id,x1c,y1c,ctan_alpha2\n1,0.1,0,0.05\n", name="standard input")
    assert np.isnan(table.z_mm).all()
    table = read_measurements(GAZE, name="gaze.csv")
    assert table.z_mm[0] == 485.9


def test_lengths_to_be_measured_need_no_length() -> None:
    table = read_lengths("id,from,to\nplate,1,2\n", name="lengths.csv", known=False)
    assert (table.ids, table.start, table.end) == (("plate",), ("1",), ("2",))
    assert np.isnan(table.length_mm).all()


def test_sweep_table() -> None:
    text = "id,placement,image_c2,alpha2_deg\n1,near,a.png,60\n2,far,b.png,120\n"
    table = read_sweep(text, name="sweep.csv")
    assert table.placements == ("near", "far")
    assert table.image_c2 == ("a.png", "b.png")
    np.testing.assert_array_equal(table.alpha2_rad, np.deg2rad([60, 120]))


def test_tables_cannot_be_written_to() -> None:
    table = read_gaze(replaced(GAZE, "y1c", "z_ruler_mm").replace(",0.0100,", ",5e2,"), name="g")
    for array in (table.x1c, table.z_mm, table.references["ruler"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_manifest_reaches_the_toolchain_unchanged() -> None:
    manifest = manifest_of(MANIFEST)
    assert (manifest.name, manifest.heading) == ("rig", "A rig")
    assert manifest.board is not None
    assert manifest.board.target_corner == (4, 3)
    assert manifest.encoder is not None
    # A uniform step of 0.05625 deg: 0.28 mrad.
    assert manifest.encoder.std_rad == pytest.approx(np.deg2rad(0.05625) / np.sqrt(12), rel=1e-15)
    assert manifest.gaze is not None
    assert (manifest.gaze.u_x1c, manifest.gaze.u_z_mm, manifest.gaze.u_z_rel) == (2e-4, 0, 0.002)
    assert manifest.priors["axis_z_mm"] == (0, 20)
    assert manifest.priors["axis_z_mm"].std == 20
    assert manifest.certificate.date == "2026-01-31"
    assert manifest.certificate.tolerance is not None
    assert manifest.certificate.tolerance.depth_rel == 0.02


@pytest.mark.parametrize("text", [MANIFEST, "\ufeff" + MANIFEST, MANIFEST.replace("\n", "\r\n")])
def test_manifest_of_any_editor_is_accepted(text: str) -> None:
    assert manifest_of(text) == manifest_of(MANIFEST)


def test_least_manifest() -> None:
    manifest = manifest_of('format = 1\nname = "rig"\n')
    assert manifest.heading == "rig"
    assert manifest.certificate.laboratory is None
    assert manifest.source.doi is None


def test_text_that_reports_must_escape_is_accepted() -> None:
    hostile = "<script>alert('1')</script> & \\\"quotes\\\" " + 300 * "x"
    section = f'[certificate]\nlaboratory = "{hostile}"\ndate = "2026-01-31"\n'
    manifest = manifest_of(MANIFEST[: MANIFEST.index("[certificate]")] + section)
    assert manifest.certificate.laboratory == hostile.replace("\\", "")
    assert manifest.certificate.date == date(2026, 1, 31).isoformat()


def test_dataset_of_images(tmp_path: Path) -> None:
    dataset = load_dataset(image_dataset(tmp_path))
    assert dataset.images == {
        c: tuple(f"intrinsics/{c}/{i}.png" for i in range(6)) for c in ("c1", "c2")
    }
    assert dataset.stereo_pairs["p0"] == ("stereo/c1/p0.png", "stereo/c2/p0.png")
    assert list(dataset.stereo_pairs) == ["p0", "p1", "p2", "p3", "p4"]
    assert dataset.board is not None
    assert dataset.board.target == (4, 3)
    assert dataset.sweep is not None
    assert dataset.lengths is not None
    assert (dataset.lengths.start, dataset.lengths.end) == (("v1",), ("v3",))
    assert dataset.cameras == {}
    assert dataset.warnings == ()


EXCLUDED = {
    'images = "intrinsics/c1/*.png"\n': 'exclude = ["intrinsics/c1/3.png"]\n',
    'c2 = "stereo/c2/*.png"\n': 'exclude = ["c2/p4.png"]\n',
    'table = "sweep.csv"\n': 'exclude = ["s2.png"]\n',
}


def test_pictures_that_are_excluded_are_not_there(tmp_path: Path) -> None:
    """By their path, or the end of it; of a pair one picture takes both out."""
    manifest = IMAGE_MANIFEST
    for after, line in EXCLUDED.items():
        manifest = replaced(manifest, after, after + line)
    folder = image_dataset(tmp_path, manifest)
    rows = "".join(f"{i},g.png,{86 + i},h.png,p{min(i, 3)}\n" for i in range(5))
    (folder / "gaze.csv").write_text("id,image_c1,alpha2_deg,image_c2,stereo\n" + rows)
    (folder / "intrinsics/c1/6.png").write_bytes(PNG)
    dataset = load_dataset(folder)
    assert dataset.images["c1"] == tuple(f"intrinsics/c1/{i}.png" for i in (0, 1, 2, 4, 5, 6))
    assert list(dataset.stereo_pairs) == ["p0", "p1", "p2", "p3"]
    assert dataset.sweep is not None
    assert dataset.sweep.image_c2 == ("s1.png",)
    assert dataset.sweep.ids == ("1",)
    assert "intrinsics/c1/3.png" not in dataset.image_sha256
    assert not any("partner" in warning for warning in dataset.warnings)


@pytest.mark.parametrize(
    ("after", "line", "parts"),
    [
        (
            'images = "intrinsics/c1/*.png"\n',
            'exclude = ["c1/03.png"]',
            ("[cameras.c1] exclude", "'c1/03.png' is no picture", "'intrinsics/c1/3.png'"),
        ),
        (
            'c2 = "stereo/c2/*.png"\n',
            'exclude = ["p1.png"]',
            ("[stereo] exclude", "the end of 2 names", "give more of the path"),
        ),
        (
            'table = "sweep.csv"\n',
            'exclude = ["nothing-like-it"]',
            ("[sweep] exclude", "is no picture", "as the report does"),
        ),
        ('table = "lengths.csv"\n', 'exclude = ["s1.png"]', ("[lengths]", "exclude", "")),
    ],
)
def test_a_name_to_exclude_that_fits_no_picture_is_an_error(
    tmp_path: Path, after: str, line: str, parts: tuple[str, ...]
) -> None:
    manifest = replaced(IMAGE_MANIFEST, after, f"{after}{line}\n")
    assert_problem(check_dataset(image_dataset(tmp_path, manifest)), *parts)


def test_a_given_camera_has_no_picture_to_exclude() -> None:
    text = replaced(MANIFEST, "[encoder]", 'exclude = ["a.png"]\n\n[encoder]')
    (problem,) = parse_manifest(text.encode()).problems
    assert "exclude is given without images" in problem.what


def test_intrinsics_alone_are_a_dataset(tmp_path: Path) -> None:
    manifest = IMAGE_MANIFEST[: IMAGE_MANIFEST.index("[encoder]")]
    dataset = load_dataset(image_dataset(tmp_path, manifest))
    assert dataset.gaze is None
    assert len(dataset.stereo_pairs) == 5


def test_rows_to_come_may_be_few_or_none(tmp_path: Path) -> None:
    """For a plan; a calibration still refuses them, and a plan every other fault."""
    header, *rows = GAZE.splitlines(keepends=True)
    for count in (0, 2):
        few = {"gaze__csv": header + "".join(rows[:count])}
        folder = write_dataset(tmp_path / f"few{count}", **few)
        gaze = load_dataset(folder, rows_to_come=True).gaze
        assert (0 if gaze is None else len(gaze)) == count
        with pytest.raises(InputError, match=r"gaze\.csv"):
            load_dataset(folder)
    bad = write_dataset(tmp_path / "bad", gaze__csv=header + rows[0].replace(",", ",x", 1))
    with pytest.raises(InputError, match=r"gaze\.csv, line 2"):
        load_dataset(bad, rows_to_come=True)


def test_cached_corners_stand_in_for_images(tmp_path: Path) -> None:
    manifest = replaced(IMAGE_MANIFEST, "square_mm", 'corners = "c.vnl"\nsquare_mm')
    folder = image_dataset(tmp_path, manifest)
    names = ["intrinsics/c1/5.png", "intrinsics/c1/7.png", "stereo/c1/p2.png", "g.png", "s1.png"]
    rows = "".join(f"{name} {x} {y} 0\n" for name in names for y in range(7) for x in range(9))
    (folder / "c.vnl").write_text("# filename x y level\n" + rows)
    for name in names:
        (folder / name).unlink(missing_ok=True)
    dataset = load_dataset(folder)
    assert dataset.images["c1"] == tuple(f"intrinsics/c1/{i}.png" for i in (0, 1, 2, 3, 4, 5, 7))
    assert "p2" in dataset.stereo_pairs
    assert set(dataset.corner_cache) == set(names)
    assert dataset.warnings == ("5 image(s) are absent; their corners are in the cache",)


def test_names_with_blanks_and_other_scripts(tmp_path: Path) -> None:
    folder = write_dataset(
        tmp_path / "Prüfstand 2 測定",
        replaced(MANIFEST, "gaze.csv", "Messung 1/Blick ä.csv"),
        **{"Messung 1___Blick ä__csv": GAZE.replace("\n1,", "\nStück 1,")},
    )
    dataset = load_dataset(folder)
    assert dataset.gaze is not None
    assert dataset.gaze.ids[0] == "Stück 1"


def test_fingerprint_covers_names_and_bytes_of_all_files(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path / "a")
    original = load_dataset(folder).sha256
    assert load_dataset(image_dataset(tmp_path / "b")).sha256 == original
    (folder / "unused.txt").write_text("not named in the manifest")
    assert load_dataset(folder).sha256 == original
    seen = {original}
    named = ["dataset.toml", "gaze.csv", "validation.csv", "sweep.csv", "lengths.csv", "g.png"]
    for name in [*named, "h.png", "s1.png", "stereo/c2/p3.png", "intrinsics/c1/0.png"]:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data + b"\n")
        seen.add(load_dataset(folder).sha256)
        (folder / name).write_bytes(data)
    assert len(seen) == 11
    (folder / "intrinsics/c1/0.png").rename(folder / "intrinsics/c1/6.png")
    assert load_dataset(folder).sha256 not in seen


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("u_x1c = 0.0002\n", "", "states no u_x1c: 0.0002 is assumed"),
        ("u_z_rel = 0.002\n", "", "reference depths of 6 rows are taken as exact"),
        ("image_size = [400, 300]", "image_size = [720, 576]", "images of one size?"),
    ],
)
def test_doubts_are_warnings(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert load_dataset(write_dataset(tmp_path / "good")).warnings == ()
    (warning,) = load_dataset(write_dataset(tmp_path, replaced(MANIFEST, old, new))).warnings
    assert said in warning


def test_targets_at_one_depth_are_a_warning(tmp_path: Path) -> None:
    rows = "".join(f"{i},{i / 20},0,{89.01 + i / 2},{500 + i / 2}\n" for i in range(6))
    write_dataset(tmp_path, gaze__csv="id,x1c,y1c,alpha2_deg,z_mm\n" + rows)
    (warning,) = load_dataset(tmp_path).warnings
    assert "500 to 502.5 mm" in warning
    assert "nearer and farther" in warning


def test_image_without_partner_is_a_warning(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path)
    (folder / "stereo/c1/extra.png").write_bytes(PNG)
    assert load_dataset(folder).warnings == ("[stereo]: 1 image(s) without a partner are not used",)


def test_long_tables_in_bounded_memory() -> None:
    header = "id,group,x1c,y1c,alpha2_deg,z_mm,u_z_mm\n"
    text = header + "".join(
        f"r{i},g{i // 10},{i * 1e-6:.6f},0.0123,{85 + i * 5e-5:.5f},{500 + i * 0.01:.2f},1.5\n"
        for i in range(20_000)
    )
    tracemalloc.start()
    table = read_gaze(text, name="gaze.csv")
    assert len(table) == 20_000
    assert table.z_mm[-1] == 699.99
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * len(text)


def test_checking_tables_loads_no_heavy_library(tmp_path: Path) -> None:
    write_dataset(tmp_path)
    code = (
        "import sys; from pathlib import Path; from calib.dataset.load import load_dataset\n"
        f"load_dataset(Path({str(tmp_path)!r}))\n"
        "print([m for m in ('cv2', 'scipy', 'matplotlib', 'cvxpy', 'h5py') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


def test_good_dataset_has_no_problem(tmp_path: Path) -> None:
    assert check_dataset(image_dataset(tmp_path)) == ()


def test_pairs_by_what_the_stars_stand_for(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path)
    pictures = folder / "pictures"
    pictures.mkdir()
    for i in range(3):
        for side, camera in (("left", "c1"), ("right", "c2")):
            source = folder / "stereo" / camera / f"p{i}.png"
            (pictures / f"{side}{i:02d}.png").write_bytes(source.read_bytes())
    (pictures / "left77.png").write_bytes(source.read_bytes())
    manifest = folder / "dataset.toml"
    text = manifest.read_text()
    text = text.replace("stereo/c1/*.png", "pictures/left*.png")
    manifest.write_text(text.replace("stereo/c2/*.png", "pictures/right*.png"))
    gaze = folder / "gaze.csv"
    gaze.write_text(re.sub(r"\bp(\d)\b", lambda m: f"{min(int(m[1]), 2):02d}", gaze.read_text()))
    pairs = load_dataset(folder).stereo_pairs
    assert pairs == {
        f"{i:02d}": (f"pictures/left{i:02d}.png", f"pictures/right{i:02d}.png") for i in range(3)
    }


def test_stars_that_do_not_tell_images_apart() -> None:
    names = ["a/left1.png", "b/left1.png", "a/left2.png", "a/other.png"]
    assert by_star(names, "*/left*.png") == {"2": "a/left2.png"}
    assert by_star(["a/l-1-x.png"], "a/l-*-*.png") == {"1-x": "a/l-1-x.png"}
    assert by_star(["a/left.png"], "a/left.png") == {}
