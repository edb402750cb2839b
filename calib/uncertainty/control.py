"""Returns of a capture to its first target: whether the zero of the readings still stands.

Every few rows C2 goes back to the reading of the first row, before the same target. What it then
shows elsewhere is the change of the zero since: nothing, a drift, a jump, or steps that a motor
lost without knowing. A single return is held against Shewhart's limits, slow drift adds up in an
exponentially weighted moving average; see `calib.uncertainty.charts`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.uncertainty.charts import (
    SHEWHART_LIMIT,
    Chart,
    Reference,
    ewma,
    recursive_residuals,
    shewhart,
    standardised,
)

Cause: TypeAlias = Literal["lost steps", "drift", "jump", "change"]
"""What a change of the zero looks like; "change" where too few returns tell drift from jump."""

TELLING: Final = 4.0
"""A chi-squared smaller by so much names drift or jump: of normal errors about the right one the
other fits as well in 1 of 20 cases."""


@dataclass(frozen=True)
class Returns:
    """What the returns found, in their order.

    Parameters
    ----------
    change_rad
        By how much the reading that gazes at the target has grown since the first row, (n,).
    u_rad
        Standard uncertainty of each return's own reading, (n,).
    u_first_rad
        That of the first row, which all of them share.
    full_step_rad
        A full step of a motor whose lost steps a reading does not show, rad; None where no motor
        loses steps unseen, or its step is not known.
    """

    change_rad: FloatArray
    u_rad: FloatArray
    u_first_rad: float
    full_step_rad: float | None = None

    def until(self, last: int) -> Returns:
        """Return the returns up to one of them, itself included."""
        upto = slice(last + 1)
        return replace(self, change_rad=self.change_rad[upto], u_rad=self.u_rad[upto])


@dataclass(frozen=True)
class Control:
    """The charts of the returns, and what is wrong.

    Parameters
    ----------
    single
        Each return's change over its standard uncertainty.
    average
        The moving average.
    cause
        None where the charts are within their limits.
    """

    single: Chart
    average: Chart
    cause: Cause | None

    @property
    def outside(self) -> BoolArray:
        """At which returns a chart is outside its limits, shape (n,)."""
        found: BoolArray = self.single.outside | self.average.outside
        return found

    @property
    def first_alarm(self) -> int | None:
        """Index of the first of these; None if there is none."""
        return int(np.argmax(self.outside)) if self.outside.any() else None

    @property
    def last_alarm(self) -> int:
        """Index of the last return outside in one go with the first; -1 if there is none."""
        if self.first_alarm is None:
            return -1
        inside = np.flatnonzero(~self.outside[self.first_alarm :])
        return self.first_alarm + int(inside[0]) - 1 if len(inside) else len(self.outside) - 1


def control(returns: Returns) -> Control:
    """Return the charts of returns, of one at least, and the cause if one is outside."""
    zero = Reference(0.0, returns.u_first_rad)
    single = shewhart(standardised(returns.change_rad, returns.u_rad, zero))
    average = ewma(recursive_residuals(returns.change_rad, returns.u_rad, zero))
    found = Control(single, average, None)
    if found.first_alarm is None:
        return found
    return Control(single, average, _cause(returns.until(found.last_alarm)))


def lost_full_steps(returns: Returns) -> int:
    """Return how many full steps the last change is, within its uncertainty; 0 if it is none."""
    if returns.full_step_rad is None:
        return 0
    change, full = float(returns.change_rad[-1]), returns.full_step_rad
    steps = round(change / full)
    u = math.hypot(float(returns.u_rad[-1]), returns.u_first_rad)
    return steps if abs(change - steps * full) <= SHEWHART_LIMIT * u else 0


def _cause(returns: Returns) -> Cause:
    if lost_full_steps(returns):
        return "lost steps"
    drift, jump = _misfit_of_drift(returns), _misfit_of_jump(returns)
    if abs(drift - jump) < TELLING:
        return "change"
    return "drift" if drift < jump else "jump"


def _misfit_of_drift(returns: Returns) -> float:
    """Return chi-squared about the best line through the first row, in the order of returns."""
    at = np.arange(1.0, len(returns.change_rad) + 1)
    return _misfit(returns, at)


def _misfit_of_jump(returns: Returns) -> float:
    """Return chi-squared about the best single step, wherever it is."""
    count = len(returns.change_rad)
    return min(_misfit(returns, (np.arange(count) >= k).astype(float)) for k in range(count))


def _misfit(returns: Returns, shape: FloatArray) -> float:
    """Return chi-squared of the changes about the best multiple of a shape, (n,)."""
    u = np.diag(returns.u_rad**2) + returns.u_first_rad**2
    weight = np.linalg.inv(u)
    amount = shape @ weight @ returns.change_rad / (shape @ weight @ shape)
    left = returns.change_rad - amount * shape
    return float(left @ weight @ left)
