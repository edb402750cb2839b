"""What is known of a calibrated instrument, and what it reads of a point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import Spectrum, unit_diagonal
from calib.geometry.parameters import INDEX, PARAMETERS, STANDOFF, embed

PARAMETERS_LABEL = "parameters"
"""Source of what rows and priors leave uncertain of the parameters, together."""

READING_NAMES = ("x1c", "y1c", "alpha2", "gaze residual")
"""Names of the errors of a reading, in the order of OBSERVABLE."""

READINGS = len(READING_NAMES)
"""Observed quantities of a gaze."""


@dataclass(frozen=True)
class Spread:
    """Error of one observed quantity: a normal part plus a rectangular one.

    Parameters
    ----------
    normal
        Standard uncertainty of the normal part.
    width
        Full width of the rectangular part: a count of the encoder, a pixel. Its standard
        uncertainty is width / sqrt(12).
    """

    normal: float = 0.0
    width: float = 0.0


NONE = Spread()


@dataclass(frozen=True)
class ReadingSpread:
    """Errors of a reading, in the units of the quantities (1, 1, rad, rad)."""

    x1c: Spread = NONE
    y1c: Spread = NONE
    alpha2_rad: Spread = NONE
    gaze_residual_rad: Spread = NONE

    @property
    def parts(self) -> tuple[Spread, Spread, Spread, Spread]:
        """The four in the order of OBSERVABLE."""
        return self.x1c, self.y1c, self.alpha2_rad, self.gaze_residual_rad


@dataclass(frozen=True)
class ParameterKnowledge:
    """What the calibration says of the free parameters of the selected model.

    Parameters
    ----------
    names
        Free parameters, length k.
    values, covariance
        Shapes (k,) and (k, k).
    degrees_of_freedom
        Of the covariance, one number for all; math.inf if it rests on known uncertainties, None
        where it is not defined (posterior, robust fit, priors).
    evaluation
        "A", "B" or "A, B", one a parameter.
    draws
        Posterior draws, shape (m, k), in the order of the chain; None if there are none: then the
        parameters are normal, or Student t with finite `degrees_of_freedom`.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    degrees_of_freedom: float | None
    evaluation: tuple[str, ...]
    draws: FloatArray | None = None


@dataclass(frozen=True)
class SharedErrors:
    """Errors common to rows and readings: m independent standard-normal variables.

    Parameters
    ----------
    names
        Where each comes from, length m; those of one source share its name.
    with_parameters
        By how much one unit of each has moved the free parameters, shape (k, m): their covariance
        with these.
    own_draws
        The draws of the parameters less what the shared errors have moved each by, (draws, k); None
        where there are no draws.
    of_rows_alone
        So many of them, the last, are errors of the calibration rows that no reading has.
    """

    names: tuple[str, ...]
    with_parameters: FloatArray
    own_draws: FloatArray | None = None
    of_rows_alone: int = 0

    @property
    def of_readings(self) -> int:
        """How many, the first, are errors of readings too."""
        return len(self.names) - self.of_rows_alone


@dataclass(frozen=True)
class Instrument:
    """The calibrated instrument: parameters, errors of its readings, shared errors.

    The errors of its parameters are ``own + by_shared @ common``: what rows and priors leave
    uncertain, and what the shared errors, which also falsify every new reading, have moved them by.
    The two are independent. All that is said of a measurement is made from these parts: a parameter
    that has absorbed part of a shared error takes it away again, or adds to it.

    Parameters
    ----------
    parameters, reading, shared
        The parts.
    mean_gaze_rad
        Mean reading of the calibration rows, at which budgets take the effective baseline.

    Raises
    ------
    ValueError
        If there are draws of the parameters, but not of their own part.
    """

    parameters: ParameterKnowledge
    reading: ReadingSpread
    shared: SharedErrors | None = None
    mean_gaze_rad: float = math.pi / 2

    def __post_init__(self) -> None:
        if self.parameters.draws is not None and self.own_draws is None:
            raise ValueError("draws of parameters with shared errors need those of their own part")

    @property
    def theta(self) -> FloatArray:
        """Best estimate of the full parameter vector, shape (COUNT,)."""
        return embed(self.parameters.values, self.parameters.names)

    @property
    def by_shared(self) -> FloatArray:
        """Change of the free parameters per unit of each shared error, (k, m); m may be 0."""
        if self.shared is None:
            return np.zeros((len(self.parameters.names), 0))
        return self.shared.with_parameters

    def loadings(self, given: FloatArray | None, count: int) -> FloatArray:
        """Return the loadings of all m shared errors on readings, shape (count, 4, m).

        Parameters
        ----------
        given
            Of those that readings have, shape (count, 4, k); None if they are all 0.
        """
        loadings = np.zeros((count, READINGS, self.by_shared.shape[1]))
        if given is not None and self.shared is not None:
            loadings[:, :, : given.shape[2]] = given
        return loadings

    @property
    def own_draws(self) -> FloatArray | None:
        """Draws of the parameters without the shared errors' part, shape (draws, k)."""
        if self.shared is None or not np.any(self.shared.with_parameters):
            return self.parameters.draws
        return self.shared.own_draws

    @property
    def own_covariance(self) -> FloatArray:
        """Covariance of the parameters without the shared errors' part, shape (k, k).

        The difference of the two, as far as it is one. In directions in which the shared errors
        explain more than is uncertain, nothing is left to the own part; the parts then add up to
        more than the whole, and in no direction to less, so that no result comes out more certain
        than covariance and shared errors as stated would make it. A calibration makes the whole
        from the parts: there it happens by rounding alone.
        """
        p, by_shared = self.parameters, self.by_shared
        if not np.any(by_shared):
            return p.covariance
        scale = unit_diagonal(p.covariance)[0]
        rest = p.covariance - by_shared @ by_shared.T
        value, vectors = np.linalg.eigh(rest / np.outer(scale, scale))
        if value.min(initial=0.0) >= 0:
            return rest
        root = Spectrum(scale, value, vectors).root()
        return root @ root.T


