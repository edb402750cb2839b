"""Control charts. Evidence: published run lengths, simulated histories, a planted fault."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import norm

from calib.uncertainty.charts import (
    CUSUM_ALLOWANCE,
    CUSUM_LIMIT,
    Chart,
    Reference,
    charts,
    cusum,
    ewma,
    reference,
    scatter_test,
    shewhart,
    standardised,
)

LOG = logging.getLogger(__name__)
"""Shown by pytest --log-cli-level=INFO."""


def run_lengths(chart: Callable[[np.ndarray], Chart], *, shift: float, of: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(of):
        z = np.empty(0)
        while True:
            z = np.concatenate([z, shift + rng.standard_normal(400 if shift == 0 else 20)])
            alarm = chart(z).first_alarm
            if alarm is not None:
                found.append(alarm + 1)
                break
    return np.array(found, dtype=float)


def test_steps_of_two_uncertainties_are_found_within_the_bars() -> None:
    """Shewhart: 1 / P(|z + 2| > 3) = 6.30; EWMA with widening limits: below 3.5 in tables."""
    expected = 1 / (norm.sf(1) + norm.cdf(-5))
    found = run_lengths(shewhart, shift=2.0, of=600)
    assert found.mean() == pytest.approx(expected, abs=4 * expected / np.sqrt(600))
    assert expected < 7
    weighted = run_lengths(ewma, shift=2.0, of=600).mean()
    LOG.info("step of 2 u: Shewhart %.2f, EWMA %.2f calibrations", found.mean(), weighted)
    assert weighted < 3


def test_cusum_run_length_by_markov_chain() -> None:
    """Hawkins (1993) gives h = 4.77 at k = 0.5 for a two-sided run length of 370.

    Brook and Evans (1972): states of width w, one side; two equal sides halve the run length.
    """
    states = 400
    width = 2 * CUSUM_LIMIT / (2 * states - 1)
    at = np.arange(states) * width
    edge = at[None, :] - at[:, None] + CUSUM_ALLOWANCE
    move = norm.cdf(edge + width / 2) - norm.cdf(edge - width / 2)
    move[:, 0] = norm.cdf(edge[:, 0] + width / 2)
    length = np.linalg.solve(np.eye(states) - move, np.ones(states))[0] / 2
    assert length == pytest.approx(370, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("chart", [shewhart, ewma, cusum])
def test_in_control_run_length(chart: Callable[[np.ndarray], Chart]) -> None:
    """1,600 histories: the mean's standard error is 2.5 % of 370, four of them the bar's 10 %."""
    mean = run_lengths(chart, shift=0.0, of=1600).mean()
    LOG.info("%s: in-control run length %.0f", chart.__name__, mean)
    assert mean == pytest.approx(370, rel=0.1)


def test_standardised_deviations_have_unit_variance() -> None:
    rng = np.random.default_rng(2)
    u = np.array([0.3, 0.5, 0.2, 0.4])
    z = []
    for _ in range(4000):
        x = 7 + u * rng.standard_normal(4)
        z.append(standardised(x[3:], u[3:], reference(x[:3], u[:3]))[0])
    assert np.std(z) == pytest.approx(1, abs=4 / np.sqrt(2 * 4000))


def test_scatter_finds_uncertainties_that_are_too_small() -> None:
    rng = np.random.default_rng(3)
    u = np.full(12, 0.1)
    sound = [scatter_test(u * rng.standard_normal(12), u)[1] for _ in range(1000)]
    assert np.mean(np.array(sound) < 0.05) == pytest.approx(0.05, abs=0.028)
    assert scatter_test(2 * u * rng.standard_normal(12), u)[1] < 0.01
    with pytest.raises(ValueError, match="two calibrations"):
        scatter_test(u[:1], u[:1])


def test_a_step_downwards_is_on_the_low_side_of_all() -> None:
    values = np.r_[np.zeros(4), np.full(8, -4.0)]
    for chart in charts(values, np.ones(12), Reference(0.0, 0.2)):
        assert chart.first_alarm is not None
        assert chart.statistic[chart.first_alarm] < 0
        assert chart.first_alarm >= 4


@pytest.mark.parametrize("accepted", [1, 5])
def test_the_error_of_the_reference_raises_no_alarms(accepted: int) -> None:
    """2,000 sound rigs: as many false alarms within ten calibrations as with a known reference.

    Those of independent deviations are simulated as well (2.7 % Shewhart and EWMA, 1.4 % CUSUM);
    the standard error of a difference of two shares is below 0.5 %.
    """
    rng = np.random.default_rng(5)
    estimated, known = np.zeros(3), np.zeros(3)
    for _ in range(2000):
        x = rng.standard_normal(accepted + 10)
        at = reference(x[:accepted], np.ones(accepted))
        found = charts(x[accepted:], np.ones(10), at)
        estimated += [chart.first_alarm is not None for chart in found]
        exact = charts(rng.standard_normal(10), np.ones(10), Reference(0.0, 0.0))
        known += [chart.first_alarm is not None for chart in exact]
    assert np.all(estimated <= known + 4 * 0.005 * 2000)
