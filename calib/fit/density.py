"""The log posterior density of a model, for many parameter vectors at once.

Without encoder terms other than its zero, the closure is linear in twelve products of what a row
says: the sines and cosines of its reading times 1/z, x1c, y1c and 1, and those four themselves.
For m vectors and n rows it is then one (m x 12) by (12 x n) matrix product; columns that a model
never uses are left out.

The rows' density enters with the power `LEARNING_RATE`. Their noise is nearly normal, the t density
is there for the outliers among them; taken at its word it would make the posterior narrower than
the estimates scatter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.fit.noise import CORE, DOF, EFFICIENCY, log_density, row_noise
from calib.fit.priors import Priors, measured_of, prior_of
from calib.geometry.parameters import INDEX, PARAMETERS, EncoderTerm, Model, embed
from calib.geometry.plane import frame
from calib.observations import Observations

CHUNK_ELEMENTS = 16_000
"""Vectors x rows evaluated at a time: above it the arrays leave the processor's cache."""

LEARNING_RATE = EFFICIENCY
"""Power of the rows' density: E psi' / E psi², which is the efficiency, as `CORE` makes E psi' one.

With it the posterior's covariance on normal rows is the sampling covariance of the estimate
(Lyddon et al. 2019, doi 10.1093/biomet/asz006). Without it 95 % intervals of parameters cover
93.9 % at any number of rows: `calib study`, condition axis-offset-60.
"""

_NOISE_TAIL = LEARNING_RATE * (DOF + 1) / 2


