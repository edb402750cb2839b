"""Depth intervals for many readings at once: posterior predictive, and the linear law beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.parameters import INDEX, embed
from calib.geometry.plane import Gaze, drawn_planes
from calib.uncertainty.distributions import factor
from calib.uncertainty.measurement import PARAMETERS_LABEL, READING_NAMES, Instrument
from calib.uncertainty.montecarlo import NORMAL_FACTOR, numerical_tolerance
from calib.uncertainty.position import in_front, position_jacobian

DRAWS = 16_000
"""Trials a reading: the ends of a 95 % interval are then known to 2 % of u."""

CHUNK_ELEMENTS = 2_000_000
"""Trials x readings held at a time; with more readings each gets fewer trials, down to `FEW`."""

FEW = 2000

TOLD_AFTER = 200
"""Readings between two words on progress."""

DIGITS = 1
"""Significant digits of u that decide clause 8 of JCGM 101 here; more than `DRAWS` can resolve
would make the verdict a matter of luck. The certificate's depths get two (adaptive procedure)."""


@dataclass(frozen=True)
class DepthPrediction:
    """Measured depths with their uncertainties; arrays of shape (n,), mm.

    Parameters
    ----------
    z_mm
        At the best estimates.
    u_mm
        Standard deviation of the predictive distribution; infinite where it has none.
    low95_mm, high95_mm
        Probabilistically symmetric 95 % interval; `high95_mm` is infinite where the reading
        cannot distinguish the target from one at infinity.
    gum_u_mm
        By the linear law of propagation (JCGM 100).
    gum_valid
        Whether clause 8 of JCGM 101 validates z ± 1.96 gum_u.
    """

    z_mm: FloatArray
    u_mm: FloatArray
    low95_mm: FloatArray
    high95_mm: FloatArray
    gum_u_mm: FloatArray
    gum_valid: BoolArray


