"""Gates and warnings on what the rows leave open. Evidence: properties."""

from __future__ import annotations

from dataclasses import replace

from report_examples import paper

from calib.fit.identifiability import Identifiability
from calib.results import GazeResult
from calib.verdict import gaze_gates, gaze_warnings


def gaze() -> GazeResult:
    found = paper()[0].gaze
    assert found is not None
    return found


def spoilt(model: str) -> GazeResult:
    """Return the paper's results with depth left open by the rows of one model."""
    found = gaze()
    gate = replace(found.identifiability[model].gate, passed=False)
    told = found.identifiability | {model: replace(found.identifiability[model], gate=gate)}
    return replace(found, identifiability=told)


def test_depth_left_open_fails_the_gate_of_the_selected_model_alone() -> None:
    assert [gate for gate in gaze_gates(spoilt("base")) if not gate.passed] == []
    failed = [gate.name for gate in gaze_gates(spoilt("axis-offset")) if not gate.passed]
    assert failed == ["identified"]
    assert sum(gate.name == "identified" for gate in gaze_gates(gaze())) == 1


def warned(told: Identifiability) -> list[str]:
    found = replace(gaze(), identifiability=gaze().identifiability | {"axis-offset": told})
    return [text for text in gaze_warnings(found) if "prior" in text]


def test_what_is_left_to_the_prior_is_said_once() -> None:
    """Parameters in an open combination with its words; others decided by priors on their own."""
    told = gaze().identifiability["axis-offset"]
    (text,) = warned(told)
    assert told.open[0].words in text
    assert text.endswith("its prior decides baseline_mm and eccentricity_mm")
    closed = tuple(replace(c, remedies=()) for c in told.combinations)
    assert len(warned(replace(told, combinations=closed))) == 2
