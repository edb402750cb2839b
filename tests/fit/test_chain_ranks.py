"""Rank statistics over simulated posteriors: the truth's rank among draws is uniform (Talts et al.
2018, arXiv 1804.06788), whatever the chains were told to propose, or they say that they failed.
"""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np
import pytest
from chain_targets import Known, narrowed, shifted, unharmed
from numpy.random import RandomState, SeedSequence
from scipy.stats import chisquare

from calib.fit import chains
from calib.fit.chains import Moves, run_chains
from calib.fit.importance import ImportanceSample, Proposal, sample_importance
from calib.fit.modes import find_left_out_mode

Damage = Callable[[ImportanceSample], ImportanceSample]

DRAWS = 99
"""Draws a posterior among which the truth has its rank, 0 to 99."""

PRIOR_STD = np.array([2.0, 1.0, 0.6])
"""Of a straight line's level and slope, and of the logarithm of its noise."""

ABSCISSAE = np.linspace(2.0, 3.0, 7)
"""Seven rows, away from 0: level and slope correlate at -0.99."""


def line(rng: np.random.Generator) -> tuple[Known, np.ndarray]:
    """Return the posterior of a line with unknown noise on simulated rows, and the truth."""
    truth = PRIOR_STD * rng.standard_normal(3)
    rows = truth[0] + truth[1] * ABSCISSAE
    rows += 0.3 * np.exp(truth[2]) * rng.standard_normal(len(rows))

    def density(x: np.ndarray) -> np.ndarray:
        miss = rows - x[:, :1] - x[:, 1:2] * ABSCISSAE
        scale = 0.3 * np.exp(np.clip(x[:, 2], -50, 50))
        likelihood = -0.5 * ((miss / scale[:, None]) ** 2).sum(axis=1) - len(rows) * x[:, 2]
        total: np.ndarray = likelihood - 0.5 * ((x / PRIOR_STD) ** 2).sum(axis=1)
        return total

    return Known(density, 3), truth


def square(rng: np.random.Generator) -> tuple[Known, np.ndarray]:
    """Return the posterior of a quantity of which only the square is seen, and of another."""
    truth = rng.standard_normal(2)
    seen = truth[0] ** 2 + 0.2 * rng.standard_normal()

    def density(x: np.ndarray) -> np.ndarray:
        total: np.ndarray = -0.5 * ((x[:, 0] ** 2 - seen) / 0.2) ** 2 - 0.5 * (x**2).sum(axis=1)
        return total

    return Known(density, 2), truth


def rank(chain: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return how many of some draws of a chain are below the truth, shape (d,)."""
    flat = chain.reshape(-1, len(truth))
    picked = flat[rng.choice(len(flat), DRAWS, replace=False)]
    return np.asarray((picked < truth).sum(axis=0))


def sampled(target: Known, rng: np.random.Generator) -> ImportanceSample:
    return sample_importance(target, np.zeros(3), np.diag(PRIOR_STD**2), rng)


def ranks_of_lines(count: int, damage: Damage) -> np.ndarray:
    """Return ranks of the truth, shape (count, 3)."""
    ranks = []
    for k in range(count):
        rng = np.random.default_rng(k)
        target, truth = line(rng)
        found = run_chains(target, damage(sampled(target, rng)), seed=SeedSequence(k))
        assert found.converged
        ranks.append(rank(found.chain, truth, rng))
    return np.array(ranks)


def p_value(ranks: np.ndarray, bins: int) -> float:
    """Return the probability of ranks as uneven as these, of the worst quantity."""
    counts = [np.bincount(r * bins // (DRAWS + 1), minlength=bins) for r in ranks.T]
    return min(float(chisquare(c).pvalue) for c in counts)


@pytest.fixture
def proposing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chains that propose from the sample, good or not."""
    monkeypatch.setattr(chains, "_good_proposal", lambda *_: True)


@pytest.mark.slow
@pytest.mark.usefixtures("proposing")
@pytest.mark.parametrize("damage", [unharmed, shifted, narrowed])
def test_ranks_are_uniform(damage: Damage) -> None:
    assert p_value(ranks_of_lines(300, damage), 10) > 1e-3


@pytest.mark.slow
@pytest.mark.usefixtures("proposing")
def test_ranks_tell_a_wrong_acceptance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: without Hastings' factor the same statistics fail."""

    def careless(walk: Moves, proposal: Proposal) -> Moves:
        def propose(x: np.ndarray, random: RandomState) -> tuple[np.ndarray, np.ndarray]:
            return proposal.draw(len(x), random), np.zeros(len(x))

        rest = [(move, 0.2 * share) for move, share in walk]
        return [(emcee.moves.MHMove(propose), 0.8), *rest]

    monkeypatch.setattr(chains, "with_independent", careless)
    assert p_value(ranks_of_lines(300, narrowed), 10) < 1e-6


def ranks_of_squares(count: int) -> tuple[np.ndarray, int]:
    """Return ranks where the chains are content, and how many samples are told to lack a sign."""
    ranks, told = [], 0
    for k in range(count):
        rng = np.random.default_rng(k)
        target, truth = square(rng)

        def positive(x: np.ndarray, target: Known = target) -> np.ndarray:
            return np.where(x[:, 0] > 0, target(x), -np.inf)

        centre = np.array([0.8, 0.0])
        sample = sample_importance(positive, centre, np.diag([0.3, 1.0]), rng)
        left_out = find_left_out_mode(target, sample, rng)
        if left_out is not None:
            told += 1
            assert left_out.share == pytest.approx(0.5, abs=0.05)
            continue
        found = run_chains(target, sample, seed=SeedSequence(k))
        assert found.converged
        ranks.append(rank(found.chain, truth, rng))
    return np.array(ranks), told


@pytest.mark.usefixtures("proposing")
def test_a_sign_left_out_is_corrected_or_told() -> None:
    """Whether ranks are uniform only many tell, see below."""
    ranks, told = ranks_of_squares(10)
    assert told >= 2
    assert len(ranks) >= 2


@pytest.mark.slow
@pytest.mark.usefixtures("proposing")
def test_a_sign_left_out_of_many() -> None:
    ranks, told = ranks_of_squares(300)
    assert told >= 60
    assert p_value(ranks, 10) > 1e-3
