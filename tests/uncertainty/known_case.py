"""The known case: depth at 2.28 m with the paper's baseline, worked out before the program was."""

from __future__ import annotations

import math

import numpy as np

from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    Spread,
)

PIXEL = 1 / 421.71
STEP = 0.00098
U_BASELINE, U_DELTA2, CORRELATION = 0.5, 0.0005, -0.9

READING = Reading(x1c=-0.0158, y1c=0.0036, alpha2_rad=math.atan2(1, 0.0629))


def knowledge(
    *, degrees_of_freedom: float | None = math.inf, draws: np.ndarray | None = None
) -> ParameterKnowledge:
    cross = CORRELATION * U_BASELINE * U_DELTA2
    return ParameterKnowledge(
        names=("baseline_mm", "delta2_rad"),
        values=np.array([77.09, 0.0133]),
        covariance=np.array([[U_BASELINE**2, cross], [cross, U_DELTA2**2]]),
        degrees_of_freedom=degrees_of_freedom,
        evaluation=("A", "A"),
        draws=draws,
    )


def instrument(parameters: ParameterKnowledge | None = None) -> Instrument:
    return Instrument(
        parameters=knowledge() if parameters is None else parameters,
        reading=ReadingSpread(x1c=Spread(width=PIXEL), alpha2_rad=Spread(width=STEP)),
    )
