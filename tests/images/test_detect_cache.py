"""Corner caches. Evidence: round trips, and mrcal's own reader on the text written."""

from __future__ import annotations

import subprocess
from pathlib import Path

import lens_scenes as scenes
import numpy as np
import pytest

from calib.core.errors import InputError
from calib.core.mrcal_python import DEFAULT_INTERPRETER
from calib.dataset.corner_cache import read_cache, write_cache
from calib.geometry.board import Board

SMALL = Board("chessboard", 3, 2, 25.0, (0, 0))


def found() -> np.ndarray:
    pixels = scenes.views(3, np.random.default_rng(0)).pixels
    pixels[1, 7] = np.nan
    pixels[2] = np.nan
    return pixels


def test_what_is_written_is_read() -> None:
    pixels = found()
    text = write_cache([scenes.corners(pixels)])
    again = read_cache(text, scenes.BOARD, where="corners.vnl")
    assert list(again) == ["00.png", "01.png", "02.png"]
    assert np.allclose(np.stack(list(again.values())), pixels, atol=0.5e-4, equal_nan=True)
    assert "02.png - - -\n" in text


def test_mrcal_reads_what_is_written(tmp_path: Path) -> None:
    pixels = found()
    (tmp_path / "corners.vnl").write_text(write_cache([scenes.corners(pixels)]), encoding="utf-8")
    script = (
        "import mrcal, numpy as np\n"
        "o, i, p = mrcal.compute_chessboard_corners(9, 6, globs_per_camera=('*.png',),"
        " corners_cache_vnl='corners.vnl')\n"
        "np.save('read.npy', o)\n"
    )
    subprocess.run([DEFAULT_INTERPRETER, "-I", "-c", script], cwd=tmp_path, check=True)
    read = np.load(tmp_path / "read.npy").reshape(-1, 54, 3)
    seen = np.isfinite(pixels[:2, :, 0])
    assert len(read) == 2  # the one without a board is left out
    assert np.array_equal(read[..., 2] > 0, seen)
    assert np.allclose(read[seen][:, :2], pixels[:2][seen], atol=0.5e-4)


def test_mrcals_variants_are_read() -> None:
    text = (
        "# filename x y level\n"
        "a b.png 1 2 0\na b.png 3.5 4 1\na b.png - - -\na b.png 5 6 -\na b.png 7 8 -1\n"
        "a b.png -2 8 0\n\n"
        "no/level.png 1 2\nno/level.png 3 4\nno/level.png - -\n"
        "no/level.png 5 6\nno/level.png 7 8\nno/level.png 9 9\n"
    )
    nan = [np.nan, np.nan]
    read = read_cache(text, SMALL, where="c")
    expected = [[1, 2], [3.5, 4], nan, nan, nan, nan]
    assert np.array_equal(read["a b.png"], expected, equal_nan=True)
    expected = [[1, 2], [3, 4], nan, [5, 6], [7, 8], [9, 9]]
    assert np.array_equal(read["no/level.png"], expected, equal_nan=True)


def test_all_faults_are_named() -> None:
    text = "a.png 1 2 0\na.png x 2 0\nb.png 1 2 0\nlonely\nb.png nan 2 0\n"
    with pytest.raises(InputError) as caught:
        read_cache(text, SMALL, where="corners.vnl")
    where = [problem.where for problem in caught.value.problems]
    assert where == [
        "corners.vnl, line 2",
        "corners.vnl, line 4",
        "corners.vnl, line 5",
        "corners.vnl, image a.png",
        "corners.vnl, image b.png",
    ]
    assert "1 corners, and the board has 3 x 2 = 6" in str(caught.value)
