"""Evidence: boundary cases of JCGM 106 and ILAC-G8, closed forms."""

from __future__ import annotations

import math

import known_case
import numpy as np
import pytest

from calib.uncertainty.conformity import (
    GUARD_FACTOR,
    Conformity,
    DecisionRule,
    ToleranceRule,
    Verdict,
    assess,
    conformance_probability,
    measured_conformity,
    predicted_conformity,
    worst,
)
from calib.uncertainty.depth import depth_uncertainty, reading_at

LIMIT = 10.0
U = 1.0
GUARD = GUARD_FACTOR * U
HAIR = 1e-6


def _assess(error: float, rule: DecisionRule, u: float = U) -> Conformity:
    return assess(
        error_mm=error,
        standard_uncertainty_mm=u,
        expanded_uncertainty_mm=1.96 * u,
        limit_mm=LIMIT,
        rule=rule,
    )


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("error", "verdict"),
    [
        (0.0, "pass"),
        (LIMIT - GUARD, "pass"),
        (LIMIT - GUARD + HAIR, "conditionalPass"),
        (LIMIT, "conditionalPass"),
        (LIMIT + HAIR, "conditionalFail"),
        (LIMIT + GUARD, "conditionalFail"),
        (LIMIT + GUARD + HAIR, "fail"),
    ],
)
def test_guard_band_boundaries(error: float, verdict: Verdict, sign: int) -> None:
    assert _assess(sign * error, "guard-band").verdict == verdict


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("error", "verdict"), [(0.0, "pass"), (LIMIT, "pass"), (LIMIT + HAIR, "fail"), (30.0, "fail")]
)
def test_simple_acceptance_boundaries(error: float, verdict: Verdict, sign: int) -> None:
    assert _assess(sign * error, "simple").verdict == verdict


def test_probability_at_the_boundaries() -> None:
    """JCGM 106: half at the tolerance limit, 95 % at the guarded limit, 5 % a guard band beyond."""
    for error, probability in ((LIMIT, 0.5), (LIMIT - GUARD, 0.95), (LIMIT + GUARD, 0.05)):
        assert _assess(error, "guard-band").probability == pytest.approx(probability, abs=1e-12)


def test_both_tails_count() -> None:
    probability = conformance_probability(error=0.0, standard_uncertainty=1.0, limit=1.96)
    assert probability == pytest.approx(0.95, abs=1e-4)


def test_a_small_tolerance_needs_95_percent_in_both_tails() -> None:
    """T = 1.8 u: T - g leaves room on one side, but both tails together hold 7 %."""
    found = _assess(0.0, "guard-band", u=LIMIT / 1.8)
    assert found.acceptance_limit_mm > 0
    assert found.probability == pytest.approx(0.928, abs=5e-4)
    assert found.verdict == "conditionalPass"


def test_a_tolerance_below_the_guard_band_admits_no_pass() -> None:
    found = _assess(0.0, "guard-band", u=LIMIT)
    assert found.acceptance_limit_mm < 0
    assert found.verdict == "conditionalPass"


def test_simple_acceptance_does_not_pass_what_the_uncertainty_cannot_see() -> None:
    found = _assess(0.0, "simple", u=LIMIT / 1.9)
    assert found.ratio < 1
    assert found.verdict == "conditionalPass"
    assert found.warning is not None
    assert "exceeds the tolerance" in found.warning


@pytest.mark.parametrize(("ratio", "warned"), [(3.0, False), (2.999, True), (10.0, False)])
def test_warning_below_a_ratio_of_three(ratio: float, warned: bool) -> None:
    found = _assess(0.0, "guard-band", u=LIMIT / ratio / 1.96)
    assert found.ratio == pytest.approx(ratio)
    assert (found.warning is not None) == warned


def test_warning_never_rounds_the_ratio_up_to_three() -> None:
    warning = _assess(0.0, "guard-band", u=LIMIT / 2.999 / 1.96).warning
    assert warning is not None
    assert "2.9" in warning


def test_the_worst_verdict_speaks_for_all() -> None:
    assert worst(["pass", "conditionalFail", "conditionalPass"]) == "conditionalFail"
    with pytest.raises(ValueError, match="empty"):
        worst([])


def test_prediction_uses_the_draws() -> None:
    instrument = known_case.instrument()
    reading = reading_at(instrument.theta, z_mm=1000, x1c=0.0)
    result, draws = depth_uncertainty(instrument, reading, np.random.default_rng(1))
    found = predicted_conformity(result, draws, tolerance=ToleranceRule(0.02, "guard-band"))
    assert found.error_mm == 0
    assert found.limit_mm == pytest.approx(20)
    assert found.probability == draws.share_within(980, 1020)
    half = max(1000 - result.interval.low, result.interval.high - 1000)
    assert found.expanded_uncertainty_mm == pytest.approx(half)


def _measured(u: float, high: float) -> Conformity:
    return measured_conformity(
        z_mm=1000,
        u_mm=u,
        low95_mm=992,
        high95_mm=high,
        reference_mm=985,
        u_reference_mm=3,
        tolerance=ToleranceRule(0.02, "guard-band"),
    )


def test_measurement_uses_the_error_and_the_reference_with_its_uncertainty() -> None:
    found = _measured(4.0, 1008.0)
    assert found.error_mm == 15
    assert found.limit_mm == pytest.approx(19.7)
    assert found.standard_uncertainty_mm == pytest.approx(5)
    assert found.expanded_uncertainty_mm == pytest.approx(math.hypot(8, 1.96 * 3), rel=1e-4)
    assert found.verdict == "conditionalPass"


def test_a_depth_without_upper_limit_never_passes() -> None:
    found = _measured(math.inf, math.inf)
    assert found.verdict == "conditionalPass"
    assert found.probability == 0
    assert found.warning is not None
