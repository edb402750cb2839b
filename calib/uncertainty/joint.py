"""Several quantities from the same trials of one instrument (JCGM 102, 7).

Each quantity stops by a rule of its own; trials go on for those that need more. Depth and position
of one point, and all that is measured by one instrument, so come from one set of draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.uncertainty.measurement import Instrument
from calib.uncertainty.model import MeasurementModel
from calib.uncertainty.montecarlo import BLOCK_TRIALS
from calib.uncertainty.trials import draw_trials


class Collector(Protocol):
    """Takes results block by block until it has enough."""

    @property
    def settled(self) -> bool:
        """Whether it has enough."""

    def add(self, values: FloatArray) -> None:
        """Take the results of one more block, shape (t,)."""


class FixedNumber:
    """Collects the results of a given number of trials, rounded up to whole blocks."""

    def __init__(self, trials: int) -> None:
        self._wanted = -(-trials // BLOCK_TRIALS)
        self._blocks: list[FloatArray] = []

    @property
    def settled(self) -> bool:
        """Whether that many trials are there."""
        return len(self._blocks) >= self._wanted

    def add(self, values: FloatArray) -> None:
        """Take the results of one more block, shape (t,)."""
        self._blocks.append(values)

    def values(self) -> FloatArray:
        """Return all results, in the order of the trials."""
        return np.concatenate(self._blocks)


@dataclass(frozen=True)
class Quantity:
    """A result asked for.

    Parameters
    ----------
    value
        From positions of the model's points, mm, shape (n, 3, t), to results, shape (t,).
    collector
        Who takes them.
    """

    value: Callable[[FloatArray], FloatArray]
    collector: Collector


@dataclass(frozen=True)
class MeasuredPoints:
    """Points that an instrument measures, and what is asked of them."""

    model: MeasurementModel
    quantities: tuple[Quantity, ...]

    @property
    def waiting(self) -> list[Quantity]:
        """Quantities that need more trials."""
        return [q for q in self.quantities if not q.collector.settled]


def propagate_together(
    instrument: Instrument, asked: Sequence[MeasuredPoints], rng: np.random.Generator
) -> tuple[EstimationError | None, ...]:
    """Give all quantities results of the same trials, until each has enough.

    Parameters
    ----------
    asked
        Measurements by `instrument`.
    rng
        Equal generators give equal results.

    Returns
    -------
    For each of `asked`, the error that ended it, such as an interval without end; else None.
    """
    errors: list[EstimationError | None] = [None] * len(asked)
    waiting, number = list(range(len(asked))), 0
    # The same to the end: no result hangs on how long others of as many readings take.
    readings = max((one.model.readings for one in asked), default=0)
    while waiting:
        trials = draw_trials(instrument, rng, readings=readings, part=number)
        for i in waiting:
            points = asked[i].model.positions_in(trials)
            try:
                for quantity in asked[i].waiting:
                    quantity.collector.add(quantity.value(points))
            except EstimationError as error:
                errors[i] = error
        waiting = [i for i in waiting if errors[i] is None and asked[i].waiting]
        number += 1
    return tuple(errors)


def raise_first(errors: Sequence[EstimationError | None]) -> None:
    """Raise the first of the errors, if there is one."""
    for error in errors:
        if error is not None:
            raise error
