"""Rows whose reading and reference come from one picture. Evidence: property, negative control."""

from __future__ import annotations

from pathlib import Path

import pytest
from dataset_examples import MANIFEST, png, write_dataset

from calib.dataset.load import load_dataset

STEREO = """
[cameras.c2]
image_size = [400, 300]
matrix = [[421.71, 0, 201.27], [0, 424.68, 155.17], [0, 0, 1]]
[stereo]
c1 = "c1/*.png"
c2 = "c2/*.png"
alpha2_deg = 90.0
"""


def shade(grey: int) -> bytes:
    return png(data=b"".join(b"\0" + bytes([grey]) * 400 for _ in range(300)))


@pytest.mark.parametrize("image", ["c2/{}.png", "copy/{}.png", "gaze/{}.png"])
def test_pictures_of_pairs_that_are_rows_too_are_told(tmp_path: Path, image: str) -> None:
    """By name, by content, and neither."""
    files: dict[str, str | bytes] = {}
    for i in range(6):
        files[f"c1___p{i}__png"] = shade(i)
        files[f"c2___p{i}__png"] = files[f"copy___p{i}__png"] = shade(20 + i)
        files[f"gaze___p{i}__png"] = shade(40 + i)
    rows = [f"r{i},p{i},c1/p{i}.png,{image.format(f'p{i}')},{80 + i}" for i in range(6)]
    files["gaze__csv"] = "id,stereo,image_c1,image_c2,alpha2_deg\n" + "\n".join(rows) + "\n"
    dataset = load_dataset(write_dataset(tmp_path, MANIFEST + STEREO, **files))
    told = [text for text in dataset.warnings if "come from one picture by C2" in text]
    if image.startswith("gaze"):
        assert not told
    else:
        assert "depth of 6 of 6 rows" in told[0]
        assert "(r0, r1, r2, r3, r4, ...)" in told[0]
