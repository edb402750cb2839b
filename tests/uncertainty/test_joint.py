"""Evidence: closed form (covariance of the random numbers), agreement with draws of every input by
itself, property (each quantity stops by its own rule, and is what it would be alone).
"""

from __future__ import annotations

import math

import known_case
import numpy as np
import pytest

from calib.core.errors import EstimationError
from calib.geometry.parameters import INDEX
from calib.uncertainty import lengths
from calib.uncertainty.depth import (
    POSITION_TRIALS,
    PointUncertainty,
    depth_uncertainty,
    point_uncertainties,
    position_uncertainty,
    reading_at,
)
from calib.uncertainty.distributions import PARTS, draw
from calib.uncertainty.joint import FixedNumber, MeasuredPoints, Quantity, propagate_together
from calib.uncertainty.lengths import Length, length_draws, length_errors
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    SharedErrors,
    Spread,
)
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import (
    BLOCK_TRIALS,
    MINIMUM_BLOCKS,
    MonteCarlo,
    Results,
    propagate,
)
from calib.uncertainty.trials import draw_trials, reading_errors

NAMES = ("baseline_mm", "delta2_rad", "axis_z_mm")
VALUES = np.array([77.0, 0.013, -20.0])
SIZE = np.array([0.4, 4e-4, 0.8])
OWN = ReadingSpread(
    x1c=Spread(normal=2e-4),
    y1c=Spread(normal=1e-4),
    alpha2_rad=Spread(normal=1e-4, width=4e-4),
)


def _shared(by_shared: np.ndarray) -> SharedErrors:
    return SharedErrors(("camera",) * by_shared.shape[1], by_shared)


def _loadings(rng: np.random.Generator, count: int, m: int) -> np.ndarray:
    return 3e-4 * rng.standard_normal((count, 4, m))


BY_SHARED = {
    "more errors than parameters": SIZE[:, None] * np.random.default_rng(0).normal(size=(3, 9)),
    "fewer": SIZE[:, None] * np.random.default_rng(1).normal(size=(3, 2)),
    "of one direction": np.outer(SIZE, np.ones(6)),
    "of no effect on parameters": np.zeros((3, 5)),
    "none": np.zeros((3, 0)),
}


@pytest.mark.parametrize("by_shared", BY_SHARED.values(), ids=BY_SHARED.keys())
def test_few_random_numbers_have_the_covariance_of_all_the_errors(by_shared: np.ndarray) -> None:
    """Closed form: J Jᵀ, J from each of the m + 8 errors to parameters and two readings."""
    m = by_shared.shape[1]
    # All that is uncertain of the parameters comes from the shared errors.
    p = ParameterKnowledge(NAMES, VALUES, by_shared @ by_shared.T, None, ("A",) * 3)
    own = ReadingSpread(x1c=Spread(normal=2e-4), alpha2_rad=Spread(normal=1e-4))
    instrument = Instrument(p, own, _shared(by_shared))
    loadings = _loadings(np.random.default_rng(2), 2, m)
    trials = draw_trials(instrument, np.random.default_rng(3), readings=2, part=0)
    moved = trials.planes.theta[:, [INDEX[name] for name in NAMES]].T - VALUES[:, None]
    errors = np.vstack([moved, reading_errors(instrument, loadings)(trials)])
    # Both are linear in the random numbers: the matrix follows without any scatter.
    matrix = np.linalg.lstsq(trials.normal.T, errors.T)[0].T
    assert len(trials.normal) <= 3 + 8
    jacobian = np.vstack([by_shared, loadings.reshape(8, m)])
    expected = jacobian @ jacobian.T
    expected[3:, 3:] += np.diag(np.tile([2e-4, 0, 1e-4, 0], 2) ** 2)
    scale = np.sqrt(np.maximum(np.diag(expected), 1e-16))
    unit = np.outer(scale, scale)
    # The parameters' own covariance is a difference, zero but for rounding: 1e-8 of u. What the
    # factor takes as none has at most 1e-12 of a variance, 1e-6 of u.
    np.testing.assert_allclose(matrix @ matrix.T / unit, expected / unit, atol=1e-6)


def _instrument(*, posterior: bool) -> Instrument:
    rng = np.random.default_rng(4)
    by_shared = 0.5 * BY_SHARED["more errors than parameters"]
    own = VALUES + SIZE * rng.standard_normal((40_000, 3))
    common = rng.standard_normal((40_000, by_shared.shape[1]))
    covariance = np.diag(SIZE**2) + by_shared @ by_shared.T
    draws = own + common @ by_shared.T if posterior else None
    p = ParameterKnowledge(
        NAMES, VALUES, covariance, None if posterior else math.inf, ("A",) * 3, draws
    )
    shared = SharedErrors(("camera",) * 9, by_shared, own if posterior else None)
    return Instrument(p, OWN, shared)


