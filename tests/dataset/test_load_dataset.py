"""What is in a dataset reaches the toolchain unchanged, and its fingerprint covers all of it.

Evidence: property.
"""

from __future__ import annotations

import re
import subprocess
import sys
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
