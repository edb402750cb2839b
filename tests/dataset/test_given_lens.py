"""What is uncertain of a lens that is given. Evidence: the stated figures, and the rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.core.errors import InputError
from calib.dataset.given_lens import assumed_of_lens, given_lens_covariance
from calib.dataset.load import load_dataset

MANIFEST = """format = 1
name = "given"
[cameras.c1]
image_size = [640, 480]
matrix = [[800, 0, 320], [0, 810, 240], [0, 0, 1]]
{lens}
[encoder]
resolution_deg = 0.1
[gaze]
table = "gaze.csv"
u_z_rel = 0.01
"""
PIXELS = "id,u1_px,v1_px,alpha2_deg,z_mm\n"
DIRECTIONS = "id,x1c,y1c,alpha2_deg,z_mm\n"


def made(folder: Path, *, lens: str = "", head: str = PIXELS) -> Path:
    scale = 1 if head == PIXELS else 1000
    rows = (f"g{i},{(300 + i) / scale},{200 / scale},{80 + i},{500 + 10 * i}" for i in range(8))
    (folder / "gaze.csv").write_text(head + "\n".join(rows) + "\n")
    (folder / "dataset.toml").write_text(MANIFEST.format(lens=lens))
    return folder


def test_a_lens_without_statement_is_not_exact_and_that_is_said(tmp_path: Path) -> None:
    dataset = load_dataset(made(tmp_path))
    covariance = given_lens_covariance(dataset, "c1")
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.8, 0.81, 0.8, 0.8])
    assert covariance[0, 1] == pytest.approx(0.8 * 0.81)
    said = assumed_of_lens(dataset, "c1")
    assert said is not None
    assert "u_focal and u_centre_px not" in said
    assert said in dataset.warnings


def test_stated_uncertainty_counts_and_zero_is_exact(tmp_path: Path) -> None:
    dataset = load_dataset(made(tmp_path, lens="u_focal = 0.0005\nu_centre_px = 0.0"))
    u = np.sqrt(np.diag(given_lens_covariance(dataset, "c1")))
    assert u == pytest.approx([0.4, 0.405, 0.0, 0.0])
    assert assumed_of_lens(dataset, "c1") is None


def test_directions_bring_their_own_uncertainty(tmp_path: Path) -> None:
    dataset = load_dataset(made(tmp_path, head=DIRECTIONS))
    assert not given_lens_covariance(dataset, "c1").any()
    assert assumed_of_lens(dataset, "c1") is None


def test_pixels_for_parts_of_the_focal_length_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0\.001 for 0\.1 %"):
        load_dataset(made(tmp_path, lens="u_focal = 1.5"))
