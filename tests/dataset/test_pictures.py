"""Pictures are looked at before they are decoded. Evidence: OpenCV's encoders, properties."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_examples import PNG, assert_problem, png, problems_of, replaced
from PIL import ImageFile
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


SCENE = cv2.GaussianBlur(
    np.kron(np.eye(4, dtype=np.uint8) * 200, np.ones((40, 60), np.uint8)), (0, 0), 2
)
JPEGS = {
    "plain": (SCENE, []),
    "noise": (NOISE, []),
    "one grey value": (np.full_like(SCENE, 90), []),
    "colour": (cv2.cvtColor(SCENE, cv2.COLOR_GRAY2BGR), []),
    "progressive": (SCENE, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "restart marks": (SCENE, [cv2.IMWRITE_JPEG_RST_INTERVAL, 8]),
}


@pytest.mark.parametrize("lenient", [False, True])
@pytest.mark.parametrize(("image", "options"), JPEGS.values(), ids=JPEGS.keys())
def test_a_jpeg_cut_short_but_for_its_end_mark_is_named(
    image: np.ndarray,
    options: list[int],
    lenient: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Independent tool: OpenCV wrote it, and decodes what is left of it.

    Pillow may have been told, as WeasyPrint does, to take what is cut.
    """
    monkeypatch.setattr("PIL.ImageFile.LOAD_TRUNCATED_IMAGES", lenient)
    data, file = cv2.imencode(".jpg", image, options)[1].tobytes(), tmp_path / "g.jpg"
    for whole in (data, data + bytes(300), data + b"more"):
        file.write_bytes(whole)
        assert np.array_equal(read_grey(file, name="g"), cv2.imread(str(file), 0))
    scan = data.index(b"\xff\xda") + 14
    for share in (0.1, 0.5, 0.9):
        file.write_bytes(data[: scan + int(share * (len(data) - scan))] + b"\xff\xd9")
        with pytest.raises(InputError, match="g: the file is truncated"):
            read_grey(file, name="g")
    assert ImageFile.LOAD_TRUNCATED_IMAGES is lenient


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


def tiff(width: int, height: int, *, order: str = "<", bits: int = 16, samples: int = 1) -> bytes:
    """Return a TIFF file with eight bytes for its pixels."""
    tags = {256: width, 257: height, 258: bits, 259: 1, 262: 1, 273: 8, 277: samples, 279: 8}
    mark = b"II*\0" if order == "<" else b"MM\0*"
    entries = [struct.pack(order + "HHII", tag, 4, 1, value) for tag, value in tags.items()]
    return mark + struct.pack(order + "I8xH", 16, len(tags)) + b"".join(entries) + bytes(4)


def bmp(width: int, height: int, *, bits: int = 24, compression: int = 0) -> bytes:
    start = struct.pack("<2sIHHI", b"BM", 2000, 0, 0, 1078)
    head = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, compression, 99, 0, 0, 256, 0)
    return start + head + bytes(1200)


def jpeg(width: int, height: int, frame: int) -> bytes:
    """Return a JPEG file whose frame states another size; `frame` is its marker."""
    progressive = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(frame == 0xC2)]
    data = bytearray(cv2.imencode(".jpg", NOISE, progressive)[1].tobytes())
    at = data.index(bytes([0xFF, frame]))
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


def webp(width: int, height: int, kind: str) -> bytes:
    quality = 101 if kind == "lossless" else 90
    encoded = cv2.imencode(".webp", COLOUR, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
    data = bytearray(encoded)
    if kind == "extended":
        sides = (n.to_bytes(3, "little") for n in (width - 1, height - 1))
        chunks = b"WEBPVP8X" + struct.pack("<I4x", 10) + b"".join(sides) + encoded[12:]
        return b"RIFF" + struct.pack("<I", len(chunks)) + chunks
    if kind == "lossless":
        data[21:25] = struct.pack("<I", (width - 1) | (height - 1) << 14)
    else:
        data[26:30] = struct.pack("<HH", width, height)
    return bytes(data)


BOMBS = {
    "TIFF": (tiff(30000, 30000), "30000 x 30000 px of 16 bit, 900 million"),
    "TIFF, big end first": (tiff(30000, 30000, order=">"), "900 million"),
    "TIFF of 4 billion": (tiff(2**32 - 1, 2**32 - 1), "4294967295 x 4294967295 px"),
    "deep TIFF": (tiff(12000, 12000, bits=64), "1 x 64 bit, more than 1 GiB"),
    "TIFF of many samples": (tiff(9000, 9000, samples=2**16 - 1), "65535 x 16 bit"),
    "BMP": (bmp(30000, 30000), "30000 x 30000 px of 24 bit"),
    "BMP from the top": (bmp(30000, -30000), "30000 x 30000 px"),
    "BMP, least sides": (bmp(-(2**31), -(2**31)), "2147483648 x 2147483648 px"),
    "BMP, run lengths": (bmp(30000, 30000, bits=8, compression=1), "30000 x 30000 px of 8 bit"),
    "JPEG": (jpeg(65500, 65500, 0xC0), "65500 x 65500 px of 8 bit"),
    "progressive JPEG": (jpeg(65500, 65500, 0xC2), "65500 x 65500 px"),
    "WebP": (webp(16383, 16383, "lossy"), "16383 x 16383 px"),
    "lossless WebP": (webp(16384, 16384, "lossless"), "16384 x 16384 px"),
    "extended WebP": (webp(2**24, 2**24, "extended"), "16777216 x 16777216 px"),
    "PGM": (b"P5 30000 30000 65535\n" + bytes(100), "30000 x 30000 px of 16 bit"),
    "PGM without end": (b"P5 " + b"9" * 40 + b" 9 255\n", "999999999999 x 9 px"),
    "PNG": (png(2**31 - 1, 2**31 - 1, data=b"0"), "2147483647 x 2147483647 px"),
}


@pytest.mark.parametrize(("data", "said"), BOMBS.values(), ids=BOMBS.keys())
def test_giant_headers_of_all_formats(
    data: bytes, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Property: named by what the header says, and never decoded; so memory stays small."""

    def decoded(*_: object) -> None:
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", decoded)
    assert len(data) < 10_000
    (tmp_path / "a.img").write_bytes(data)
    with pytest.raises(InputError, match=said) as caught:
        read_grey(tmp_path / "a.img", name="a.img")
    assert str(caught.value).startswith("a.img: ")
    folder = image_dataset(tmp_path / "d")
    (folder / "intrinsics/c1/3.png").write_bytes(data)
    assert_problem(problems_of(folder), "intrinsics/c1/3.png", said)


def test_a_tag_twice_is_no_picture() -> None:
    """Decoders differ in which one they believe."""
    data = bytearray(tiff(30000, 30000))
    at = 18 + 12 * 2  # the depth becomes another width
    data[at : at + 12] = struct.pack("<HHII", 256, 4, 1, 100)
    assert picture_header(io.BytesIO(bytes(data))) is None


def test_a_picture_of_one_grey_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(40, 30, bits=16, data=bytes((1 + 80) * 30)))
    assert not read_grey(tmp_path / "a.png", name="a.png").any()


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
