"""Whatever stands in a dataset, the answer is a valid dataset or a list of readable problems.

Evidence: property (random texts, and good files spoilt at random places, by hypothesis). The quick
trials are the same in each run; the long ones differ.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from dataset_examples import GAZE, MANIFEST, assert_readable, write_dataset
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_camera_file import MRCAL, opencv_yaml

from calib.core.errors import InputError
from calib.dataset.camera_file import read_camera
from calib.dataset.faults import parse_manifest
from calib.dataset.fields import PRIOR_NAMES
from calib.dataset.load import check_dataset, load_dataset
from calib.dataset.manifest import (
    BoardSection,
    CameraSection,
    CertificateSection,
    Encoder,
    GazeSection,
    Manifest,
    StereoSection,
)
from calib.dataset.readers import read_gaze, read_lengths, read_measurements, read_sweep
from calib.dataset.returns import scan_returns
from calib.dataset.tables import GazeTable

QUICK = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
LONG = settings(QUICK, max_examples=4000, derandomize=False)

FULL_TABLE = (
    "id,group,x1c,y1c,u1_px,v1_px,image_c1,alpha2_deg,ctan_alpha2,u2_px,image_c2,z_mm,u_z_mm,"
    "stereo,z_ruler_mm,depth_row\n"
    "a,day 1,.1,.2,,,,90,,,,500,1.5,,499,\n"
    "b,day 1,,,200,150,,,.1,210,,,,p7,,a\n"
    "c,,,,,,c.png,,-.1,,d.png,600,,,,c\n"
)
SWEEP = "id,placement,image_c2,alpha2_deg\n1,p,a.png,80\n2,q,b.png,90\n"
LENGTHS = "id,from,to,length_mm,u_length_mm\na,1,3,420.5,0.2\nb,2,3,320,0.2\n"
RETURNS = (
    "id,of,after,alpha2_deg,change_deg,u_change_deg,u_first_deg\nr01,1,2,87,0.001,0.002,0.002\n"
)
CACHE = "# filename x y level\n" + "".join(f"a.png {x} {y} 0\n" for y in range(7) for x in range(9))

NASTY = st.sampled_from(
    [
        *["", " ", "nan", "-inf", "1e999", "-1", "0", "1e-320", "1e308", "9" * 400, "0x1p3", "1_0"],
        *['"', "'", "\x00", "\x1b[31m", "\ufeff", "\u202e", "\ud7ff", "=1+1", "../x", "/", ";"],
        *["\t", "\r", "id", "[", "]]", "{", "}", "=", "#", ".", "*", "true", "1979-05-27", "'''"],
        *['"""', "\\u0000"],
    ]
)
PIECES = st.one_of(NASTY, st.text(max_size=20), st.floats().map(repr), st.integers().map(str))


@st.composite
def spoilt(draw: Callable[[Any], Any], text: str) -> str:
    """Return `text` with up to five pieces cut out, copied elsewhere or replaced."""
    for _ in range(draw(st.integers(1, 5))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 30)))
        what = draw(st.sampled_from(["cut", "copy", "replace"]))
        piece = {"cut": "", "copy": text[start:end] * 2}.get(what)
        text = text[:start] + (draw(PIECES) if piece is None else piece) + text[end:]
    return text


@st.composite
def cells_replaced(draw: Callable[[Any], Any], table: str) -> str:
    """Return a table with some cells replaced, so that it remains one."""
    rows = [line.split(",") for line in table.splitlines()]
    for _ in range(draw(st.integers(1, 6))):
        row = draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, len(rows[row]) - 1))
        rows[row][column] = draw(PIECES).replace(",", "").replace("\n", "")
    return "\n".join(map(",".join, rows))


def tables(table: str) -> st.SearchStrategy[str]:
    return st.one_of(spoilt(table), cells_replaced(table), st.text())


