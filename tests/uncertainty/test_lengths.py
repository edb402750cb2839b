"""Evidence: closed forms, property, simulated truth."""

from __future__ import annotations

import math

import known_case
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.geometry.parameters import embed
from calib.geometry.plane import Gaze
from calib.uncertainty.depth import position_uncertainty, reading_at
from calib.uncertainty.lengths import (
    Length,
    LengthError,
    length_budget,
    length_draws,
    length_errors,
    length_limit,
)
from calib.uncertainty.measurement import Instrument, ReadingSpread
from calib.uncertainty.position import positions


def _ends(instrument: Instrument):
    theta = instrument.theta
    return (
        reading_at(theta, z_mm=800, x1c=-0.2, y1c=0.05),
        reading_at(theta, z_mm=900, x1c=0.25, y1c=-0.1),
    )


def test_length_budget_agrees_with_numeric_derivatives() -> None:
    """Both ends move together with the parameters."""
    instrument = known_case.instrument()
    start, end = _ends(instrument)
    table = length_budget(instrument, start, end)
    p = instrument.parameters
    gaze = Gaze(*np.array([start.values, end.values]).T)

    def length(values: np.ndarray) -> float:
        first, second = positions(embed(values, p.names), gaze)
        return float(np.linalg.norm(second - first))

    assert table.estimate == pytest.approx(length(p.values), rel=1e-12)
    regression = p.covariance[1, 0] / p.covariance[0, 0]
    # delta2 follows the baseline as it is correlated with it, and then moves alone.
    for i, step in enumerate((1e-4 * np.array([1, regression]), np.array([0, 1e-7]))):
        h = step[i]
        slope = (length(p.values + step) - length(p.values - step)) / (2 * h)
        assert table.rows[i].input.sensitivity == pytest.approx(slope, rel=1e-5)
    assert len(table.rows) == 2 + 2 * 2
    shares = sum(r.share_percent for r in table.rows) + sum(
        r.share_percent for r in table.correlations
    )
    assert shares == pytest.approx(100, abs=1e-9)


def test_shared_parameters_do_not_count_twice() -> None:
    """At equal depth a baseline error scales the length; it does not shake its ends apart."""
    p = known_case.knowledge()
    instrument = Instrument(p, ReadingSpread())
    theta = instrument.theta
    start, end = (reading_at(theta, z_mm=1000, x1c=x) for x in (-0.1, 0.1))
    table = length_budget(instrument, start, end)
    u_z = position_uncertainty(instrument, start, np.random.default_rng(0)).standard_uncertainty_mm[
        2
    ]
    apart = math.sqrt(2) * u_z
    assert table.standard_uncertainty < 0.5 * apart


def test_monte_carlo_of_a_length_agrees_with_its_budget() -> None:
    instrument = known_case.instrument()
    start, end = _ends(instrument)
    mc = length_draws(instrument, start, end, np.random.default_rng(1)).summary()
    u = length_budget(instrument, start, end).standard_uncertainty
    # Second-order terms: (u_z / z)² is about 1e-4 of u.
    assert mc.standard_uncertainty == pytest.approx(u, rel=2e-3, abs=2 * mc.numerical_uncertainty)


def test_length_error_holds_its_reference() -> None:
    instrument = known_case.instrument()
    start, end = _ends(instrument)
    bar = Length("bar", start, end, reference_mm=400.0, u_reference_mm=2.0)
    (found,) = length_errors(instrument, [bar], np.random.default_rng(2))
    table = length_budget(instrument, start, end)
    assert found.error_mm == pytest.approx(table.estimate - 400)
    assert found.standard_uncertainty_mm == pytest.approx(math.hypot(table.standard_uncertainty, 2))
    assert found.bound_mm > abs(found.error_mm)


def test_coinciding_points_have_no_length() -> None:
    instrument = known_case.instrument()
    start, _ = _ends(instrument)
    with pytest.raises(ValueError, match="different points"):
        length_budget(instrument, start, start)


def _error(reference: float, error: float, expanded: float = 0.0) -> LengthError:
    return LengthError("x", reference + error, reference, expanded / 2, expanded)


def test_limit_passes_through_the_points_that_decide_it() -> None:
    errors = [_error(100, 1.0), _error(500, -2.0), _error(900, 5.0), _error(1000, 4.0)]
    limit = length_limit(errors)
    # The line through the first and the third lies above the others.
    assert limit.slope == pytest.approx(4 / 800)
    assert limit.constant_mm == pytest.approx(0.5)
    assert (limit.shortest_mm, limit.longest_mm, limit.count) == (100, 1000, 4)


def test_limit_of_one_length_and_of_shrinking_errors() -> None:
    one = length_limit([_error(400, -3.0, 1.0)])
    assert one.constant_mm + one.slope * 400 == pytest.approx(4.0)
    falling = length_limit([_error(100, 5.0), _error(900, 1.0)])
    assert (falling.constant_mm, falling.slope) == (pytest.approx(5.0), 0.0)


@given(
    st.lists(
        st.tuples(st.floats(10, 2000), st.floats(-20, 20), st.floats(0.01, 5)),
        min_size=1,
        max_size=12,
    )
)
@settings(max_examples=60, deadline=None)
def test_limit_lies_above_every_bound_and_below_the_constant_one(rows) -> None:
    errors = [_error(*row) for row in rows]
    limit = length_limit(errors)
    mean = float(np.mean([e.reference_mm for e in errors]))
    highest = max(e.bound_mm for e in errors)
    for e in errors:
        bound = limit.constant_mm + limit.slope * e.reference_mm
        assert bound >= e.bound_mm - 1e-9 * highest
    assert limit.constant_mm + limit.slope * mean <= highest * (1 + 1e-12)
