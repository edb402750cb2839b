"""The report's section on causes.

Evidence: regression of texts on a cause put together by hand; figures of the picture are its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lxml import html
from page_parts import table
from report_examples import paper

from calib.diagnosis.findings import Cause, Diagnosis, SeenIn
from calib.report.figures.diagnosis import draw_cause
from calib.report.page import render_report

BEFORE, AFTER = np.array([2.0, -2.0, 2.0]), np.array([0.3, -0.1, 0.2])
STEP = Cause(
    name="reading-step",
    at="c13",
    estimate=0.25,
    std=0.012,
    gain=41.3,
    noise_scale=(4.06, 0.92),
    effect=7.2,
    is_carried=False,
    ids=("c12", "c13", "c14"),
    residual_mrad=np.stack([BEFORE, AFTER]),
)


def report(diagnosis: Diagnosis) -> str:
    calibration, context = paper()
    assert calibration.gaze is not None
    return render_report(
        replace(calibration, gaze=replace(calibration.gaze, diagnosis=diagnosis)), context
    )


def test_a_cause_is_said_with_remedy_and_effect() -> None:
    page = report(Diagnosis("base", (STEP,), (STEP,)))
    assert "From row c13 on alpha2 reads 0.250 ± 0.012 deg more than before" in page
    assert STEP.hypothesis.remedy in page
    assert "moves a depth by up to 7.2 of its u" in page
    assert "residuals are 4.1 times what is stated without it, 0.92 times with it" in page


@pytest.mark.parametrize("seen_in", ["references", "both"])
def test_scatter_of_references_is_no_residual_of_rows(seen_in: SeenIn) -> None:
    """Theirs is over what the rows have widened: another figure than that of gate `residuals`."""
    cause = replace(STEP, seen_in=seen_in)
    page = report(Diagnosis("base", (cause,), (cause,)))
    said = "4.1 times what the calibration leads to expect without it, 0.92 times with it"
    assert f"errors of independent depths and lengths are {said}" in page
    assert "times what is stated" not in page
    assert "Residuals of independent depths and lengths, by base alone" in page


def test_the_table_has_the_evidence_by_which_a_cause_was_named() -> None:
    """Of the rows alone, that of a cause named with references may be below the limit."""
    alone, named = replace(STEP, gain=-0.7), replace(STEP, seen_in="both", gain=17.9)
    page = html.document_fromstring(report(Diagnosis("base", (named,), (alone,))))
    rows = table(page, "Mistakes tried")
    assert [[row[i].text_content() for i in (0, 3, 4)] for row in rows] == [
        ["reading-step", "rows and references", "17.9"],
        ["reading-step", "rows", "−0.7"],
    ]


def test_causes_that_cannot_be_distinguished_name_each_other() -> None:
    drift = replace(STEP, name="reading-drift", gain=40.0, at=None)
    page = report(Diagnosis("base", (STEP, drift), (STEP, drift)))
    assert "As well it may be reading-drift" in page
    assert "As well it may be reading-step" in page


def test_nothing_found_is_said() -> None:
    page = report(Diagnosis("base", (), (replace(STEP, gain=-3.0),)))
    assert "none explains the rows decisively better" in page


def test_the_picture_holds_both_residuals() -> None:
    drawing = draw_cause(STEP)
    assert drawing.data["id"] == STEP.ids
    np.testing.assert_array_equal(drawing.data["before_mrad"], BEFORE)
    np.testing.assert_array_equal(drawing.data["after_mrad"], AFTER)


def test_a_cause_beside_the_first_is_said_with_its_remedy_and_drawn() -> None:
    far = replace(
        STEP, name="reference-bias-far", at="from 900 mm", estimate=3.0, std=0.4, gain=9.0,
        beside="reading-step", ids=("c12", "c14"), residual_mrad=np.array([[0.3, 0.2], [0.1, 0.0]]),
    )  # fmt: skip
    diagnosis = Diagnosis("base", (STEP, far), (STEP,))
    page = report(diagnosis)
    assert "Beside reading-step, reference depths from 900 mm are 3.00 ± 0.40 % off" in page
    assert far.hypothesis.remedy in page
    assert "As well it may be" not in page
    assert "Once that is allowed for, the rows show reference-bias-far as well" in page
    words = diagnosis.words(STEP)
    assert far.hypothesis.remedy in words
    drawing = draw_cause(STEP, far)
    np.testing.assert_array_equal(drawing.data["both_mrad"], [0.1, np.nan, 0.0])
