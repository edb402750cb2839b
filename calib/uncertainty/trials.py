"""Blocks of trials of one instrument, each for any number of measurements (JCGM 102, 7).

All that an instrument measures depends on the same parameters, and on reading errors of the same
distributions. So a block of trials is drawn once, as drawn parameters and standard random numbers,
and every measurement makes its own reading errors from these. Each result has the distribution that
trials of its own would give; what results of one block share is the scatter of a finite number.

The m shared errors are not drawn one by one. They enter through what they do to k parameters and
to readings, which is jointly normal, the readings' own normal errors included. So k + 4 n random
numbers and the triangular factor of that covariance, parameters first, make the parameters and the
errors of n readings; the first k move the parameters alike in every measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import embed
from calib.geometry.plane import DrawnPlanes, drawn_planes
from calib.uncertainty.distributions import (
    GivenInputs,
    Inputs,
    NormalInputs,
    StudentInputs,
    draw,
    triangular_factor,
)
from calib.uncertainty.measurement import READINGS, Instrument
from calib.uncertainty.montecarlo import BLOCK_TRIALS


@dataclass(frozen=True)
class Trials:
    """A block of t trials, for up to n readings.

    Parameters
    ----------
    planes
        Gaze planes of the drawn parameters.
    normal
        Standard normal numbers, shape (k + 4 n, t): first those that move the k parameters; k is 0
        without shared errors.
    uniform
        Numbers within ±1, shape (n w, t), w being the quantities with a rectangular error.
    """

    planes: DrawnPlanes
    normal: FloatArray
    uniform: FloatArray


@dataclass(frozen=True)
class ReadingErrors:
    """How the errors of n readings are made from the numbers of `Trials`.

    Parameters
    ----------
    from_normal
        Shape (4 n, k + 4 n).
    half_width
        Of each rectangular error, length n w.
    rough
        The quantity of each rectangular error, counted over all readings, length n w.
    """

    from_normal: FloatArray
    half_width: tuple[float, ...]
    rough: tuple[int, ...]

    def __call__(self, trials: Trials) -> FloatArray:
        """Return errors of the readings, shape (4 n, t)."""
        errors: FloatArray = self.from_normal @ trials.normal[: self.from_normal.shape[1]]
        for i, (half, row) in enumerate(zip(self.half_width, self.rough, strict=True)):
            errors[row] += half * trials.uniform[i]
        return errors


def own_inputs(instrument: Instrument) -> Inputs:
    """Return what rows and priors leave uncertain of the parameters."""
    p, own = instrument.parameters, instrument.own_draws
    if own is not None:
        return GivenInputs(own)
    if p.degrees_of_freedom is not None and math.isfinite(p.degrees_of_freedom):
        return StudentInputs(p.values, instrument.own_covariance, p.degrees_of_freedom)
    return NormalInputs(p.values, instrument.own_covariance)


def reading_errors(instrument: Instrument, loadings: FloatArray) -> ReadingErrors:
    """Return how errors of n readings are made; `loadings` of shape (n, 4, m), m may be 0."""
    count, parts = len(loadings), instrument.reading.parts
    moved = _moved(instrument)
    effects = np.vstack([moved, loadings.reshape(READINGS * count, -1)])
    own = np.tile([part.normal for part in parts], count)
    covariance = effects @ effects.T
    covariance[len(moved) :, len(moved) :] += np.diag(own**2)
    rough = _rough(instrument)
    return ReadingErrors(
        from_normal=triangular_factor(covariance)[len(moved) :],
        half_width=tuple(parts[q].width / 2 for q in rough) * count,
        rough=tuple(READINGS * i + q for i in range(count) for q in rough),
    )


def draw_trials(
    instrument: Instrument, rng: np.random.Generator, *, readings: int, part: int
) -> Trials:
    """Return a block of trials; given draws of the parameters come from `part`."""
    free = draw(own_inputs(instrument), rng, BLOCK_TRIALS, part=part)
    moved = _moved(instrument)
    normal = rng.standard_normal((len(moved) + READINGS * readings, BLOCK_TRIALS))
    if len(moved):
        free = free + (triangular_factor(moved @ moved.T) @ normal[: len(moved)]).T
    return Trials(
        planes=drawn_planes(embed(free, instrument.parameters.names)),
        normal=normal,
        uniform=rng.uniform(-1, 1, (len(_rough(instrument)) * readings, BLOCK_TRIALS)),
    )


def _moved(instrument: Instrument) -> FloatArray:
    """Return what each shared error moves the parameters by, (k, m); (0, 0) without any."""
    by_shared = instrument.by_shared
    return by_shared if by_shared.shape[1] else np.zeros((0, 0))


def _rough(instrument: Instrument) -> list[int]:
    """Return the quantities of a reading that have a rectangular error."""
    return [q for q, part in enumerate(instrument.reading.parts) if part.width > 0]
