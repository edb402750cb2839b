"""The rows' Fisher information about the parameters, and its singular values.

At the estimate it is G^T G, with a line of G for each row: the derivative of its misclosure by the
parameters over its standard uncertainty. Columns are scaled by what is known of any rig beforehand
(`beforehand`), so that a singular value of G below one is a combination of parameters of which the
rows say less than that (the likelihood-informed directions of Cui et al. 2014,
doi 10.1088/0266-5611/30/11/114015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.fit.noise import is_outlier, row_noise
from calib.fit.robust import RobustFit
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import PARAMETERS, Model
from calib.rows.observations import Observations

RULER = 10.0
"""Of a parameter without a prior of its own, 10 mm and 10 mrad are known beforehand, in units of
`Parameter.scale`: what a ruler and the eye tell without any calibration."""

NOTHING = 1e-12
"""Share of the largest singular value below which rounding has made a singular value of nothing."""

LOST = 1e-6
"""Square of a unit vector's part along what nothing is known of, above which nothing is known of
the vector either; less of it is rounding."""


def beforehand(model: Model) -> FloatArray:
    """Return what is known of the free parameters of any rig, shape (p,), as standard deviations.

    The default priors; where there is none, `RULER`. Priors of a manifest do not move it: what
    rows can tell does not hang on what somebody believes.
    """
    known = (PARAMETERS[i] for i in model.indices)
    return np.array([p.prior_std or RULER * p.scale for p in known])


def row_slopes(rows: Observations, fit: RobustFit) -> FloatArray:
    """Return G, shape (kept rows, p), per unit of the free parameters; G^T G is the information.

    Outliers are left out; the noise is what the fit found, its efficiency that of the t density.
    """
    return slopes(rows, fit)[kept(rows, fit)]


def row_information(rows: Observations, fit: RobustFit) -> FloatArray:
    """Return the rows' Fisher information at a fit, (p, p), per unit of the free parameters."""
    slope = row_slopes(rows, fit)
    information: FloatArray = slope.T @ slope
    return information


def slopes(rows: Observations, fit: RobustFit) -> FloatArray:
    """Return G of all rows, shape (n, p)."""
    c = misclosure(fit.theta, rows.gaze, rows.z_mm, parameters=fit.structure.indices)
    weight = np.sqrt(fit.tails.efficiency) / (row_noise(fit.theta, rows).sigma * fit.noise_scale)
    slope: FloatArray = c.by_theta * weight[:, None]
    return slope


def kept(rows: Observations, fit: RobustFit) -> BoolArray:
    """Return which rows agree with the others, shape (n,); all where none does."""
    value = misclosure(fit.theta, rows.gaze, rows.z_mm, parameters=()).value
    agrees: BoolArray = ~is_outlier(value / row_noise(fit.theta, rows).sigma, fit.noise_scale)
    return agrees if agrees.any() else ~agrees


@dataclass(frozen=True)
class Information:
    """The singular values, shape (p,), descending, and directions, shape (p, p), of a root G."""

    value: FloatArray
    directions: FloatArray

    @classmethod
    def of(cls, *roots: FloatArray) -> Information:
        """Return what roots, shape (m, p) each, say together.

        Of the root itself and not of its square, which would halve the digits of what is small.
        """
        root = np.concatenate([np.linalg.qr(g, mode="r") for g in roots])
        _, value, directions = np.linalg.svd(root)
        full = np.zeros(root.shape[1])
        full[: len(value)] = value
        full[full <= NOTHING * full[0]] = 0.0
        largest = directions[np.arange(len(full)), np.abs(directions).argmax(axis=1)]
        return cls(full, directions * np.sign(largest)[:, None])

    def std(self, along: FloatArray) -> FloatArray:
        """Return standard deviations along unit vectors, shape (m, p); infinite where open."""
        part = (along @ self.directions.T) ** 2
        told = self.value > 0
        std: FloatArray = np.sqrt((part[:, told] / self.value[told] ** 2).sum(axis=1))
        std[part[:, ~told].sum(axis=1) > LOST] = np.inf
        return std

    @property
    def covariance(self) -> FloatArray:
        """The inverse of the information, (p, p), or its pseudo-inverse."""
        told = self.value > 0
        half = self.directions[told] / self.value[told, None]
        covariance: FloatArray = half.T @ half
        return covariance
