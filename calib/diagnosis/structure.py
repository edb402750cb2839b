"""Structure that a model leaves in the residuals, and priors that the rows stretch.

Residuals of the right model scatter without order. Against the order of the rows (a step, a slope),
depth, direction in C1 and side of approach each is tested by one more regressor, an error of the
reading, with the model's parameters estimated anew: a linear model's t test, its noise estimated
from what the regressor leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from calib.core.arrays import FloatArray
from calib.diagnosis.bases import Base
from calib.diagnosis.trials import Looked, Search, reading_step
from calib.fit.priors import Priors, prior_of
from calib.fit.robust import RobustFit
from calib.geometry.plane import OBSERVABLE

STRUCTURED = 1e-3
"""Probability below which residuals are said to have structure, all tests together."""

STRETCHED = 2.5
"""Standard deviations of its prior from which an estimate is told to stretch it."""


@dataclass(frozen=True)
class Structure:
    """One test of the residuals.

    Parameters
    ----------
    against
        What they are tested against.
    at
        Row from which a step sets in; None for the others.
    probability
        Of so much by chance; places of a step counted in.
    """

    against: str
    at: str | None
    probability: float


@dataclass(frozen=True)
class Stretched:
    """A parameter whose estimate lies far out in its prior.

    Parameters
    ----------
    name
        Of the parameter.
    deviations
        Distance from the prior's mean, in its standard deviations.
    """

    name: str
    deviations: float


def residual_structure(base: Base) -> tuple[Structure, ...]:
    """Return all tests of the residuals of a fit."""
    looked = base.looked
    found = [
        Structure(name, None, float(_probability(base, pattern[:, None])[0]))
        for name, pattern in _regressors(looked).items()
        if np.ptp(pattern) > 0
    ]
    for step in reading_step(looked):
        if not isinstance(step, Search):
            continue
        each = _probability(base, step.patterns)
        best = int(np.argmin(each))
        # Bonferroni: neighbouring places tell nearly the same, so this is cautious.
        p = min(1.0, float(each[best]) * len(each))
        found.insert(0, Structure("order, a step", step.at[best], p))
    return tuple(found)


def _regressors(looked: Looked) -> dict[str, FloatArray]:
    rows, session = looked.rows, looked.session
    found = {
        "order, a slope": session.progress,
        "depth": rows.z_mm / float(rows.z_mm.max()),
        "x1c": rows.x1c,
        "y1c": rows.y1c,
    }
    if len(session.approach):
        found["approach"] = session.approach
    return found


def _probability(base: Base, patterns: FloatArray) -> FloatArray:
    """Return the probability of each pattern's t by chance, shape (m,), patterns (n, m)."""
    count = len(base.looked.rows)
    freedom = max(count - len(base.setting.model.free) - 1.0, 1.0)
    square = 2 * base.linear.gains(OBSERVABLE.alpha2, patterns)
    # The noise scale is that of the residuals without the pattern: what it explains is taken off.
    share = np.minimum(square / (freedom + 1), 1 - 1e-12)
    t = np.sqrt(freedom * share / (1 - share))
    probability: FloatArray = 2 * stdtr(freedom, -t)
    return probability


def structured(tests: tuple[Structure, ...]) -> Structure | None:
    """Return the test that shows structure most plainly; None where none does."""
    if not tests:
        return None
    plainest = min(tests, key=lambda test: test.probability)
    return plainest if plainest.probability * len(tests) < STRUCTURED else None


def stretched_priors(fit: RobustFit, priors: Priors) -> tuple[Stretched, ...]:
    """Return the parameters that lie far out in their priors."""
    known = prior_of(fit.structure, priors)
    precision = np.diag(known.precision)
    some = precision > 0
    mean = np.where(some, known.shift / np.where(some, precision, 1.0), 0.0)
    ratio = np.abs(fit.values - mean) * np.sqrt(precision)
    return tuple(
        Stretched(name, float(r)) for name, r in zip(fit.names, ratio, strict=True) if r > STRETCHED
    )
