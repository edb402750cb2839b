"""Depth intervals for many readings at once: posterior predictive, and the linear law beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.geometry.parameters import INDEX, embed
from calib.geometry.plane import Gaze, drawn_planes
from calib.uncertainty.distributions import factor
from calib.uncertainty.measurement import Instrument
from calib.uncertainty.montecarlo import NORMAL_FACTOR, numerical_tolerance
from calib.uncertainty.position import READINGS, position_jacobian

DRAWS = 16_000
"""Trials a reading: the ends of a 95 % interval are then known to 2 % of u."""

CHUNK_ELEMENTS = 2_000_000
"""Trials x readings held at a time; with more readings each gets fewer trials, down to `FEW`."""

FEW = 2000

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
        cannot tell the target from one at infinity.
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
) -> DepthPrediction:
    """Return the depths of `gaze` as `instrument` measures them.

    All readings share the draws of the parameters and of the standardised reading errors, so that
    neighbouring readings do not scatter against each other.

    Parameters
    ----------
    loadings
        Shared errors' effect on the readings, shape (n, 4, m); None without shared errors.
    """
    intervals = np.empty((len(gaze), 3))
    for i, z in enumerate(depth_draws(instrument, gaze, rng, loadings=loadings)):
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
    m = 0 if instrument.shared is None else len(instrument.shared.names)
    loadings = np.zeros((n, READINGS, m)) if loadings is None else loadings
    nominal = np.stack([gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual], axis=1)
    count = int(np.clip(CHUNK_ELEMENTS // max(n, 1), FEW, most))
    thetas, shared, errors = _draws(instrument, rng, count)
    planes = drawn_planes(thetas)
    for i in range(n):
        values = nominal[i] + errors + shared @ loadings[i].T
        z = planes.depth(Gaze(*values.T))
        yield np.where(z > 0, z, np.inf)


def _draws(
    instrument: Instrument, rng: np.random.Generator, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return draws of parameters (t, COUNT), shared errors (t, m) and reading errors (t, 4)."""
    p, shared = instrument.parameters, instrument.shared
    if p.draws is None:
        normal = rng.standard_normal((count, len(p.values)))
        free = p.values + normal @ factor(p.covariance).T
    else:
        free = p.draws[rng.integers(len(p.draws), size=count)]
    common = np.zeros((count, 0))
    if shared is not None:
        carried = shared.with_parameters.T @ np.linalg.pinv(p.covariance, hermitian=True)
        rest = np.eye(len(shared.names)) - carried @ shared.with_parameters
        # What is left over may be indefinite by rounding, and by the covariance being a sample's.
        common = (free - p.values) @ carried.T
        common += rng.standard_normal(common.shape) @ factor(rest).T
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
        Derivatives by the parameters and the shared errors, shape (n, 3, k + m).
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
    p, shared = instrument.parameters, instrument.shared
    k, m = len(p.names), 0 if shared is None else len(shared.names)
    jacobian = position_jacobian(instrument.theta, gaze)
    by_theta = jacobian.by_theta[:, :, [INDEX[name] for name in p.names]]
    loadings = np.zeros((len(gaze), READINGS, m)) if loadings is None else loadings
    joint = np.eye(k + m)
    joint[:k, :k] = p.covariance
    if shared is not None:
        joint[:k, k:] = shared.with_parameters
        joint[k:, :k] = shared.with_parameters.T
    std = reading_std
    if std is None:
        parts = instrument.reading.parts
        std = np.array([np.hypot(part.normal, part.width / np.sqrt(12)) for part in parts])
    return LinearPositions(
        position_mm=jacobian.position,
        by_common=np.concatenate([by_theta, jacobian.by_reading @ loadings], axis=2),
        common=joint,
        own=jacobian.by_reading * std[..., None, :],
    )


def _validated(z: FloatArray, u: FloatArray, ends: FloatArray) -> BoolArray:
    """Return where the linear interval's ends are those of the distribution (clause 8)."""
    linear = np.stack([z - NORMAL_FACTOR * u, z + NORMAL_FACTOR * u], axis=1)
    tolerance = np.array([numerical_tolerance(float(x), digits=DIGITS) for x in u])
    valid: BoolArray = np.all(np.abs(linear - ends) <= tolerance[:, None], axis=1)
    return valid
