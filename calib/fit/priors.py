"""What is known of the parameters beyond the gaze rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import Spectrum
from calib.geometry.parameters import PARAMETERS, REFERENCE_OFFSET, Model

NOISE_SCALE = "log_noise_scale"
"""Natural logarithm of the factor by which the stated uncertainties of the rows are wrong."""

OPEN = 1e-14
"""Share of the largest eigenvalue of a precision at which a direction is taken as not known."""

NOISE_SCALE_PRIOR = (0.0, 1.0)
"""Stated uncertainties are right within a factor of e, one time in three worse.

Wide enough that a model that does not fit drives the scale to 10 on six rows (it then costs 2.6
nats against 14 gained), narrow enough that six rows whose residuals happen to be small do not pass
for a rig without noise.
"""


@dataclass(frozen=True)
class MeasuredParameters:
    """Measured knowledge of some parameters, e.g. by the yaw sweep: a normal block.

    Parameters
    ----------
    names
        Parameters, k of them.
    mean
        Shape (k,), units of the parameters.
    covariance
        Shape (k, k).
    """

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class Priors:
    """Prior knowledge of all parameters, for any model.

    Parameters
    ----------
    stated
        (mean, standard deviation) by parameter, from the manifest; the others have the defaults
        of `calib.geometry.parameters`. May hold `NOISE_SCALE`. `REFERENCE_OFFSET` is a parameter
        of the rows only if it is here.
    measured
        Measured knowledge; it multiplies the prior and counts as data.
    """

    stated: Mapping[str, tuple[float, float]]
    measured: MeasuredParameters | None = None

    @property
    def offset_open(self) -> bool:
        """Whether it is uncertain from where the rows' reference depths are counted."""
        return REFERENCE_OFFSET in self.stated

    @property
    def noise_scale(self) -> tuple[float, float]:
        """Mean and standard deviation of the logarithm of the noise scale."""
        return self.stated.get(NOISE_SCALE, NOISE_SCALE_PRIOR)


@dataclass(frozen=True)
class NormalKnowledge:
    """A product of normal densities of a model's free parameters, in information form.

    Parameters
    ----------
    precision
        Shape (p, p); zero where nothing is known.
    shift
        precision @ mean, shape (p,).
    """

    precision: FloatArray
    shift: FloatArray

    def __add__(self, other: NormalKnowledge) -> NormalKnowledge:
        return NormalKnowledge(self.precision + other.precision, self.shift + other.shift)

    def root(self) -> tuple[FloatArray, FloatArray]:
        """Return A, shape (r, p), and b, shape (r,), with (A x - b)² the negative double log."""
        spectrum = Spectrum.of(self.precision)
        a = spectrum.root(least=OPEN).T
        return a, spectrum.inverse_root(least=OPEN).T @ self.shift


def prior_of(model: Model, priors: Priors) -> NormalKnowledge:
    """Return the prior of the free parameters of `model`: manifest first, then defaults."""
    precision = np.zeros(len(model.free))
    mean = np.zeros(len(model.free))
    for i, k in enumerate(model.indices):
        default = PARAMETERS[k].prior_std
        stated = priors.stated.get(model.free[i])
        if stated is not None:
            mean[i], precision[i] = stated[0], stated[1] ** -2
        elif default is not None:
            precision[i] = default**-2
    return NormalKnowledge(np.diag(precision), precision * mean)


def measured_of(model: Model, priors: Priors) -> NormalKnowledge:
    """Return the measured knowledge of the free parameters of `model`.

    Parameters that were measured but are not free in the model are integrated out, which for a
    normal block is leaving them away.
    """
    count = len(model.free)
    nothing = NormalKnowledge(np.zeros((count, count)), np.zeros(count))
    if priors.measured is None:
        return nothing
    measured = priors.measured
    shared = [name for name in measured.names if name in model.free]
    if not shared:
        return nothing
    block = [measured.names.index(name) for name in shared]
    place = [model.free.index(name) for name in shared]
    precision = np.zeros((count, count))
    precision[np.ix_(place, place)] = np.linalg.inv(measured.covariance[np.ix_(block, block)])
    mean = np.zeros(count)
    mean[place] = measured.mean[block]
    return NormalKnowledge(precision, precision @ mean)