def predict_depths(
    instrument: Instrument,
    gaze: Gaze,
    rng: np.random.Generator,
    *,
    loadings: FloatArray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DepthPrediction:
    """Return the depths of `gaze` as `instrument` measures them.

    All readings share the draws of the parameters and of the standardised reading errors, so that
    neighbouring readings do not scatter against each other.

    Parameters
    ----------
    loadings
        Shared errors' effect on the readings, shape (n, 4, m); None without shared errors.
    progress
        Told how many readings of how many are done.
    """
    intervals = np.empty((len(gaze), 3))
    for i, z in enumerate(depth_draws(instrument, gaze, rng, loadings=loadings)):
        if progress is not None and i % TOLD_AFTER == 0:
            progress(i, len(gaze))
        spread = float(z.std()) if np.isfinite(z).all() else np.inf
        # An infinite end is an answer: interpolation between two infinities is not.
        low, high = np.quantile(z, [0.025, 0.975], method="inverted_cdf")
        intervals[i] = spread, low, high
    linear = linear_positions(instrument, gaze, loadings)
    z, u = linear.position_mm[:, 2], np.sqrt(linear.covariance_mm2[:, 2, 2])
    return DepthPrediction(
        z_mm=z,
        u_mm=intervals[:, 0],
        low95_mm=intervals[:, 1],
        high95_mm=intervals[:, 2],
        gum_u_mm=u,
        gum_valid=_validated(z, u, intervals[:, 1:]),
    )


def depth_draws(
    instrument: Instrument,
    gaze: Gaze,
    rng: np.random.Generator,
    *,
    loadings: FloatArray | None = None,
    most: int = DRAWS,
) -> Iterator[FloatArray]:
    """Yield draws of the predictive distribution of depth, mm, shape (t,), of each gaze.

    Infinite where the drawn ray does not meet the drawn plane in front of C1. Parameters as
    `predict_depths`, and `most`, the greatest number of draws a gaze.
    """
    n = len(gaze)
    loadings = instrument.loadings(loadings, n)
    nominal = np.stack([gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual], axis=1)
    count = int(np.clip(CHUNK_ELEMENTS // max(n, 1), FEW, most))
    thetas, shared, errors = _draws(instrument, rng, count)
    planes = drawn_planes(thetas)
    for i in range(n):
        values = nominal[i] + errors + shared @ loadings[i].T
        yield in_front(planes.depth(Gaze(*values.T)))


def _draws(
    instrument: Instrument, rng: np.random.Generator, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return draws of parameters (t, COUNT), shared errors (t, m) and reading errors (t, 4)."""
    p, own = instrument.parameters, instrument.own_draws
    if own is None:
        normal = rng.standard_normal((count, len(p.values)))
        free = p.values + normal @ factor(instrument.own_covariance).T
    else:
        free = own[rng.integers(len(own), size=count)]
    by_shared = instrument.by_shared
    common = rng.standard_normal((count, by_shared.shape[1]))
    free = free + common @ by_shared.T
    errors = np.stack(
        [
            part.normal * rng.standard_normal(count) + part.width * rng.uniform(-0.5, 0.5, count)
            for part in instrument.reading.parts
        ],
        axis=1,
    )
    return embed(free, p.names), common, errors


@dataclass(frozen=True)
class LinearPositions:
    """Positions with what their errors are made of, to first order.

    Parameters
    ----------
    position_mm
        Shape (n, 3).
    by_common
        Derivatives by the parameters' own errors and by the shared errors, with what these have
        moved the parameters by, shape (n, 3, k + m).
    common
        Covariance of these, shape (k + m, k + m).
    own
        Effect of one standard deviation of each reading error, mm, shape (n, 3, 4).
    """

    position_mm: FloatArray
    by_common: FloatArray
    common: FloatArray
    own: FloatArray

    @property
    def covariance_mm2(self) -> FloatArray:
        """Of each position, shape (n, 3, 3)."""
        common = self.by_common @ self.common @ self.by_common.swapaxes(1, 2)
        covariance: FloatArray = common + self.own @ self.own.swapaxes(1, 2)
        return covariance


def linear_positions(
    instrument: Instrument,
    gaze: Gaze,
    loadings: FloatArray | None = None,
    *,
    reading_std: FloatArray | None = None,
) -> LinearPositions:
    """Return positions and the parts of their errors by the linear law of propagation.

    Parameters
    ----------
    loadings
        Shared errors' effect on the readings, shape (n, 4, m); None without shared errors.
    reading_std
        Standard uncertainties of x1c, y1c, alpha2 and gaze residual, shape (n, 4), where they
        differ from row to row; None for the instrument's.
    """
    p, by_shared = instrument.parameters, instrument.by_shared
    k, m = by_shared.shape
    jacobian = position_jacobian(instrument.theta, gaze)
    by_theta = jacobian.by_theta[:, :, [INDEX[name] for name in p.names]]
    given = instrument.loadings(loadings, len(gaze))
    through_both = by_theta @ by_shared + jacobian.by_reading @ given
    joint = np.eye(k + m)
    joint[:k, :k] = instrument.own_covariance
    std = reading_std
    if std is None:
        parts = instrument.reading.parts
        std = np.array([np.hypot(part.normal, part.width / np.sqrt(12)) for part in parts])
    return LinearPositions(
        position_mm=jacobian.position,
        by_common=np.concatenate([by_theta, through_both], axis=2),
        common=joint,
        own=jacobian.by_reading * std[..., None, :],
    )


def depth_sources(instrument: Instrument, linear: LinearPositions) -> dict[str, FloatArray]:
    """Return what each source contributes to u(z), mm, shape (n,) each, by the linear law.

    The sources are independent and add up in quadrature; those without any effect are left out.
    """
    k = len(instrument.parameters.names)
    by_common, own = linear.by_common[:, 2], linear.own[:, 2]
    parameters, covariance = by_common[:, :k], linear.common[:k, :k]
    square = {PARAMETERS_LABEL: np.einsum("nk,kl,nl->n", parameters, covariance, parameters)}
    shared = () if instrument.shared is None else instrument.shared.names
    effects = zip((*shared, *READING_NAMES), (*by_common[:, k:].T, *own.T), strict=True)
    for name, effect in effects:
        square[name] = square.get(name, 0.0) + effect**2
    return {name: np.sqrt(part) for name, part in square.items() if part.any()}


def _validated(z: FloatArray, u: FloatArray, ends: FloatArray) -> BoolArray:
    """Return where the linear interval's ends are those of the distribution (clause 8)."""
    linear = np.stack([z - NORMAL_FACTOR * u, z + NORMAL_FACTOR * u], axis=1)
    tolerance = np.array([numerical_tolerance(float(x), digits=DIGITS) for x in u])
    valid: BoolArray = np.all(np.abs(linear - ends) <= tolerance[:, None], axis=1)
    return valid
