"""The log posterior density of a model, for many parameter vectors at once.

Without encoder terms other than its zero, the misclosure is linear in twelve products of what a row
says: the sines and cosines of its reading times 1/z, x1c, y1c and 1, and those four themselves.
For m vectors and n rows it is then one (m x 12) by (12 x n) matrix product; columns that a model
never uses are left out. Rows off C2's centre column have fifteen more, of which the standoff uses
one, the eccentricity another and a rolled C2 the rest; rows whose reference depths count from
somewhere else than C1's centre nine more (or eighteen), the ray over z.

The rows' density enters with a power, the efficiency of its tails. Their noise is nearly normal,
the t density is there for the outliers among them; taken at its word it would make the posterior
narrower than the estimates scatter. With that power, E psi' / E psi² as `Tails.core` makes E psi'
one, the covariance on normal rows is the sampling covariance of the estimate (Lyddon et al. 2019,
doi 10.1093/biomet/asz006).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.fit.noise import LOG_SCALE_LIMIT, ROBUST, Tails, log_density, row_noise
from calib.fit.priors import Priors, measured_of, prior_of
from calib.geometry.parameters import (
    INDEX,
    PARAMETERS,
    REFERENCE_OFFSET,
    EncoderTerm,
    Model,
    embed,
)
from calib.geometry.plane import Axes, FixedParts, frame
from calib.rows.observations import Observations

CHUNK_ELEMENTS = 16_000
"""Vectors x rows evaluated at a time: above it the arrays leave the processor's cache."""

SMALL_ANGLE_RAD = 0.2
"""Below it the series leave out less than 1e-17; an encoder's errors hardly ever exceed it."""

