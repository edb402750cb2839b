"""A prior that the rows contradict is named. Evidence: properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from report_examples import paper

from calib.checks.prior_conflict import prior_warnings
from calib.results.calibration import GazeResult


def gaze(**values: float) -> GazeResult:
    """Return the paper's results with other estimates of the selected model."""
    found = paper()[0].gaze
    assert found is not None
    fit = found.robust["axis-offset"]
    new = np.array([values.get(n, v) for n, v in zip(fit.names, fit.values, strict=True)])
    return replace(found, robust=found.robust | {"axis-offset": replace(fit, values=new)})


def test_the_papers_rows_stretch_nothing() -> None:
    assert list(prior_warnings(gaze(), {})) == []


def test_a_stretched_default_is_named_with_what_to_state() -> None:
    (said,) = prior_warnings(gaze(axis_z_mm=-66.0), {})
    assert said.startswith("prior stretched: the rows put axis_z_mm at -66 mm, 3.3 standard")
    assert "the default prior, 0 +- 20" in said
    assert "[priors] axis_z_mm = [-66, ...]" in said


def test_a_stated_prior_counts_and_is_named_as_the_manifests() -> None:
    assert list(prior_warnings(gaze(axis_z_mm=-66.0), {"axis_z_mm": (-60.0, 5.0)})) == []
    (said,) = prior_warnings(gaze(baseline_mm=90.0), {"baseline_mm": (77.0, 2.0)})
    assert "6.5 standard deviations from the manifest's prior, 77 +- 2" in said


def test_scaled_defaults_count_and_are_told() -> None:
    large = replace(gaze(axis_z_mm=-66.0), default_priors={"axis_z_mm": (0.0, 100.0)})
    (said,) = prior_warnings(large, {})
    assert "scaled to the baseline" in said
    assert "axis_z_mm 100" in said


def test_nothing_fitted_says_nothing() -> None:
    assert list(prior_warnings(replace(gaze(), comparison=None), {})) == []