def with_standoff(instrument: Instrument, rng: np.random.Generator | None = None) -> Instrument:
    """Return an instrument that may read targets off C2's centre column.

    Calibrated by rows without gaze residual it does not know how far C2's centre stands ahead of
    the yaw axis: the prior then does.

    Parameters
    ----------
    rng
        Draws from that prior, where the instrument has draws.

    Raises
    ------
    ValueError
        If there are draws and no `rng`.
    """
    p, shared = instrument.parameters, instrument.shared
    if STANDOFF in p.names:
        return instrument
    size, std = len(p.names), PARAMETERS[INDEX[STANDOFF]].prior_std or 0.0
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size] = p.covariance
    covariance[size, size] = std**2
    drawn = None
    if p.draws is not None:
        if rng is None:
            raise ValueError("an instrument with draws needs draws of the standoff")
        drawn = std * rng.standard_normal((len(p.draws), 1))
    parameters = replace(
        p,
        names=(*p.names, STANDOFF),
        values=np.append(p.values, 0.0),
        covariance=covariance,
        evaluation=(*p.evaluation, "B"),
        draws=_beside(p.draws, drawn),
    )
    if shared is not None:
        unmoved = np.zeros((1, shared.with_parameters.shape[1]))
        shared = replace(
            shared,
            with_parameters=np.concatenate([shared.with_parameters, unmoved]),
            own_draws=_beside(shared.own_draws, drawn),
        )
    return replace(instrument, parameters=parameters, shared=shared)


def _beside(draws: FloatArray | None, more: FloatArray | None) -> FloatArray | None:
    """Return draws with those of one more parameter, shape (m, 1), beside them."""
    return draws if draws is None or more is None else np.hstack([draws, more])


@dataclass(frozen=True)
class ModelShare:
    """A fitted model's part in the average over all of them.

    Parameters
    ----------
    model, weight
        Its name and its weight; the weights of all sum to 1.
    instrument
        As the model describes it, by means and covariance alone.
    noise_factor
        By how much its fit proved the stated uncertainties of a reading too small, at least 1.
    factor95
        Coverage factor of its inverse depth; see `calib.instrument.calibrated.DepthTable`.
    """

    model: str
    weight: float
    instrument: Instrument
    noise_factor: float
    factor95: float


@dataclass(frozen=True)
class Reading:
    """What the instrument reads of one point.

    Parameters
    ----------
    x1c, y1c
        Normalised, undistorted coordinates in C1.
    alpha2_rad, gaze_residual_rad
        Encoder reading and gaze residual, rad.
    shared
        Loadings of the shared errors that readings have on the four, shape (4, k); None without.
    depth_from
        Another reading whose depth this point has, such as that of its board's centre; None if it
        was gazed at itself. Points of one board must name one and the same reading.
    """

    x1c: float
    y1c: float
    alpha2_rad: float
    gaze_residual_rad: float = 0.0
    shared: FloatArray | None = None
    depth_from: Reading | None = None

    @property
    def values(self) -> FloatArray:
        """The four in the order of OBSERVABLE."""
        return np.array([self.x1c, self.y1c, self.alpha2_rad, self.gaze_residual_rad])
