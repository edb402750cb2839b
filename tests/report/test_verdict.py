"""Gates and warnings on what the rows leave open. Evidence: properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
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


def test_targets_off_the_centre_column_are_named() -> None:
    found = gaze()
    assert not [text for text in gaze_warnings(found) if "centre column" in text]
    off = np.zeros(len(found.rows))
    off[2], off[4] = np.deg2rad([-2.0, 0.6])
    seen = replace(found, rows=replace(found.rows, gaze_residual_rad=off))
    (text,) = (text for text in gaze_warnings(seen) if "centre column" in text)
    assert text.startswith(f"in 2 of {len(off)} rows")
    assert f"2.0 deg in {found.rows.ids[2]}" in text


def test_a_reading_that_tells_nothing_of_depth_fails() -> None:
    """However well the parameters are known."""
    found = gaze()
    assert found.depths is not None
    wide = replace(found.depths.prediction, u_mm=0.3 * found.depths.depth_mm)
    blurred = replace(found, depths=replace(found.depths, prediction=wide))
    (failed,) = (gate for gate in gaze_gates(blurred) if not gate.passed)
    assert failed.name == "depth"
    assert "30 %" in failed.detail


def refitted(**changes: object) -> GazeResult:
    """Return the paper's results with another robust fit of the selected model."""
    found = gaze()
    fit = replace(found.robust["axis-offset"], **changes)
    return replace(found, robust=found.robust | {"axis-offset": fit})


def test_residuals_of_the_only_possible_model_have_a_tighter_limit() -> None:
    found = refitted(noise_scale=3.0)
    assert [gate for gate in gaze_gates(found) if not gate.passed] == []
    alone = replace(found, robust={"axis-offset": found.robust["axis-offset"]})
    (failed,) = (gate for gate in gaze_gates(alone) if not gate.passed)
    assert failed.name == "residuals"
    assert "add rows" in failed.detail


def test_a_large_zero_error_is_remarked_on() -> None:
    assert not [text for text in gaze_warnings(gaze()) if "zero error" in text]
    fit = gaze().robust["axis-offset"]
    values = np.array(fit.values)
    values[fit.names.index("delta2_rad")] = np.deg2rad(-9.0)
    found = gaze_warnings(refitted(values=values))
    assert [text for text in found if "-9.0 deg: if that is a surprise" in text]
