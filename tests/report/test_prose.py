"""Texts of checks and warnings as a page prints them. Evidence: properties."""

from __future__ import annotations

import pytest

from calib.report.numbers import given, rounded_up, with_sign
from calib.report.prose import sentence


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("turned by 0.37 +- 0.01 deg", "Turned by 0.37 ± 0.01 deg."),
        ("base is not proved optimal", "base is not proved optimal."),
        ("axis-offset predicts best", "axis-offset predicts best."),
        ("baseline_mm rests on prior knowledge", "baseline_mm rests on prior knowledge."),
        ("gaze/c1/07.png: blurred?", "gaze/c1/07.png: blurred?"),
    ],
)
def test_a_text_becomes_a_sentence_and_names_stay(text: str, shown: str) -> None:
    assert sentence(text) == shown


def test_a_bound_is_never_rounded_down() -> None:
    assert [rounded_up(bound).text for bound in (0.8201, 0.82, 82.4, 0.0)] == [
        "0.83",
        "0.82",
        "83",
        "0",
    ]


def test_a_reference_shows_what_its_difference_to_a_measured_depth_needs() -> None:
    assert given(338.733232914, 0.21).text == "338.73"
    assert given(350.0, 4.2).text == "350.0"
    assert with_sign(-1.0) == "−1.0"
    assert with_sign(0.6349) == "+0.63"
