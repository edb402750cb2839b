"""Matrices brought to unit diagonal: what they are taken apart into is them again.

Evidence: property, over units that differ by many powers of ten and over ranks.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import Spectrum, unit_diagonal

SIZES = st.integers(1, 6)
SEEDS = st.integers(0, 2**32 - 1)


def covariance(seed: int, size: int, rank: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    part = rng.standard_normal((size, rank)) * 10.0 ** rng.integers(-8, 8, size)[:, None]
    return part @ part.T


@given(SEEDS, SIZES, SIZES)
def test_roots_are_roots_whatever_the_units(seed: int, size: int, rank: int) -> None:
    matrix = covariance(seed, size, min(rank, size))
    std, correlation = unit_diagonal(matrix)
    np.testing.assert_allclose(np.diagonal(correlation), 1.0, rtol=1e-12)
    spectrum = Spectrum.of(matrix)
    for root in (spectrum.root(), spectrum.root(least=1e-12)):
        np.testing.assert_allclose(root @ root.T / np.outer(std, std), correlation, atol=1e-9)


@given(SEEDS, SIZES)
def test_inverse_undoes(seed: int, size: int) -> None:
    matrix = covariance(seed, size, size + 6)
    spectrum = Spectrum.of(matrix)
    scale = np.outer(spectrum.scale, spectrum.scale)
    for inverse in (spectrum.inverse(), (w := spectrum.inverse_root(least=1e-14)) @ w.T):
        product = (inverse * scale) @ (matrix / scale)
        np.testing.assert_allclose(product, np.eye(size), atol=1e-6 / spectrum.span * 1e-6)


def test_a_rank_short_of_full_is_seen() -> None:
    matrix = covariance(1, 5, 3)
    spectrum = Spectrum.of(matrix)
    assert abs(spectrum.span) < 1e-14
    assert spectrum.root(least=1e-12).shape == (5, 3)
    assert spectrum.inverse_root(least=1e-12).shape == (5, 3)
    assert spectrum.root().shape == (5, 5)


@pytest.mark.parametrize("size", [0, 1, 3])
def test_what_has_no_spread_stays_without(size: int) -> None:
    matrix = np.zeros((size, size))
    std, correlation = unit_diagonal(matrix)
    assert (std == 1).all()
    assert (correlation == 0).all()
    if size:
        spectrum = Spectrum.of(matrix)
        assert (spectrum.root() == 0).all()
        assert spectrum.root(least=1e-12).shape == (size, 0)
        assert spectrum.span == 0
