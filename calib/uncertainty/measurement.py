"""What is known of a calibrated instrument, and what it reads of a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.parameters import embed


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
    """Errors common to all readings: m independent standard-normal variables.

    Parameters
    ----------
    names
        Length m.
    with_parameters
        Their covariance with the free parameters, shape (k, m).
    """

    names: tuple[str, ...]
    with_parameters: FloatArray


@dataclass(frozen=True)
class Instrument:
    """The calibrated instrument: parameters, errors of its readings, shared errors."""

    parameters: ParameterKnowledge
    reading: ReadingSpread
    shared: SharedErrors | None = None

    @property
    def theta(self) -> FloatArray:
        """Best estimate of the full parameter vector, shape (COUNT,)."""
        return embed(self.parameters.values, self.parameters.names)


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
        Loadings of the shared errors on the four, shape (4, m); None without shared errors.
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