SINE_SERIES = np.array([(-1.0) ** k / factorial(2 * k + 1) for k in range(6)])
COSINE_SERIES = np.array([(-1.0) ** k / factorial(2 * k) for k in range(6)])


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
        Stated uncertainty of each row's misclosure, shape (n,); fixed, so that the density is one
        of the residuals alone.
    log_unit
        Log of the density of an encoder reading per unit of standardised misclosure, shape (n,).
    power
        Of each row's density, shape (n,): the tails' efficiency, 0 for a row rejected.
    root, target
        Priors and measured knowledge: ``-|root @ x - target|² / 2``, shapes (r, p) and (r,).
    noise_prior
        Mean and standard deviation of the logarithm of the noise scale.
    tails
        Of the rows' density.
    followed
        Degrees of freedom that parameters take by following errors which rows of a group share,
        beyond those that integrating them out takes: so many rows fewer tell the noise scale.
    """

    model: Model
    rows: Observations
    sigma: FloatArray
    log_unit: FloatArray
    power: FloatArray
    root: FloatArray
    target: FloatArray
    noise_prior: tuple[float, float]
    tails: Tails
    followed: float = 0.0

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
        if self._heard is not self:
            return self._heard(x)
        theta, log_scale = embed(x[:, :-1], self.model.free), x[:, -1]
        mean, std = self.noise_prior
        total: FloatArray = -0.5 * ((x[:, :-1] @ self.root.T - self.target) ** 2).sum(axis=1)
        total -= 0.5 * ((log_scale - mean) / std) ** 2
        dof, core, power = self.tails.dof, self.tails.core, self.tails.efficiency
        total -= power * max(len(self.rows) - self.followed, 0.0) * log_scale
        scale = np.exp(np.clip(log_scale, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT))
        width = (dof * core**2 * scale**2)[:, None]
        # Far out in a proposal's tail the product overflows: the density is then 0, as it is.
        with np.errstate(over="ignore"):
            for miss in self._standardised(theta):
                factors = miss * miss
                factors /= width
                factors += 1
                total -= power * (dof + 1) / 2 * _log_product(factors)
        return total

    def pointwise(self, x: FloatArray) -> FloatArray:
        """Return the log density of each encoder reading, per rad, shape (m, n)."""
        theta = embed(x[:, :-1], self.model.free)
        miss = np.concatenate(list(self._standardised(theta)), axis=1)
        return log_density(miss, x[:, -1:], self.tails) + self.log_unit

    def _standardised(self, theta: FloatArray) -> Iterator[FloatArray]:
        """Yield the closures over sigma, shape (m, some rows), chunk by chunk."""
        coefficients = self._coefficients(theta, zero_in=self._by_angles)
        step = max(1, CHUNK_ELEMENTS // len(theta))
        for start in range(0, len(self.rows), step):
            part = slice(start, min(start + step, len(self.rows)))
            if self._by_angles:
                yield self._by_angle(theta, coefficients, part)
            else:
                yield coefficients[:, self._used] @ self._basis[:, part]

    @cached_property
    def _heard(self) -> LogPosterior:
        """The same without the rows rejected."""
        return self if self.power.all() else self.only(np.flatnonzero(self.power))

    @cached_property
    def _used(self) -> BoolArray:
        """Which columns of the coefficients the model ever uses, shape (columns,)."""
        count = len(self.model.free)
        some = embed(np.linspace(0.1, 0.3, count)[None], self.model.free)
        coefficients = self._coefficients(some, zero_in=False)
        used: BoolArray = np.any(coefficients != 0, axis=0)
        if self._by_angles:
            # Sines and cosines of turned angles come of both, so that a triple stays together.
            used = np.repeat(used.reshape(-1, 3).any(axis=1), 3)
        return used

    @cached_property
    def _basis(self) -> FloatArray:
        """What the used coefficients multiply, over sigma, shape (used, n)."""
        rows = self.rows
        angle, r = rows.alpha2_rad + rows.gaze_residual_rad, rows.gaze_residual_rad
        turn = (np.sin(angle), np.cos(angle), np.ones_like(angle))
        place = (1 / rows.z_mm, -rows.x1c, -rows.y1c, -np.ones_like(angle))
        basis = [t * q for q in place for t in turn]
        if rows.off_centre:
            beside = (
                np.sin(r) * np.sin(rows.alpha2_rad),
                np.sin(r) * np.cos(rows.alpha2_rad),
                1 - np.cos(r),
            )
            nought = np.zeros_like(r)
            basis += [t * q for q in place for t in beside]
            basis += [nought, nought, np.sin(r) / rows.z_mm]
        if self._offset_open:
            over = tuple(q / rows.z_mm for q in place[1:])
            basis += [t * q for q in over for t in turn]
            if rows.off_centre:
                basis += [t * q for q in over for t in beside]
        return np.stack([b / self.sigma for b, use in zip(basis, self._used, strict=True) if use])

    def _by_angle(self, theta: FloatArray, coefficients: FloatArray, part: slice) -> FloatArray:
        """Return the same where each vector turns each reading in its own way.

        Sine and cosine of a turned angle are those of the angle, which the basis holds, turned.
        """
        turn = theta[:, self._encoder_terms] @ self._turns[:, part]
        sine, cosine = _sine_cosine(turn)
        basis = self._basis[:, part]
        # Copied, as products of strided arrays go without BLAS.
        of_sine, of_cosine, rest = (
            np.ascontiguousarray(coefficients[:, self._used][:, k::3]) for k in range(3)
        )
        along = of_sine @ basis[0::3]
        along += of_cosine @ basis[1::3]
        across = of_sine @ basis[1::3]
        across -= of_cosine @ basis[0::3]
        along *= cosine
        across *= sine
        along += across
        along += rest @ basis[2::3]
        return along

    def _coefficients(self, theta: FloatArray, *, zero_in: bool) -> FloatArray:
        return _coefficients(
            theta,
            zero_in=zero_in,
            off_centre=self.rows.off_centre,
            offset_open=self._offset_open,
        )

    @property
    def _offset_open(self) -> bool:
        return REFERENCE_OFFSET in self.model.free

    @cached_property
    def _by_angles(self) -> bool:
        """Whether each vector turns each reading in its own way."""
        return self._encoder_terms != [INDEX["delta2_rad"]]

    @cached_property
    def _encoder_terms(self) -> list[int]:
        """Which parameters turn the readings."""
        return [i for i in self.model.indices if isinstance(PARAMETERS[i].effect, EncoderTerm)]

    @cached_property
    def _turns(self) -> FloatArray:
        """Turn of each reading by a unit of each encoder term, shape (terms, n)."""
        effects = [PARAMETERS[i].effect for i in self._encoder_terms]
        reading = self.rows.alpha2_rad
        return np.stack([e.basis(reading) for e in effects if isinstance(e, EncoderTerm)])


def _sine_cosine(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sine and cosine, to rounding; by their series, five times faster, of small angles."""
    if max(angle.max(initial=0.0), -angle.min(initial=0.0)) > SMALL_ANGLE_RAD:
        return np.sin(angle), np.cos(angle)
    square = angle * angle
    sine = _series(square, SINE_SERIES)
    sine *= angle
    return sine, _series(square, COSINE_SERIES)