def _readings(instrument: Instrument) -> tuple[Reading, Reading, Reading]:
    """Return two readings of their own, and one with the depth of the first."""
    loadings = _loadings(np.random.default_rng(5), 3, 9)
    theta = instrument.theta
    start, end = (
        Reading(r.x1c, r.y1c, r.alpha2_rad, shared=loadings[i])
        for i, r in enumerate(
            (
                reading_at(theta, z_mm=800, x1c=-0.2, y1c=0.05),
                reading_at(theta, z_mm=900, x1c=0.25, y1c=-0.1),
            )
        )
    )
    return start, end, Reading(0.1, 0.02, 1.0, shared=loadings[2], depth_from=start)


def _agree(first: MonteCarlo, second: MonteCarlo) -> None:
    """Assert that two independent results agree, within three standard deviations."""
    pairs = (
        (first.estimate, second.estimate, "numerical_estimate"),
        (first.standard_uncertainty, second.standard_uncertainty, "numerical_uncertainty"),
        (first.symmetric.low, second.symmetric.low, "numerical_low"),
        (first.symmetric.high, second.symmetric.high, "numerical_high"),
    )
    for a, b, name in pairs:
        # Numerical uncertainties are twice the standard deviation.
        doubt = 1.5 * math.hypot(getattr(first, name), getattr(second, name))
        assert a == pytest.approx(b, abs=doubt)


@pytest.mark.parametrize("posterior", [False, True])
def test_trials_give_what_draws_of_every_input_by_itself_give(*, posterior: bool) -> None:
    instrument = _instrument(posterior=posterior)
    start, end, borrowed = _readings(instrument)
    model = MeasurementModel(instrument, [start, end, borrowed])

    values = {
        "depth": lambda points: points[1, 2],
        "height": lambda points: points[0, 1],
        "length": lambda points: np.linalg.norm(points[1] - points[0], axis=0),
        "on one board": lambda points: np.linalg.norm(points[2] - points[0], axis=0),
        "sum of depths": lambda points: points[0, 2] + points[1, 2],
    }
    results = {name: Results(model.blocks) for name in values}
    asked = MeasuredPoints(model, tuple(Quantity(f, results[name]) for name, f in values.items()))
    assert propagate_together(instrument, [asked], np.random.default_rng(6)) == (None,)
    for i, (name, value) in enumerate(values.items()):
        alone = propagate(
            lambda inputs, value=value: value(model.positions(inputs).transpose(1, 2, 0)),
            model.blocks,
            np.random.default_rng(100 + i),
        ).summary()
        together = results[name].draws().summary()
        assert together.stable
        _agree(together, alone)


def test_points_of_one_board_share_its_depth_in_every_trial() -> None:
    instrument = _instrument(posterior=True)
    start, _, borrowed = _readings(instrument)
    model = MeasurementModel(instrument, [start, borrowed])
    trials = draw_trials(instrument, np.random.default_rng(7), readings=2, part=0)
    z = model.positions_in(trials)[:, 2]
    assert z.shape == (2, BLOCK_TRIALS)
    np.testing.assert_array_equal(z[0], z[1])


def _loose() -> Instrument:
    """Return an instrument that measures near points, and cannot distinguish 60 m from infinity."""
    return Instrument(known_case.knowledge(), ReadingSpread(x1c=Spread(normal=1e-3)))


def test_each_point_has_the_results_it_has_alone() -> None:
    """Exactly so: settled or failed, it neither gets trials that others need, nor takes any."""
    instrument = _loose()
    theta = instrument.theta
    near, middle, far = (reading_at(theta, z_mm=z, x1c=0.1) for z in (300, 1200, 60_000))
    found = point_uncertainties(instrument, [near, far, middle], np.random.default_rng(8))
    assert isinstance(found[1], EstimationError)
    assert "no end" in str(found[1])
    trials = []
    for reading, together in ((near, found[0]), (middle, found[2])):
        assert isinstance(together, PointUncertainty)
        depth, draws = depth_uncertainty(instrument, reading, np.random.default_rng(8))
        position = position_uncertainty(instrument, reading, np.random.default_rng(8))
        assert together.depth == depth
        np.testing.assert_array_equal(together.draws.values, draws.values)
        assert together.position.coverage_factor == position.coverage_factor
        np.testing.assert_array_equal(together.position.semi_axes_mm, position.semi_axes_mm)
        assert together.position.trials == POSITION_TRIALS
        trials.append(together.depth.monte_carlo.trials)
    # Digits and verdict of one ask for more trials than those of the other.
    assert len(set(trials)) == 2
    assert min(trials) >= MINIMUM_BLOCKS * BLOCK_TRIALS
    with pytest.raises(EstimationError, match="no end"):
        depth_uncertainty(instrument, far, np.random.default_rng(8))


def test_given_draws_are_used_evenly() -> None:
    """Each part twice at least, whatever the digits ask for."""
    instrument = _instrument(posterior=True)
    start, _, _ = _readings(instrument)
    result, _ = depth_uncertainty(instrument, start, np.random.default_rng(9), digits=1)
    assert result.monte_carlo.trials >= 2 * PARTS * BLOCK_TRIALS


