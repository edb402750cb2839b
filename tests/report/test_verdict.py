"""Gates and warnings on what the rows leave open. Evidence: properties."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from report_examples import paper

from calib.checks.references import disagreements
from calib.checks.verdict import all_gates, gaze_gates, gaze_warnings
from calib.fit.identifiability import Identifiability
from calib.report.page import render_report
from calib.report.sections.contradiction import what_the_errors_do
from calib.results.calibration import GazeResult


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
    assert text.endswith("baseline_mm and eccentricity_mm rest on prior knowledge")
    closed = tuple(replace(c, remedies=()) for c in told.combinations)
    assert len(warned(replace(told, combinations=closed))) == 2
    twice = replace(told, combinations=tuple(replace(c, **vars(told.open[0])) for c in closed))
    assert len(warned(twice)) == 1


def test_a_reading_that_tells_nothing_of_depth_fails() -> None:
    """However well the parameters are known."""
    found = gaze()
    assert found.depths is not None
    wide = replace(found.depths, middle_u_mm=0.3 * found.depths.middle_mm)
    blurred = replace(found, depths=wide)
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


def test_outliers_are_named_by_a_warning_or_their_gate() -> None:
    assert not [text for text in gaze_warnings(gaze()) if "disagree" in text]
    one = refitted(outliers=("g2",))
    (text,) = (text for text in gaze_warnings(one) if "disagree" in text)
    assert text.startswith("1 of 6 rows disagree with the others and hardly move the result: g2;")
    many = refitted(outliers=("g2", "g3"))
    assert not [text for text in gaze_warnings(many) if "disagree" in text]
    (failed,) = (gate for gate in gaze_gates(many) if not gate.passed)
    assert failed.name == "outliers"
    assert "g2, g3" in failed.detail


@pytest.mark.parametrize(
    ("pairs", "lenses", "passed"),
    [(0.03, (0.01, 0.012), True), (0.824, (0.012, 0.012), False), (0.9, (0.2, 0.1), True)],
)
def test_pairs_that_fit_far_worse_than_the_lenses_fail(
    pairs: float, lenses: tuple[float, ...], passed: bool
) -> None:
    found, _ = paper()
    stereo = SimpleNamespace(gates=(), rms_px=pairs)
    fits = {
        str(i): SimpleNamespace(selected=SimpleNamespace(rms_px=rms), gates=())
        for i, rms in enumerate(lenses)
    }
    images = replace(found.images, stereo=stereo, intrinsics=fits)
    (gate,) = (g for g in all_gates(images, None, {}) if g.name == "stereo-noise")
    assert gate.passed is passed
    assert ("bumped" in gate.detail) is not passed
    given = replace(images, stereo=SimpleNamespace(gates=(), rms_px=float("nan")))
    assert all_gates(given, None, {}) == ()


@pytest.mark.parametrize(("scatter", "named"), [(1e-3, True), (0.03, False)])
def test_a_common_factor_of_all_validation_depths_points_to_the_scale(
    scatter: float, named: bool
) -> None:
    """A board stated at 24 mm whose squares have 25: depths 4 % too short, give or take."""
    error = -0.04 + scatter * np.random.default_rng(0).normal(size=8)
    depth = np.linspace(600.0, 1200.0, 8)
    validation = SimpleNamespace(
        prediction=SimpleNamespace(low95_mm=depth - 1.0, high95_mm=depth + 1.0),
        errors=(
            SimpleNamespace(
                name="ruler", error_rel=error, reference_mm=depth, std_mm=np.full(8, 0.5)
            ),
        ),
        depth_of=np.arange(8),
        ids=tuple(f"v{i}" for i in range(8)),
    )
    (text,) = disagreements(replace(gaze(), validation=validation))
    assert ("All differ by about -4.0 %" in text) is named
    far = np.argsort(-np.abs(error * depth))
    assert f"the worst first: v{far[0]}, v{far[1]}, v{far[2]}" in text


def test_rows_of_one_depth_are_one_measurement_whichever_has_the_reference() -> None:
    """The second group's first row has no value of the reference; its depth row has."""
    depth = np.array([500.0, 500.0, 1000.0, 1000.0, 1000.0])
    error = np.array([0.05, 0.0, np.nan, 0.0, 0.05])
    validation = SimpleNamespace(
        prediction=SimpleNamespace(low95_mm=depth - 1.0, high95_mm=depth + 1.0),
        errors=(
            SimpleNamespace(
                name="tape",
                error_rel=error,
                reference_mm=np.where(np.isfinite(error), depth, np.nan),
                std_mm=np.full(5, 0.5),
            ),
        ),
        depth_of=np.array([0, 0, 3, 3, 3]),
        ids=("a", "b", "c", "d", "e"),
    )
    (text,) = disagreements(replace(gaze(), validation=validation))
    assert text.startswith("1 of 2 validation depths differ from tape")
    assert "the worst first: a)" in text


def test_uncertainties_stated_far_too_large_are_remarked_on() -> None:
    """Simulated: 20 rows whose residuals are a fiftieth of what is stated; honest ones say nothing.

    So do six rows, whose residuals may be small by chance.
    """
    honest = np.random.default_rng(1).standard_normal(20)

    def said(standardised: np.ndarray) -> list[str]:
        rejected = np.zeros(len(standardised), dtype=bool)
        found = refitted(standardised=standardised, rejected=rejected, data_parameters=4.0)
        return [text for text in gaze_warnings(found) if "lead to expect" in text]

    (text,) = said(honest / 50)
    assert "u_z_rel" in text
    assert "more certain than stated" in text
    assert said(honest) == []
    assert said(honest[:6] / 3) == []


def test_a_contradiction_says_what_the_errors_do_and_which_model_the_reference_prefers() -> None:
    """Figures of the paper's data: the ruler against the pairs."""
    page = render_report(*paper())
    first = page[page.index('class="notice') :][:1200]
    assert first.startswith('class="notice caution"')
    assert "Contradicted by the independent reference" in first
    assert "rise with depth, from −9.7 % at 350 mm to +5.6 % at 2120 mm" in first
    assert "validates worse there than base, 5.7 against 4.2 % rms" in first


def test_errors_without_order_are_said_by_their_ends() -> None:
    found = gaze()
    assert found.validation is not None
    error = found.validation.errors[0]
    rel = np.where(np.arange(len(error.error_rel)) % 2, 0.02, -0.01)
    mixed = replace(error, error_rel=rel)
    validation = replace(
        found.validation, errors=(mixed,), depth_of=np.arange(len(error.error_rel))
    )
    told = what_the_errors_do(replace(found, validation=validation), None)
    assert told.startswith("Against the reference depth is wrong by −1.0 to +2.0 %.")
    assert what_the_errors_do(replace(found, validation=None), "ruler") == ""
