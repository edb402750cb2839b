"""Rows that share a reference depth, from the table on.

Evidence: property (sums of variances, which rows are grouped).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.core.arrays import FloatArray
from calib.dataset.load import load_dataset
from calib.dataset.readers import read_gaze
from calib.dataset.tables import GazeTable
from calib.geometry.plane import OBSERVABLE
from calib.rows.from_table import (
    ImageObservations,
    RowSettings,
    Setup,
    observe,
    row_settings,
    validation_settings,
)
from calib.rows.observations import Observations
from calib.rows.repeated_readings import combine

SETTINGS = RowSettings(
    u_x1c=2e-4, u_z_mm=0.3, u_z_rel=0.001, encoder_step_rad=1e-3, u_alpha2_rad=0.0
)
HEAD = "id,group,x1c,y1c,alpha2_deg,z_mm,u_z_mm\n"
ROWS = """a,near,0.10,0.0,86,500,
b,near,0.26,0.0,95,502,
c,far,0.23,0.0,97,1000,
d,far,0.02,0.0,85,1003,2
e,,0.16,0.0,94,998,
"""


def table(text: str = HEAD + ROWS) -> GazeTable:
    return read_gaze(text, name="gaze.csv")


def grouped(mm: float = 0.0, rel: float = 0.0, text: str = HEAD + ROWS) -> Observations:
    settings = replace(SETTINGS, u_z_group_mm=mm, u_z_group_rel=rel)
    return observe(table(text), Setup(settings), None)


def test_a_group_s_error_comes_beside_each_row_s_own() -> None:
    plain, rows = grouped(), grouped(mm=0.4, rel=0.002)
    assert not plain.has_groups
    u = np.hypot(0.4, 0.002 * rows.z_mm)
    own = plain.std[:, OBSERVABLE.z]
    assert own[3] == 2.0
    np.testing.assert_allclose(rows.std[:, OBSERVABLE.z], np.hypot(own, u), rtol=1e-14)
    # The last row is alone: all that is uncertain of its depth is its own.
    np.testing.assert_allclose(rows.u_z_group_mm, [*u[:4], 0.0], rtol=1e-14)
    assert rows.z_group[0] == rows.z_group[1] != rows.z_group[2] == rows.z_group[3]
    np.testing.assert_array_equal(rows.std[:, :4], plain.std[:, :4])


def test_chosen_rows_keep_their_group() -> None:
    rows = grouped(rel=0.002)
    some = rows.take(np.array([3, 0, 2]))
    assert some.z_group[0] == some.z_group[2] != some.z_group[1]
    np.testing.assert_array_equal(some.u_z_group_mm, rows.u_z_group_mm[[3, 0, 2]])
    assert not grouped().take(np.array([1, 2])).has_groups


STEREO = "id,x1c,y1c,alpha2_deg,z_mm,stereo\n" + "".join(
    f"{i},{x},0,{alpha},{z},{stem}\n"
    for i, (x, alpha, z, stem) in enumerate(
        [
            (0.10, 86, "", "p1"),
            (0.26, 95, "", "p1"),
            (0.23, 97, "", "p2"),
            (0.02, 85, "1003", ""),
            (0.16, 94, "998", ""),
        ]
    )
)


def seen(u_z: FloatArray) -> ImageObservations:
    nowhere = np.full((5, 2), np.nan)
    z = np.array([500.0, 500.0, 1000.0, np.nan, np.nan])
    return ImageObservations(nowhere, nowhere, 0.1, 0.1, z, u_z, np.zeros((5, 0)))


def test_rows_of_one_image_pair_share_its_error_without_a_word() -> None:
    u = np.array([1.5, 1.5, 4.0, np.nan, np.nan])
    rows = observe(table(STEREO), Setup(SETTINGS), seen(u))
    np.testing.assert_array_equal(rows.u_z_group_mm, [1.5, 1.5, 0, 0, 0])
    np.testing.assert_array_equal(rows.std[:3, OBSERVABLE.z], u[:3])
    assert rows.z_group[0] == rows.z_group[1]
    assert len({*rows.z_group[1:].tolist()}) == 4


def test_pairs_used_once_are_each_row_s_own() -> None:
    rows = observe(
        table(STEREO.replace(",p1\n1", ",p0\n1")), Setup(SETTINGS), seen(np.full(5, 1.5))
    )
    assert not rows.has_groups


@pytest.mark.parametrize("depths", ["taken anew", "taken once"])
def test_repeats_of_a_gaze_keep_what_their_group_shares(depths: str) -> None:
    other = "502.5" if depths == "taken anew" else "502"
    text = HEAD + ROWS + f"f,near,0.26,0.0,95,{other},\n"
    rows = combine(grouped(rel=0.002, text=text))
    assert len(rows) == 5
    own = np.hypot(0.3, 0.001 * np.array([502.0, float(other)]))
    if depths == "taken anew":
        own /= np.sqrt(2)
    group = 0.002 * np.array([502.0, float(other)])
    assert rows.std[1, OBSERVABLE.z] == pytest.approx(
        np.sqrt(np.mean(own**2) + np.mean(group**2)), rel=1e-12
    )
    assert rows.u_z_group_mm[1] > 0
    assert rows.z_group[0] == rows.z_group[1]


MANIFEST = """format = 1
name = "poses"
[encoder]
resolution_deg = 0.05
[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = 0.0002
u_z_rel = 0.001
u_z_group_mm = 0.4
[validation]
table = "validation.csv"
u_z_group_rel = 0.003
"""


def test_gaze_and_validation_rows_have_each_their_statement(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text(MANIFEST)
    for name in ("gaze.csv", "validation.csv"):
        (tmp_path / name).write_text(HEAD + ROWS)
    dataset = load_dataset(tmp_path)
    rows, check = row_settings(dataset), validation_settings(dataset)
    assert (rows.u_z_rel, rows.u_z_group_mm, rows.u_z_group_rel) == (0.001, 0.4, 0.0)
    assert (check.u_z_rel, check.u_z_group_mm, check.u_z_group_rel) == (0.0, 0.0, 0.003)
    assert not any("taken as exact" in warning for warning in dataset.warnings)
