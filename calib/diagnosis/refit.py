"""Refits of the rows with errors of what was observed as further parameters.

A hypothesis says that observations are off by ``loadings @ c``, with c to be estimated with the
model's parameters. The misclosure is taken at the corrected observations, so that large errors are
as good as small ones. Errors that rows share as stated, and those of a group's reference depth, are
such parameters, too, with their stated standard deviations: they are no evidence for a hypothesis.

Evidence is the logarithm of the marginal likelihood by Laplace's method, over all parameters and
their priors (Kass and Raftery 1995, doi 10.1080/01621459.1995.10476572). Tails are the robust ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calib.core.arrays import FloatArray
from calib.fit.noise import ROBUST, log_density, own_sigma, weight
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.reweighting import FitProblem
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import Model, embed
from calib.geometry.plane import OBSERVABLE, Gaze
from calib.rows.observations import Observations

STEPS = 25
"""Gauss-Newton steps at most; weights and noise scale settle in six or so."""

LAST_STEP = 1e-2
"""Length of the last step, in standard deviations of the estimate: 1e-4 nats of evidence."""

HALVINGS = 4
"""Of a step that makes the fit worse."""

UNIT_DENSITY = 0.5 * float(np.log(2 * np.pi))


@dataclass(frozen=True)
class Added:
    """Errors of what was observed, as parameters.

    Parameters
    ----------
    loadings
        Error of each observable per unit of each parameter, shape (n, 5, k).
    prior_std
        Of each, about 0, shape (k,).
    """

    loadings: FloatArray
    prior_std: FloatArray

    @classmethod
    def none(cls, rows: int) -> Added:
        """Return no parameters for so many rows."""
        return cls(np.zeros((rows, len(OBSERVABLE), 0)), np.zeros(0))

    def __add__(self, other: Added) -> Added:
        return Added(
            np.concatenate([self.loadings, other.loadings], axis=2),
            np.append(self.prior_std, other.prior_std),
        )

    def __len__(self) -> int:
        return len(self.prior_std)


def stated_errors(rows: Observations) -> tuple[Observations, Added]:
    """Return rows with what is stated of their common errors taken out of `std`, and these."""
    added = Added.none(len(rows))
    if rows.shared_names:
        added += Added(rows.shared, np.ones(len(rows.shared_names)))
    if rows.alone_names:
        added += Added(rows.alone, np.ones(len(rows.alone_names)))
    if not rows.has_groups:
        return rows, added
    label = np.unique(rows.z_group, return_inverse=True)[1]
    of_groups = np.zeros((len(rows), len(OBSERVABLE), int(label.max()) + 1))
    of_groups[np.arange(len(rows)), OBSERVABLE.z, label] = rows.u_z_group_mm
    some = of_groups.any(axis=(0, 1))
    std = rows.std.copy()
    std[:, OBSERVABLE.z] = np.sqrt(
        np.maximum(std[:, OBSERVABLE.z] ** 2 - rows.u_z_group_mm**2, 0.0)
    )
    return replace(rows, std=std), added + Added(of_groups[:, :, some], np.ones(int(some.sum())))


@dataclass(frozen=True)
class Refit:
    """A refit.

    Parameters
    ----------
    theta
        The full parameter vector, shape (COUNT,).
    added, covariance
        Estimates of the added parameters, shape (k,), and their covariance, (k, k).
    stated, stated_covariance
        The same of the errors that the setting allows for, shapes (s,) and (s, s).
    scale
        The noise scale.
    standardised, residual_mrad
        Misclosure over its stated uncertainty, and as an angle, shape (n,).
    evidence
        Logarithm of the marginal likelihood.
    """

    theta: FloatArray
    added: FloatArray
    covariance: FloatArray
    stated: FloatArray
    stated_covariance: FloatArray
    scale: float
    standardised: FloatArray
    residual_mrad: FloatArray
    evidence: float


@dataclass(frozen=True)
class Linear:
    """A fit seen from where it is, for tests of further parameters.

    Parameters
    ----------
    slope
        Standardised derivative of the misclosures by all parameters, shape (n, p).
    by_observable
        The same by what is observed, shape (n, 5).
    standardised, strength
        Residuals and their weights, shape (n,).
    covariance
        Of all parameters, shape (p, p).
    """

    slope: FloatArray
    by_observable: FloatArray
    standardised: FloatArray
    strength: FloatArray
    covariance: FloatArray

    def gains(self, column: int, patterns: FloatArray) -> FloatArray:
        """Return the gain in log likelihood, shape (m,), of errors of one observable.

        By the score test, parameters re-estimated. Patterns of the error have shape (n, m).
        """
        score, information = self._score(self.by_observable[:, column, None] * patterns)
        gain: FloatArray = 0.5 * score**2 / np.maximum(information, 1e-300)
        return np.where(information > 0, gain, 0.0)

    def sides(self, push: FloatArray) -> FloatArray:
        """Return the sides, -1 or 1, shape (n,), of a two-sided error that explain most.

        Greedy: from the sides of the residuals and some others, rows change sides one by one as
        long as the score test gains by it.

        Parameters
        ----------
        push
            Change of the standardised residuals on the upper side, shape (n,).
        """
        weighted = self.strength[:, None] * self.slope
        product = np.diag(self.strength) - weighted @ self.covariance @ weighted.T
        pull, bend = push * (product @ self.standardised), np.outer(push, push) * product
        vectors = np.linalg.eigh(bend)[1]
        starts = [np.sign(self.standardised * push), np.sign(pull), *np.sign(vectors[:, -3:].T)]
        found = [_climb(np.where(s == 0, 1.0, s), pull, bend) for s in starts]
        return max(found, key=lambda s: (s @ pull) ** 2 / (s @ bend @ s))

    def _score(self, push: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = self.strength[:, None] * push
        score = weighted.T @ self.standardised
        cross = self.slope.T @ weighted
        own = np.einsum("nm,nm->m", push, weighted)
        left = own - np.einsum("pm,pq,qm->m", cross, self.covariance, cross)
        return score, np.where(left > 1e-6 * own, left, 0.0)


def _climb(side: FloatArray, pull: FloatArray, bend: FloatArray) -> FloatArray:
    """Return sides from which no single change raises ``(s @ pull)² / (s @ bend @ s)``."""
    side = side.copy()
    for _ in range(4 * len(side)):
        first, turned = side @ pull, bend @ side
        numerator = (first - 2 * side * pull) ** 2
        denominator = side @ turned - 4 * side * turned + 4 * np.diag(bend)
        after = numerator / np.maximum(denominator, 1e-300)
        best = int(np.argmax(after))
        if after[best] <= first**2 / (side @ turned) * (1 + 1e-9):
            break
        side[best] = -side[best]
    return side


@dataclass(frozen=True)
class Setting:
    """Rows, model and knowledge of the refits.

    Parameters
    ----------
    rows
        The rows.
    stated
        Their stated common errors.
    model, priors
        As those of the fit.
    unit
        Standard uncertainty of each misclosure and its size per rad of reading, shape (2, n).
    """

    rows: Observations
    stated: Added
    model: Model
    priors: Priors
    unit: FloatArray

    @classmethod
    def of(
        cls, rows: Observations, stated: Added, model: Model, priors: Priors, theta: FloatArray
    ) -> Setting:
        """Return the setting, the uncertainties as they are at `theta`, shape (COUNT,)."""
        c = misclosure(theta, rows.gaze, rows.z_mm, parameters=())
        per_angle = np.abs(c.by_observable[:, OBSERVABLE.alpha2])
        return cls(rows, stated, model, priors, np.stack([own_sigma(c, rows.std), per_angle]))

    def refit(
        self, theta: FloatArray, scale: float, extra: Added, start: FloatArray | None = None
    ) -> tuple[Refit, Linear] | None:
        """Return the refit with further parameters; None where the rows do not determine it.

        Parameters
        ----------
        theta, scale
            A fit without them, from which the steps set out.
        extra
            The further parameters.
        start
            Their values to set out from, shape (k,); 0 by default.
        """
        return _Steps(self, extra + self.stated, len(extra)).run(theta, scale, start)


@dataclass(frozen=True)
class _State:
    """Where the steps are: residuals over their uncertainty, derivatives, and residuals, mrad."""

    standardised: FloatArray
    slope: FloatArray
    by_observable: FloatArray
    mrad: FloatArray


@dataclass(frozen=True)
class _Steps:
    """Gauss-Newton steps with the weights and the noise scale that agree with them."""

    setting: Setting
    added: Added
    own: int

    def run(
        self, theta: FloatArray, scale: float, start: FloatArray | None
    ) -> tuple[Refit, Linear] | None:
        model, priors = self.setting.model, self.setting.priors
        p, k = len(model.free), len(self.added)
        stated, measured = prior_of(model, priors), measured_of(model, priors)
        known = stated + measured
        precision = np.zeros((p + k, p + k))
        precision[:p, :p] = known.precision
        precision[np.arange(p, p + k), np.arange(p, p + k)] = self.added.prior_std**-2.0
        shift = np.append(known.shift, np.zeros(k))
        problem = FitProblem(self.setting.rows, model, stated, measured, priors.noise_scale, ROBUST)
        x = np.append(theta[list(model.indices)], np.zeros(k))
        if start is not None:
            x[p : p + self.own] = start
        state = self._at(x)
        if state is None:
            return None
        decided, factor = float(p + self.own), None
        for _ in range(STEPS):
            scale = problem.noise_scale(state.standardised, decided)
            strength = weight(state.standardised, scale, ROBUST) / (ROBUST.core * scale) ** 2
            weighted = state.slope * strength[:, None]
            data = weighted.T @ state.slope
            try:
                factor = cho_factor(data + precision)
            except LinAlgError:
                return None
            decided = p + k - float(np.trace(cho_solve(factor, precision)))
            gradient = weighted.T @ state.standardised + precision @ x - shift
            step = -cho_solve(factor, gradient)
            length = float(np.sqrt(max(float(-step @ gradient), 0.0)))
            moved = self._moved(x, state, step, scale, precision, shift)
            if moved is None or length < LAST_STEP:
                break
            x, state = moved
        if factor is None:
            return None
        covariance = cho_solve(factor, np.eye(p + k))
        if not np.all(np.isfinite(covariance)):
            return None
        evidence = self._evidence(x, state, scale, precision, shift, covariance)
        own, other = slice(p, p + self.own), slice(p + self.own, None)
        found = Refit(
            theta=embed(x[:p], model.free),
            added=x[own],
            covariance=covariance[own, own],
            stated=x[other],
            stated_covariance=covariance[other, other],
            scale=scale,
            standardised=state.standardised,
            residual_mrad=state.mrad,
            evidence=evidence,
        )
        return found, Linear(
            state.slope, state.by_observable, state.standardised, strength, covariance
        )

    def _at(self, x: FloatArray) -> _State | None:
        """Return residuals and derivatives, None where a corrected depth is not positive."""
        s, p = self.setting, len(self.setting.model.free)
        gaze, z = corrected(s.rows, self.added.loadings, x[p:])
        if not np.all(z > 0):
            return None
        theta = embed(x[:p], s.model.free)
        c = misclosure(theta, gaze, z, parameters=s.model.indices)
        sigma = s.unit[0]
        by_observable = c.by_observable / sigma[:, None]
        # The correction is what is taken off an observation.
        by_added = -np.einsum("nq,nqk->nk", by_observable, self.added.loadings)
        slope = np.hstack([c.by_theta / sigma[:, None], by_added])
        mrad = 1e3 * c.value / -c.by_observable[:, OBSERVABLE.x1c]
        state = _State(c.value / sigma, slope, -by_observable, mrad)
        return state if np.all(np.isfinite(slope)) else None

    def _moved(
        self,
        x: FloatArray,
        before: _State,
        step: FloatArray,
        scale: float,
        precision: FloatArray,
        shift: FloatArray,
    ) -> tuple[FloatArray, _State] | None:
        """Return the place after a step, halved until the fit is no worse there; None if stuck."""
        least = self._cost(x, before, scale, precision, shift)
        for _ in range(HALVINGS + 1):
            state = self._at(x + step)
            if state is not None:
                cost = self._cost(x + step, state, scale, precision, shift)
                if cost <= least + 1e-9 * abs(least):
                    return x + step, state
            step = step / 2
        return None

    @staticmethod
    def _cost(
        x: FloatArray, state: _State, scale: float, precision: FloatArray, shift: FloatArray
    ) -> float:
        density = log_density(state.standardised, float(np.log(scale)), ROBUST).sum()
        return float(0.5 * x @ precision @ x - shift @ x - density)

    def _evidence(
        self,
        x: FloatArray,
        state: _State,
        scale: float,
        precision: FloatArray,
        shift: FloatArray,
        covariance: FloatArray,
    ) -> float:
        mean, std = self.setting.priors.noise_scale
        sigma, per_angle = self.setting.unit
        unit = np.diag(covariance)
        scaled = covariance / np.sqrt(np.outer(unit, unit))
        volume = 0.5 * (np.linalg.slogdet(scaled)[1] + np.log(unit).sum())
        volume += UNIT_DENSITY * len(self.setting.model.free)
        return float(
            -self._cost(x, state, scale, precision, shift)
            + volume
            - np.log(self.added.prior_std).sum()
            + np.log(per_angle / sigma).sum()
            - 0.5 * ((np.log(scale) - mean) / std) ** 2
        )


def corrected(
    rows: Observations, loadings: FloatArray, values: FloatArray
) -> tuple[Gaze, FloatArray]:
    """Return gazes and depths, mm, shape (n,), less errors ``loadings @ values``."""
    if not len(values):
        return rows.gaze, rows.z_mm
    error = loadings @ values
    gaze = Gaze(
        rows.x1c - error[:, OBSERVABLE.x1c],
        rows.y1c - error[:, OBSERVABLE.y1c],
        rows.alpha2_rad - error[:, OBSERVABLE.alpha2],
        rows.gaze_residual_rad - error[:, OBSERVABLE.residual],
    )
    return gaze, rows.z_mm - error[:, OBSERVABLE.z]