def _series(x: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return a polynomial in x by Horner's rule, without numpy's new array at each step."""
    total: FloatArray = x * coefficients[-1]
    for coefficient in coefficients[-2:0:-1]:
        total += coefficient
        total *= x
    total += coefficients[0]
    return total


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


def _coefficients(
    theta: FloatArray, *, zero_in: bool, off_centre: bool, offset_open: bool
) -> FloatArray:
    """Return what multiplies the basis, shape (m, 12), or (m, 27) for rows off the centre column.

    An open origin of the reference depths adds nine columns, and nine more off the centre column.
    Order: sine, cosine and 1 of the gaze angle, for each of 1/z, -x1c, -y1c, -1. Off the centre by
    r: sin r times sine and cosine of the reading and 1 - cos r, for each of the same; sin(r) / z
    after two empty columns. The encoder's zero is carried by the coefficients unless `zero_in` says
    that the angles hold it already.
    """
    f = frame(theta)
    zero = np.zeros(len(theta)) if zero_in else theta[:, INDEX["delta2_rad"]]
    columns = _triples(f, f.basis(), f.offset, zero)
    on_ray = columns[3:]
    if off_centre:
        # cos(r) n(a) - sin(r) g(a) less n(a + r), with g the optical axis.
        x, z, y = f.axes
        cos, sin = np.cos(f.roll)[:, None], np.sin(f.roll)[:, None]
        more = _triples(f, ((cos - 1) * z, (1 - cos) * x, -sin * y), -f.offset, zero)
        columns = [*columns, *more]
        on_ray = [*on_ray, *more[3:]]
        nought = np.zeros(len(theta))
        columns += [nought, nought, -f.standoff]
    if offset_open:
        columns = [*columns, *(f.origin * c for c in on_ray)]
    return np.stack(columns, axis=1)


def _triples(f: FixedParts, axes: Axes, offset: FloatArray, zero: FloatArray) -> list[FloatArray]:
    """Return the twelve columns of sin(a) u + cos(a) v + w and of its distance from the axis.

    Parameters
    ----------
    axes
        u, v, w, shape (m, 3) each.
    offset
        Of the distance, mm, what does not turn, shape (m,).
    zero
        Zero error that the angles do not hold, rad, shape (m,).
    """
    u, v, w = axes
    if zero.any():
        cos, sin = np.cos(zero)[:, None], np.sin(zero)[:, None]
        u, v = cos * u - sin * v, sin * u + cos * v
    on_axis = [(n * f.point).sum(axis=1) for n in (u, v, w)]
    on_axis[2] = on_axis[2] + offset
    return on_axis + [n[:, k] for k in range(3) for n in (u, v, w)]


def log_posterior(
    rows: Observations,
    model: Model,
    priors: Priors,
    theta: FloatArray,
    *,
    rejected: BoolArray | None = None,
    tails: Tails = ROBUST,
    followed: float = 0.0,
) -> LogPosterior:
    """Return the log posterior of `model`, with the rows weighted as at `theta`, (COUNT,).

    Parameters
    ----------
    aside
        Rows that say nothing, shape (n,): outliers, see `calib.fit.noise.set_aside`.
    tails
        Of the rows' density: those of the fit.
    followed
        See `LogPosterior`.
    """
    silent = np.zeros(len(rows), dtype=np.bool_) if rejected is None else rejected
    noise = row_noise(theta, rows)
    root, target = (prior_of(model, priors) + measured_of(model, priors)).root()
    return LogPosterior(
        model=model,
        rows=rows,
        sigma=noise.sigma,
        log_unit=np.log(noise.per_angle / noise.sigma),
        power=np.where(silent, 0.0, tails.efficiency),
        root=root,
        target=target,
        noise_prior=priors.noise_scale,
        tails=tails,
        followed=followed,
    )
