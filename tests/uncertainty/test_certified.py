"""Evidence: property, and agreement with the parts tested on their own."""

from __future__ import annotations

import math

import known_case
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.uncertainty.certified import (
    CERTIFIED_DEPTHS,
    CertifiedDepth,
    certify_depths,
    check_depth,
    depths_to_certify,
)
from calib.uncertainty.conformity import ToleranceRule
from calib.uncertainty.depth import reading_at


def test_depths_of_the_published_range() -> None:
    assert depths_to_certify(485.9, 1008.5) == (490, 620, 740, 870, 1000)


@given(st.floats(1, 1e4), st.floats(1e-3, 1e5))
def test_depths_lie_inside_the_range_and_are_three_at_least(low: float, span: float) -> None:
    high = low + span
    depths = depths_to_certify(low, high)
    slack = 1e-12 * high
    assert all(low - slack <= z <= high + slack for z in depths)
    assert 3 <= len(depths) <= CERTIFIED_DEPTHS
    assert list(depths) == sorted(set(depths))


def test_a_range_without_extent_has_one_depth() -> None:
    assert depths_to_certify(500, 500) == (500,)


@pytest.mark.parametrize(
    ("z", "extrapolated"), [(500, False), (1000, False), (499, True), (1001, True)]
)
def test_depths_outside_the_calibration_are_marked(z: float, extrapolated: bool) -> None:
    found = check_depth(
        name="row",
        reference_mm=z,
        u_reference_mm=1.0,
        z_mm=z + 2,
        u_mm=2.0,
        low95_mm=z - 2,
        high95_mm=z + 6,
        calibrated_mm=(500, 1000),
        tolerance=None,
    )
    assert found.extrapolated == extrapolated
    assert found.conformity is None
    assert found.consistent


def test_an_error_beyond_its_uncertainty_is_not_consistent() -> None:
    common = {
        "name": "row",
        "reference_mm": 1000.0,
        "u_reference_mm": 1.0,
        "u_mm": 2.0,
        "calibrated_mm": (500.0, 1500.0),
        "tolerance": None,
    }
    # The interval reaches further up than down; an error upwards is judged by its lower side.
    high = check_depth(z_mm=1006, low95_mm=1002, high95_mm=1016, **common)
    assert not high.consistent
    low = check_depth(z_mm=994, low95_mm=990, high95_mm=1004, **common)
    assert low.consistent


def test_certified_depth_is_at_the_least_certain_ray() -> None:
    instrument = known_case.instrument()
    rays = [reading_at(instrument.theta, z_mm=800, x1c=x) for x in (-0.3, 0.0, 0.1)]
    (found,) = certify_depths(
        instrument,
        [rays],
        np.random.default_rng(1),
        calibrated_mm=(500, 1000),
        tolerance=ToleranceRule(0.02, "simple"),
    )
    assert isinstance(found, CertifiedDepth)
    assert found.result.x1c == -0.3
    assert not found.extrapolated
    assert found.conformity is not None
    assert found.position.position_mm[0] == pytest.approx(-0.3 * 800)
    assert math.isclose(found.position.position_mm[2], found.result.z_mm)
