"""One pass over the rows: their residuals, and the sums that a step of the fit needs.

A long table is taken block by block. What is computed of a block then stays in the processor's
cache, and of the derivatives, p numbers a row, only sums are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.fit.noise import Tails, outlier_limit, own_sigma
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import Model
from calib.geometry.plane import Gaze
from calib.rows.observations import Observations

BLOCK = 16_000
"""Rows a block; with 4,000, or all at once, a pass takes half as long again."""


@dataclass(frozen=True)
class Residuals:
    """How far rows are from their gaze planes.

    Parameters
    ----------
    value
        Misclosure, shape (n,).
    sigma
        Its standard uncertainty as stated, shape (n,).
    across
        The normal's x component, sin(a) for an untilted axis, shape (n,).
    """

    value: FloatArray
    sigma: FloatArray
    across: FloatArray

    @property
    def standardised(self) -> FloatArray:
        """Misclosure over its stated uncertainty, shape (n,)."""
        ratio: FloatArray = self.value / self.sigma
        return ratio

    @property
    def mrad(self) -> FloatArray:
        """The angle-like residual (num / z) - (x1c + cot a), mrad, shape (n,)."""
        residual: FloatArray = 1e3 * self.value / self.across
        return residual


@dataclass(frozen=True)
class RowSums:
    """What rows say at given parameters and noise scale; p parameters are free.

    Parameters
    ----------
    sigma
        Standard uncertainty of the misclosure as stated, shape (n,).
    standardised
        Misclosure over it, shape (n,).
    information
        The rows' Fisher information, outliers left out, shape (p, p).
    gradient
        Of the rows' negative log density at these weights, shape (p,).
    curvature
        Its second derivative, the misclosure taken as linear in the parameters, shape (p, p).
    """

    sigma: FloatArray
    standardised: FloatArray
    information: FloatArray
    gradient: FloatArray
    curvature: FloatArray


def _blocks(rows: Observations) -> Iterator[tuple[slice, Gaze, FloatArray, FloatArray]]:
    """Yield the blocks: where they are, gazes, depths and standard uncertainties."""
    for low in range(0, len(rows), BLOCK):
        part = slice(low, low + BLOCK)
        gaze = Gaze(
            rows.x1c[part], rows.y1c[part], rows.alpha2_rad[part], rows.gaze_residual_rad[part]
        )
        yield part, gaze, rows.z_mm[part], rows.std[part]


def residuals(theta: FloatArray, rows: Observations) -> Residuals:
    """Return the residuals of rows at parameters `theta`, shape (COUNT,)."""
    found = Residuals(*np.empty((3, len(rows))))
    for part, gaze, z, std in _blocks(rows):
        c = misclosure(theta, gaze, z, parameters=())
        found.value[part] = c.value
        found.sigma[part] = own_sigma(c, std)
        found.across[part] = -c.by_observable[:, 0]
    return found


def sum_rows(
    theta: FloatArray, rows: Observations, model: Model, *, scale: float, tails: Tails
) -> RowSums:
    """Return what rows say at parameters `theta`, shape (COUNT,), and noise scale `scale`."""
    limit = outlier_limit(len(rows)) * scale
    width = tails.dof * (tails.core * scale) ** 2
    free = len(model.free)
    sigma, standardised = np.empty((2, len(rows)))
    information, curvature = np.zeros((2, free, free))
    gradient = np.zeros(free)
    for part, gaze, z, std in _blocks(rows):
        c = misclosure(theta, gaze, z, parameters=model.indices)
        sigma[part] = own_sigma(c, std)
        standardised[part] = c.value / sigma[part]
        miss, slope = standardised[part], c.by_theta.T / sigma[part]
        agrees = np.abs(miss) <= limit
        inlier = slope if agrees.all() else slope[:, agrees]
        information += inlier @ inlier.T
        square = miss**2
        near = 1 / (width + square)
        gradient += slope @ (miss * near)
        curvature += (slope * ((width - square) * near**2)) @ slope.T
    count = tails.dof + 1
    return RowSums(
        sigma=sigma,
        standardised=standardised,
        information=tails.efficiency / scale**2 * information,
        gradient=count * gradient,
        curvature=count * curvature,
    )