VALUES = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(),
        st.floats(),
        st.text(max_size=10),
        st.dates(),
        st.datetimes(),
        st.sampled_from(["chessboard", "charuco", "centre", "gaze.csv", "*.png", "guard-band"]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=12,
)
KEYS = st.sampled_from(
    [
        *PRIOR_NAMES,
        *(
            key
            for section in (
                Manifest,
                BoardSection,
                CameraSection,
                StereoSection,
                Encoder,
                GazeSection,
                CertificateSection,
            )
            for key in section.model_fields
        ),
    ]
)
SECTIONS = st.dictionaries(KEYS | st.text(max_size=6), VALUES, max_size=6)
MANIFESTS = st.dictionaries(KEYS, SECTIONS | VALUES, max_size=8).map(
    lambda manifest: tomli_w.dumps({"format": 1, "name": "x"} | manifest)
)


def assert_refused_readably(error: InputError) -> None:
    assert error.problems
    for problem in error.problems:
        assert_readable(problem)


def scanned_returns(text: str, *, name: str) -> Any:
    return scan_returns(text, name=name).sound()


def try_table(read: Callable[..., Any], text: str) -> None:
    try:
        table = read(text, name="table.csv")
    except InputError as error:
        assert_refused_readably(error)
        return
    assert len(table) > 0
    assert len(set(table.ids)) == len(table)
    if isinstance(table, GazeTable):
        assert np.all((table.alpha2_rad > 0) & (table.alpha2_rad < np.pi))
        assert np.all(np.isnan(table.z_mm) | (table.z_mm > 0))
        sources = [np.isfinite(table.x1c), np.isfinite(table.u1_px)]
        sources.append(np.array([image is not None for image in table.image_c1]))
        assert np.all(np.sum(sources, axis=0) == 1)


def try_manifest(data: bytes) -> None:
    parsed = parse_manifest(data)
    assert (parsed.manifest is None) == bool(parsed.problems)
    for problem in parsed.problems:
        assert_readable(problem)


def try_camera(text: str) -> None:
    try:
        camera = read_camera(text, name="c1.model")
    except InputError as error:
        assert_refused_readably(error)
        return
    assert np.isfinite(camera.matrix).all()
    assert np.isfinite(camera.distortion).all()
    assert min(camera.image_size) > 0


def try_dataset(files: dict[str, str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = write_dataset(Path(name))
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8", errors="surrogatepass")
        problems = check_dataset(folder)
        for problem in problems:
            assert_readable(problem)
        if not problems:
            assert len(load_dataset(folder).sha256) == 64


FILES = st.fixed_dictionaries(
    {},
    optional={
        "dataset.toml": spoilt(MANIFEST.replace("rows = 7", 'rows = 7\ncorners = "c.vnl"')),
        "gaze.csv": tables(GAZE),
        "c.vnl": spoilt(CACHE),
    },
)

TRIALS: dict[str, tuple[st.SearchStrategy[Any], Callable[[Any], None]]] = {
    "gaze": (tables(FULL_TABLE), lambda text: try_table(read_gaze, text)),
    "measurements": (tables(GAZE), lambda text: try_table(read_measurements, text)),
    "sweep": (tables(SWEEP), lambda text: try_table(read_sweep, text)),
    "lengths": (tables(LENGTHS), lambda text: try_table(read_lengths, text)),
    "returns": (tables(RETURNS), lambda text: try_table(scanned_returns, text)),
    "manifest bytes": (st.binary(), try_manifest),
    "manifest spoilt": (spoilt(MANIFEST).map(lambda t: t.encode("utf-8", "ignore")), try_manifest),
    "manifest values": (MANIFESTS.map(str.encode), try_manifest),
    "mrcal model": (spoilt(MRCAL), try_camera),
    "OpenCV model": (spoilt(opencv_yaml()), try_camera),
    "dataset": (FILES, try_dataset),
}


@pytest.mark.parametrize(("cases", "attempt"), TRIALS.values(), ids=TRIALS.keys())
def test_no_input_leads_to_a_traceback(
    cases: st.SearchStrategy[Any], attempt: Callable[[Any], None]
) -> None:
    QUICK(given(cases)(attempt))()


@pytest.mark.slow
@pytest.mark.parametrize(("cases", "attempt"), TRIALS.values(), ids=TRIALS.keys())
def test_no_input_leads_to_a_traceback_in_40_000_cases(
    cases: st.SearchStrategy[Any], attempt: Callable[[Any], None]
) -> None:
    LONG(given(cases)(attempt))()
