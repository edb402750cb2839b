"""Densities whose answers are known, and importance samples of them that are made wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.fit.importance import ImportanceSample


@dataclass(frozen=True)
class Known:
    """A log density for chains."""

    density: Callable[[np.ndarray], np.ndarray]
    dimensions: int

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return self.density(x)


def normal(centre: np.ndarray, covariance: np.ndarray) -> Known:
    """Return a normal log density."""
    precision = np.linalg.inv(covariance)
    return Known(
        lambda x: -0.5 * np.einsum("ij,jk,ik->i", x - centre, precision, x - centre), len(centre)
    )


def student(dof: float, dimensions: int) -> Known:
    """Return a t log density about 0 with unit scale."""
    return Known(lambda x: -(dof + dimensions) / 2 * np.log1p((x**2).sum(axis=1) / dof), dimensions)


def two_modes(distance: float, dimensions: int, *, share: float) -> Known:
    """Return two unit normal modes, the second, with `share` of the whole, that far along x_1."""

    def density(x: np.ndarray) -> np.ndarray:
        rest = -0.5 * (x[:, 1:] ** 2).sum(axis=1)
        first = np.log(1 - share) - 0.5 * x[:, 0] ** 2
        return rest + np.logaddexp(first, np.log(share) - 0.5 * (x[:, 0] - distance) ** 2)

    return Known(density, dimensions)


def shifted(sample: ImportanceSample) -> ImportanceSample:
    """Return the sample, wrong by two standard deviations along its second principal direction.

    All draws that chains start from and all that they propose are then off.
    """
    values, vectors = np.linalg.eigh(sample.covariance)
    return replace(sample, draws=sample.draws + 2 * np.sqrt(values[-2]) * vectors[:, -2])


def narrowed(sample: ImportanceSample) -> ImportanceSample:
    """Return the sample with half its width."""
    return replace(sample, draws=sample.mean + (sample.draws - sample.mean) / 2)


def unharmed(sample: ImportanceSample) -> ImportanceSample:
    """Return the sample as it is."""
    return sample
