"""Structure of residuals, and priors that rows stretch.

Evidence: simulated truth; of clean rigs the probabilities must be uniform.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.diagnosis.structure import residual_structure, stretched_priors, structured
from calib.fit.robust import fit_model
from tests.diagnosis.faulty_rigs import fitted, tried_on

RIGS = 30


def test_a_slip_is_a_step_against_order(tmp_path: Path) -> None:
    shown = structured(residual_structure(tried_on(tmp_path, "reading-step").base))
    assert shown is not None
    assert shown.against.startswith("order")
    step = residual_structure(tried_on(tmp_path, "reading-step").base)[0]
    assert step.against == "order, a step"
    # Weights of a bent fit may move the place by a row.
    assert step.at in ("g12", "g13", "g14")
    assert step.probability < 1e-4


def test_drift_is_a_slope_against_order(tmp_path: Path) -> None:
    tests = residual_structure(tried_on(tmp_path, "reading-drift").base)
    slope = next(t for t in tests if t.against == "order, a slope")
    assert slope.probability == min(t.probability for t in tests)


def test_clean_residuals_have_probabilities_as_chance_has_them(tmp_path: Path) -> None:
    slopes = []
    for seed in range(RIGS):
        tests = residual_structure(tried_on(tmp_path, seed=seed).base)
        assert structured(tests) is None
        slopes.append(next(t.probability for t in tests if t.against == "order, a slope"))
    # Kolmogorov's distance of 30 uniform numbers is below 0.29 in 99 of 100 cases.
    grid = np.arange(1, RIGS + 1) / RIGS
    distance = np.max(np.abs(np.sort(slopes) - grid + 0.5 / RIGS))
    assert distance < 0.29


def test_a_wrong_focal_length_stretches_the_prior_of_the_encoder_scale(tmp_path: Path) -> None:
    rows, priors, _, _ = fitted(tmp_path, "c1-focal-length", 6.0, rows=40)
    fit = fit_model(rows, priors, model="encoder")
    (scale,) = (s for s in stretched_priors(fit, priors) if s.name == "encoder_scale")
    assert scale.deviations > 2.5
    clean, known, _, _ = fitted(tmp_path, rows=40)
    assert stretched_priors(fit_model(clean, known, model="encoder"), known) == ()
