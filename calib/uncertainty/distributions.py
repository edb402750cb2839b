"""Distributions of inputs for Monte Carlo, and how to draw from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import Spectrum, unit_diagonal

PARTS = 10
"""Parts into which given draws are divided: their scatter is known to a quarter."""


@dataclass(frozen=True)
class NormalInputs:
    """Jointly normal inputs: mean, shape (k,), and covariance, shape (k, k), semi-definite."""

    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class StudentInputs:
    """Inputs with a joint t distribution, scaled and shifted (JCGM 101, 6.4.9; JCGM 102, 5.3.2).

    Parameters
    ----------
    mean
        Shape (k,).
    scale
        Covariance matrix as estimated with `degrees_of_freedom`, shape (k, k).
    degrees_of_freedom
        At two or fewer the standard deviation does not exist; intervals still do.
    """

    mean: FloatArray
    scale: FloatArray
    degrees_of_freedom: float


@dataclass(frozen=True)
class RectangularInputs:
    """Independent inputs, uniform within `centre` ± `half_width`, each shape (k,)."""

    centre: FloatArray
    half_width: FloatArray


@dataclass(frozen=True)
class GivenInputs:
    """Draws from a joint distribution, for example a posterior, in the order they were drawn.

    Parameters
    ----------
    draws
        Shape (m, k), m at least `PARTS`.
    """

    draws: FloatArray


Inputs: TypeAlias = NormalInputs | StudentInputs | RectangularInputs | GivenInputs


def factor(covariance: FloatArray) -> FloatArray:
    """Return F, shape (k, k), with F Fᵀ = covariance; semi-definite matrices are welcome."""
    return Spectrum.of(covariance).root()


NEGLIGIBLE = 1e-12
"""Share of a variance that is taken as none: what rounding leaves is far below it."""


def triangular_factor(covariance: FloatArray) -> FloatArray:
    """Return lower triangular F, shape (k, k), with F Fᵀ = covariance, which may be semi-definite.

    Its leading rows are the factor of the leading block, and of what later inputs owe to earlier
    ones nothing hangs on rounding: an input that is no more uncertain once the earlier are known
    has a column of zeros.
    """
    scale, rest = unit_diagonal(covariance)
    root = np.zeros_like(rest)
    for i in range(len(rest)):
        if rest[i, i] > NEGLIGIBLE:
            root[i:, i] = rest[i:, i] / np.sqrt(rest[i, i])
            rest = rest - np.outer(root[:, i], root[:, i])
    found: FloatArray = scale[:, None] * root
    return found


def draw(inputs: Inputs, rng: np.random.Generator, count: int, *, part: int = 0) -> FloatArray:
    """Return draws of inputs, shape (count, k); given draws come from `part` modulo `PARTS`."""
    match inputs:
        case NormalInputs(mean=mean, covariance=covariance):
            drawn = mean + rng.standard_normal((count, len(mean))) @ factor(covariance).T
        case StudentInputs(mean=mean, scale=scale, degrees_of_freedom=freedom):
            shrink = np.sqrt(rng.chisquare(freedom, count) / freedom)
            normal = rng.standard_normal((count, len(mean))) @ factor(scale).T
            drawn = mean + normal / shrink[:, None]
        case RectangularInputs(centre=centre, half_width=half_width):
            drawn = centre + half_width * rng.uniform(-1, 1, (count, len(centre)))
        case GivenInputs(draws=draws):
            edges = np.linspace(0, len(draws), PARTS + 1).astype(int)
            part %= PARTS
            drawn = draws[rng.integers(edges[part], edges[part + 1], count)]
    return drawn