def test_depth_and_position_of_a_point_are_of_the_same_trials() -> None:
    """On the axis of C1, without errors of the ray, position is depth and the ellipsoid a line."""
    p = known_case.knowledge()
    rng = np.random.default_rng(10)
    few = rng.multivariate_normal(p.values, p.covariance, 2000)
    instrument = Instrument(
        known_case.knowledge(degrees_of_freedom=None, draws=few),
        ReadingSpread(alpha2_rad=Spread(width=known_case.STEP)),
    )
    reading = reading_at(instrument.theta, z_mm=1000, x1c=0.0)
    (found,) = point_uncertainties(instrument, [reading], rng)
    assert isinstance(found, PointUncertainty)
    # So few draws that more trials would be of no use: depth stops where the position does.
    assert found.depth.monte_carlo.trials == found.position.trials == POSITION_TRIALS
    u = found.depth.budget.standard_uncertainty
    ordered = np.sort(np.abs(found.draws.values - found.depth.z_mm)) / u
    expected = ordered[math.ceil(0.95 * POSITION_TRIALS) - 1]
    assert found.position.coverage_factor == pytest.approx(expected, rel=1e-9)


def test_lengths_together_agree_with_each_alone() -> None:
    instrument = _instrument(posterior=False)
    start, end, borrowed = _readings(instrument)
    bars = [Length("bar", start, end, 400.0, 0.5), Length("board", start, borrowed, 240.0, 0.5)]
    found = length_errors(instrument, bars, np.random.default_rng(11))
    assert [error.name for error in found] == ["bar", "board"]
    for bar, error in zip(bars, found, strict=True):
        (other,) = length_errors(instrument, [bar], np.random.default_rng(12))
        mc = length_draws(instrument, bar.start, bar.end, np.random.default_rng(13)).summary()
        assert error.measured_mm == other.measured_mm
        assert error.standard_uncertainty_mm == other.standard_uncertainty_mm
        # Three standard deviations of a difference of ends, each known to half `numerical`.
        doubt = 1.5 * math.sqrt(2) * max(mc.numerical_low, mc.numerical_high)
        assert error.expanded_uncertainty_mm == pytest.approx(
            other.expanded_uncertainty_mm, abs=doubt
        )


def test_more_lengths_than_share_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    instrument = known_case.instrument()
    theta = instrument.theta
    ends = [reading_at(theta, z_mm=400, x1c=x) for x in (-0.2, 0.0, 0.1, 0.3)]
    bars = [Length(f"bar {i}", ends[i], ends[i + 1], 100.0, 0.5) for i in range(3)]
    together = length_errors(instrument, bars, np.random.default_rng(17))
    monkeypatch.setattr(lengths, "TOGETHER", 2)
    found = length_errors(instrument, bars, np.random.default_rng(17))
    assert found[:2] == length_errors(instrument, bars[:2], np.random.default_rng(17))
    assert [error.measured_mm for error in found] == [error.measured_mm for error in together]
    # The last has other trials: ends known to half a unit of two digits, 5 % of u, 2.5 % of U.
    assert found[2].expanded_uncertainty_mm == pytest.approx(
        together[2].expanded_uncertainty_mm, rel=0.025 * math.sqrt(2)
    )


def test_no_lengths_have_no_errors() -> None:
    assert length_errors(known_case.instrument(), [], np.random.default_rng(0)) == ()


def test_equal_generators_give_equal_points() -> None:
    instrument = _instrument(posterior=True)
    readings = _readings(instrument)[:2]
    first, second = (
        point_uncertainties(instrument, readings, np.random.default_rng(14)) for _ in range(2)
    )
    for a, b in zip(first, second, strict=True):
        assert isinstance(a, PointUncertainty)
        assert isinstance(b, PointUncertainty)
        assert a.depth == b.depth
        assert a.position.coverage_factor == b.position.coverage_factor


def test_a_fixed_number_of_trials_is_rounded_up_to_blocks() -> None:
    collector = FixedNumber(BLOCK_TRIALS + 1)
    collector.add(np.zeros(BLOCK_TRIALS))
    assert not collector.settled
    collector.add(np.ones(BLOCK_TRIALS))
    assert collector.settled
    assert collector.values().sum() == BLOCK_TRIALS


def test_position_ellipsoid_holds_95_percent_of_draws_of_every_input_by_itself() -> None:
    instrument = _instrument(posterior=True)
    start, _, _ = _readings(instrument)
    result = position_uncertainty(instrument, start, np.random.default_rng(15))
    model = MeasurementModel(instrument, [start])
    rng = np.random.default_rng(16)
    fresh = np.vstack(
        [
            np.hstack([draw(block, rng, BLOCK_TRIALS, part=part) for block in model.blocks])
            for part in range(2 * PARTS)
        ]
    )
    away = (model.positions(fresh)[:, 0] - result.position_mm) @ result.directions
    inside = np.mean(((away / result.semi_axes_mm) ** 2).sum(axis=1) <= 1)
    # Both samples scatter: sqrt(0.95 · 0.05 · 2 / 2e5) = 0.0007.
    assert inside == pytest.approx(0.95, abs=0.0021)
