"""Charts as SVG. Evidence: properties of the drawing, planted changes."""

from __future__ import annotations

import re
from datetime import date, timedelta

import numpy as np
import pytest
from lxml import etree

from calib.history.drawing import BLUE, LABELS, MANY, VERMILLION, chart_rows, legend, one_drawing
from calib.history.quantities import Series

BELOW = 140
"""Of the labels of the horizontal axis, in the drawing."""

SVG = "{http://www.w3.org/2000/svg}"


def rising(number: int, *, days: int = 90, name: str = "depth at 600 mm") -> Series:
    """Return a quantity that is off by 5 u from its seventh value on."""
    dates = tuple((date(2020, 1, 1) + timedelta(days=days * k)).isoformat() for k in range(number))
    values = 5.0 * (np.arange(number) >= 6)
    return Series(name, "mm", dates, values, np.ones(number))


def marks(svg: str, colour: str) -> list[etree._Element]:
    return [e for e in etree.fromstring(svg).iter(f"{SVG}path") if e.get("fill") == colour]


def test_each_point_is_drawn_and_alarms_differ() -> None:
    ((shewhart, _, _),) = chart_rows([rising(12)], accepted=3)
    red = marks(shewhart, VERMILLION)
    assert [mark.findtext(f"{SVG}title", "")[:10] for mark in red] == [
        (date(2020, 1, 1) + timedelta(days=90 * k)).isoformat() for k in range(6, 12)
    ]
    assert all("h6v6h-6z" in str(mark.get("d")) for mark in red)
    assert len(marks(shewhart, BLUE)) == 3
    assert "outside the limits 6 times" in shewhart


@pytest.mark.parametrize("number", [4, 30, MANY + 50])
@pytest.mark.parametrize("days", [0, 1, 7, 45, 400, 3000])
def test_all_is_within_the_picture(number: int, days: int) -> None:
    if number * days > 900_000:
        days = 900
    for svg in chart_rows([rising(number, days=days)], accepted=3)[0]:
        root = etree.fromstring(svg)
        width, height = (float(v) for v in str(root.get("viewBox")).split()[2:])
        texts = list(root.iter(f"{SVG}text"))
        assert all(0 <= float(t.get("x", -1)) <= width for t in texts)
        assert all(0 <= float(t.get("y", -1)) <= height for t in texts)
        dates = [t.text for t in texts if float(t.get("y", 0)) > BELOW]
        assert 1 <= len(dates) <= LABELS
        assert len(dates) > 1 or days == 0 or number == 4
        for path in root.iter(f"{SVG}path"):
            places = re.findall(r"[MLH](-?[0-9.]+)", str(path.get("d")))
            assert all(0 <= float(x) <= width for x in places)


def test_one_drawing_holds_all_charts() -> None:
    rows = chart_rows([rising(9), rising(9, name="<delta2 & more>")], accepted=3)
    drawn = one_drawing(rows, title="Rig <\x1b&>", caption=legend(accepted=3, of="calibrations"))
    root = etree.fromstring(drawn.encode())
    assert len(root.findall(f"{SVG}g/{SVG}svg")) == 6
    assert any(t.text == "<delta2 & more>: CUSUM" for t in root.iter(f"{SVG}text"))
    said = " ".join(str(t.text) for t in root.findall(f"{SVG}text"))
    assert said.startswith("Rig <\N{REPLACEMENT CHARACTER}&>")
    assert "first 3 calibrations" in said
    assert "4.77 (CUSUM)" in said
