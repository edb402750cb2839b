"""Pictures are looked at before they are decoded. Evidence: OpenCV's encoders, properties."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_examples import PNG, assert_problem, png, problems_of, replaced
from test_load_dataset import image_dataset

from calib.chain.images import image_stages
from calib.core.errors import InputError
from calib.dataset.load import load_dataset
from calib.dataset.picture_header import Header, header_fault, picture_header
from calib.images.detection.picture import read_grey
from calib.stages.store import Store

NOISE = np.random.default_rng(1).integers(0, 256, (37, 53), dtype=np.uint8)
DEEP = NOISE.astype(np.uint16) * 257
COLOUR = cv2.cvtColor(NOISE, cv2.COLOR_GRAY2BGR)

ENCODED = {
    "png": (".png", NOISE, [], 8),
    "deep png": (".png", DEEP, [], 16),
    "jpeg": (".jpg", NOISE, [], 8),
    "progressive jpeg": (".jpg", COLOUR, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], 8),
    "tiff": (".tiff", NOISE, [], 8),
    "deep tiff": (".tiff", DEEP, [cv2.IMWRITE_TIFF_COMPRESSION, 1], 16),
    "bmp": (".bmp", COLOUR, [], 24),
    "grey bmp": (".bmp", NOISE, [], 8),
    "pgm": (".pgm", NOISE, [], 8),
    "deep pgm": (".pgm", DEEP, [], 16),
    "ppm": (".ppm", COLOUR, [], 8),
    "webp": (".webp", COLOUR, [cv2.IMWRITE_WEBP_QUALITY, 90], 8),
    "lossless webp": (".webp", COLOUR, [cv2.IMWRITE_WEBP_QUALITY, 101], 8),
}


@pytest.mark.parametrize(
    ("ending", "image", "options", "bits"), ENCODED.values(), ids=ENCODED.keys()
)
def test_headers(ending: str, image: np.ndarray, options: list[int], bits: int) -> None:
    """Independent tool: OpenCV wrote it; cut anywhere in its second half it is not whole."""
    data = cv2.imencode(ending, image, options)[1].tobytes()
    assert picture_header(io.BytesIO(data)) == Header(53, 37, bits)
    for share in (0.5, 0.75, 0.99):
        cut = picture_header(io.BytesIO(data[: int(share * len(data))]))
        assert header_fault(cut) is not None, share


@pytest.mark.parametrize("length", [0, 1, 3, 4, 9, 17, 25, 40, 200])
def test_fragments_are_no_picture(length: int) -> None:
    """Property: whatever is there, no exception and no size out of thin air."""
    rng = np.random.default_rng(length)
    for ending, image, options, _ in ENCODED.values():
        data = bytearray(cv2.imencode(ending, image, options)[1].tobytes())
        assert header_fault(picture_header(io.BytesIO(bytes(data[:length])))) is not None
        for _ in range(20):
            data[rng.integers(len(data))] = rng.integers(256)
            picture_header(io.BytesIO(bytes(data)))


def test_a_picture_that_claims_a_billion_pixels(tmp_path: Path) -> None:
    """A file of 2 MB that would take 2 GB."""
    bomb = png(32000, 32000, bits=16, data=bytes(2_000_000_00))
    assert len(bomb) < 2**21
    (tmp_path / "bomb.png").write_bytes(bomb)
    with pytest.raises(InputError) as caught:
        read_grey(tmp_path / "bomb.png", name="bomb.png")
    assert "32000 x 32000 px of 16 bit, 1024 million (limit 160)" in str(caught.value)
    folder = image_dataset(tmp_path / "d")
    (folder / "intrinsics/c1/3.png").write_bytes(bomb)
    assert_problem(problems_of(folder), "intrinsics/c1/3.png", "1024 million")


def test_wrong_sizes_and_broken_files_are_named_from_their_headers(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path)
    (folder / "intrinsics/c1/1.png").write_bytes(png(640, 480))
    (folder / "intrinsics/c2/2.png").write_bytes(PNG[:-20])
    (folder / "g.png").write_bytes(b"GIF89a and more")
    problems = problems_of(folder)
    assert len(problems) == 3
    assert_problem(problems, "intrinsics/c1/1.png", "640 x 480", "manifest says 400 x 300")
    assert_problem(problems, "intrinsics/c2/2.png", "truncated: 400 x 300 px", "copy it again")
    assert_problem(problems, "g.png", "no image", "PNG, JPEG, TIFF, BMP, PGM and WebP are read")


def test_pictures_of_two_sizes_where_none_is_stated(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path)
    manifest = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(manifest.replace("image_size = [400, 300]\n", "", 1))
    camera = load_dataset(folder).manifest.cameras.c1
    assert camera is not None
    assert camera.image_size == (400, 300)
    (folder / "intrinsics/c1/4.png").write_bytes(png(640, 480))
    assert_problem(problems_of(folder), "c1/4.png", "640 x 480", "c1/0.png is 400 x 300")


def test_a_picture_that_changed_after_loading_is_refused(tmp_path: Path) -> None:
    dataset = load_dataset(image_dataset(tmp_path))
    name = "intrinsics/c1/3.png"
    wanted = dataset.image_sha256[name]
    assert read_grey(tmp_path / name, name=name, sha256=wanted).shape == (300, 400)
    changed = bytearray((1 + 400) * 300)
    changed[500] = 1
    (tmp_path / name).write_bytes(png(data=bytes(changed)))
    with pytest.raises(InputError) as caught:
        read_grey(tmp_path / name, name=name, sha256=wanted)
    assert f"{name}: the file has changed since the dataset was read" in str(caught.value)


def test_too_little_memory_names_the_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def exhausted(*_: object) -> None:
        raise MemoryError

    (tmp_path / "a.png").write_bytes(PNG)
    monkeypatch.setattr(cv2, "imdecode", exhausted)
    with pytest.raises(InputError, match=r"a\.png: there is too little memory"):
        read_grey(tmp_path / "a.png", name="a.png")


def test_a_picture_with_known_corners_is_not_looked_at(tmp_path: Path) -> None:
    folder = image_dataset(tmp_path)
    (folder / "g.png").write_bytes(b"no picture")
    assert_problem(problems_of(folder), "g.png", "no image")
    corners = "".join(f"g.png {40 * x + 20} {40 * y + 20} 0\n" for y in range(7) for x in range(9))
    (folder / "c.vnl").write_text("# filename x y level\n" + corners)
    manifest = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(
        replaced(manifest, "square_mm = 25.0", 'square_mm = 25.0\ncorners = "c.vnl"')
    )
    assert problems_of(folder) == ()


def test_a_run_on_pictures_that_changed_after_loading_is_refused(tmp_path: Path) -> None:
    """Property: digests that a result states are of the pictures that it used."""
    dataset = load_dataset(image_dataset(tmp_path / "d"))
    names = ("stereo/c1/p2.png", "s1.png")
    for name in names:
        (tmp_path / "d" / name).write_bytes(PNG + b"\n")
    store = Store(tmp_path / "out", lambda _: None, lambda *_: None)
    with pytest.raises(InputError) as caught, store.locked():
        image_stages(dataset, store, 0)
    assert str(caught.value).count("has changed since the dataset was read") == 1
    assert names[0] in str(caught.value)
