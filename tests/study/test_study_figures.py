"""Figures of a study explain themselves. Evidence: the scores that the documents show."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from calib.geometry.parameters import INDEX
from calib.study.figures import ESTIMATORS, FIGURES
from calib.study.scores import StudyScore

SCORES = Path(__file__).parents[2] / "docs" / "study" / "default" / "scores.json"


def texts(figure: Figure) -> list[str]:
    return [found.get_text() for found in figure.findobj(Text) if found.get_text()]


@pytest.mark.parametrize("name", FIGURES)
def test_each_colour_has_its_words_and_no_key_of_the_table_is_among_them(name: str) -> None:
    scores = [StudyScore(**one) for one in json.loads(SCORES.read_text())["scores"]]
    figure = FIGURES[name](scores)
    assert figure is not None
    (legend,) = figure.legends
    points = {line.get_color() for axes in figure.axes for line in axes.lines}
    explained = {handle.get_color() for handle in legend.legend_handles}
    # Black and grey lines mark what should be; the label of the axis says so.
    assert points - {"#1b1b1b"} <= explained
    keys = {*INDEX, *ESTIMATORS, "noise_scale"}
    assert not keys & set(texts(figure))