@dataclass(frozen=True)
class LogPosterior:
    """Log posterior density of the free parameters and the logarithm of the noise scale.

    Parameters
    ----------
    model
        The model; p free parameters.
    rows
        The rows, n of them.
    sigma
        Stated uncertainty of each row's closure, shape (n,); fixed, so that the density is one of
        the residuals alone.
    log_unit
        Log of the density of an encoder reading per unit of standardised closure, shape (n,).
    power
        Of each row's density, shape (n,): `LEARNING_RATE`, 0 for a row set aside.
    root, target
        Priors and measured knowledge: ``-|root @ x - target|² / 2``, shapes (r, p) and (r,).
    noise_prior
        Mean and standard deviation of the logarithm of the noise scale.
    """

    model: Model
    rows: Observations
    sigma: FloatArray
    log_unit: FloatArray
    power: FloatArray
    root: FloatArray
    target: FloatArray
    noise_prior: tuple[float, float]

    @property
    def dimensions(self) -> int:
        """Number of sampled quantities, p + 1."""
        return len(self.model.free) + 1

    def only(self, chosen: IntArray) -> LogPosterior:
        """Return the same with the chosen rows alone."""
        return replace(
            self,
            rows=self.rows.take(chosen),
            sigma=self.sigma[chosen],
            log_unit=self.log_unit[chosen],
            power=self.power[chosen],
        )

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return the log density, shape (m,), of x, shape (m, p + 1), noise scale last."""
        if not self.power.all():
            return self.only(np.flatnonzero(self.power))(x)
        theta, log_scale = embed(x[:, :-1], self.model.free), x[:, -1]
        mean, std = self.noise_prior
        total: FloatArray = -0.5 * ((x[:, :-1] @ self.root.T - self.target) ** 2).sum(axis=1)
        total -= 0.5 * ((log_scale - mean) / std) ** 2
        total -= LEARNING_RATE * len(self.rows) * log_scale
        # Far out in a proposal's tail width or product overflow: the density is then 0, as it is.
        with np.errstate(over="ignore"):
            width = (DOF * CORE**2 * np.exp(2 * log_scale))[:, None]
            for miss in self._standardised(theta):
                total -= _NOISE_TAIL * _log_product(1 + miss * miss / width)
        return total

    def pointwise(self, x: FloatArray) -> FloatArray:
        """Return the log density of each encoder reading, per rad, shape (m, n)."""
        theta = embed(x[:, :-1], self.model.free)
        miss = np.concatenate(list(self._standardised(theta)), axis=1)
        return log_density(miss, x[:, -1:]) + self.log_unit

    def _standardised(self, theta: FloatArray) -> Iterator[FloatArray]:
        """Yield the closures over sigma, shape (m, some rows), chunk by chunk."""
        by_angle = _has_encoder_terms(self.model)
        coefficients = _coefficients(theta, zero_in=by_angle)
        step = max(1, CHUNK_ELEMENTS // len(theta))
        for start in range(0, len(self.rows), step):
            part = slice(start, min(start + step, len(self.rows)))
            if by_angle:
                yield self._by_angle(theta, coefficients, part)
            else:
                yield coefficients[:, self._used] @ self._basis[:, part]

    @cached_property
    def _used(self) -> BoolArray:
        """Which columns of the coefficients the model ever uses, shape (12,)."""
        count = len(self.model.free)
        some = embed(np.linspace(0.1, 0.3, count)[None], self.model.free)
        used: BoolArray = np.any(_coefficients(some, zero_in=False) != 0, axis=0)
        return used

    @cached_property
    def _basis(self) -> FloatArray:
        """What the used coefficients multiply, over sigma, shape (used, n)."""
        rows = self.rows
        angle = rows.alpha2_rad + rows.gaze_residual_rad
        turn = (np.sin(angle), np.cos(angle), np.ones_like(angle))
        place = (1 / rows.z_mm, -rows.x1c, -rows.y1c, -np.ones_like(angle))
        basis = (t * q / self.sigma for q in place for t in turn)
        return np.stack([b for b, use in zip(basis, self._used, strict=True) if use])

    def _by_angle(self, theta: FloatArray, coefficients: FloatArray, part: slice) -> FloatArray:
        """Return the same where each vector turns each reading in its own way."""
        rows = self.rows
        reading = rows.alpha2_rad[part]
        angle = reading + rows.gaze_residual_rad[part]
        for i, parameter in enumerate(PARAMETERS):
            if isinstance(parameter.effect, EncoderTerm):
                angle = angle + theta[:, i, None] * parameter.effect.basis(reading)
        place = np.stack(
            [1 / rows.z_mm[part], -rows.x1c[part], -rows.y1c[part], -np.ones_like(reading)]
        )
        sine, cosine, still = (coefficients[:, k::3] @ place for k in range(3))
        return (np.sin(angle) * sine + np.cos(angle) * cosine + still) / self.sigma[part]


def _log_product(factors: FloatArray) -> FloatArray:
    """Return the logarithm of each row's product, shape (m,), of factors from 1 up, (m, n).

    Eight factors share one logarithm, which costs more than all the rest. They would overflow if
    each were above 1e38, rows 1e19 standard deviations off.
    """
    total = np.zeros(len(factors))
    for _ in range(3):
        if factors.shape[1] % 2:
            total += np.log(factors[:, -1])
        half = factors.shape[1] // 2
        factors = factors[:, :half] * factors[:, half : 2 * half]
    total += np.log(factors).sum(axis=1)
    return total


def _has_encoder_terms(model: Model) -> bool:
    return any(
        isinstance(PARAMETERS[i].effect, EncoderTerm) and i != INDEX["delta2_rad"]
        for i in model.indices
    )


def _coefficients(theta: FloatArray, *, zero_in: bool) -> FloatArray:
    """Return what multiplies the basis, shape (m, 12).

    Order: sine, cosine and 1 of the reading, for each of 1/z, -x1c, -y1c, -1. The encoder's zero
    is carried by the coefficients unless `zero_in` says that the angles hold it already.
    """
    f = frame(theta)
    u, v, w = f.basis()
    if not zero_in:
        delta2 = theta[:, INDEX["delta2_rad"], None]
        u, v = np.cos(delta2) * u - np.sin(delta2) * v, np.sin(delta2) * u + np.cos(delta2) * v
    on_axis = [(n * f.point).sum(axis=1) for n in (u, v, w)]
    on_axis[2] = on_axis[2] + f.offset
    columns = on_axis + [n[:, k] for k in range(3) for n in (u, v, w)]
    return np.stack(columns, axis=1)


def log_posterior(
    rows: Observations,
    model: Model,
    priors: Priors,
    theta: FloatArray,
    *,
    aside: BoolArray | None = None,
) -> LogPosterior:
    """Return the log posterior of `model`, with the rows weighted as at `theta`, (COUNT,).

    Parameters
    ----------
    aside
        Rows that say nothing, shape (n,): outliers, see `calib.fit.noise.set_aside`.
    """
    silent = np.zeros(len(rows), dtype=np.bool_) if aside is None else aside
    noise = row_noise(theta, rows)
    root, target = (prior_of(model, priors) + measured_of(model, priors)).root()
    return LogPosterior(
        model=model,
        rows=rows,
        sigma=noise.sigma,
        log_unit=np.log(noise.per_angle / noise.sigma),
        power=np.where(silent, 0.0, LEARNING_RATE),
        root=root,
        target=target,
        noise_prior=priors.noise_scale,
    )
