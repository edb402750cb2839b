"""What tables say reaches the toolchain unchanged. Evidence: property."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from dataset_examples import GAZE, replaced

from calib.dataset.readers import read_gaze, read_lengths, read_measurements, read_sweep


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
