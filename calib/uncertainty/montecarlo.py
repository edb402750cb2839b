"""Propagation of distributions by the adaptive Monte Carlo procedure of JCGM 101 (clause 7.9).

Trials are drawn in blocks until the estimate, its standard uncertainty and both ends of the 95 %
interval are known within the numerical tolerance that belongs to the digits printed. The result
then judges the linear one (clause 8): where the linear interval's ends differ from these by more
than that tolerance, the linear result may not be used.

Draws from a posterior are finite in number. They are handed out in parts, each block drawing from
one part only, so that the scatter between parts shows how far the number of posterior draws, and
not that of the trials, limits the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.uncertainty.budget import COVERAGE
from calib.uncertainty.distributions import PARTS, GivenInputs, Inputs, StudentInputs, draw

BLOCK_TRIALS = 10_000
"""Trials of a block: the larger of 10^4 and 100 / (1 - p) (7.9.4 b)."""

MINIMUM_BLOCKS = 10
"""The standard may stop at two blocks, whose scatter is too uncertain itself to be trusted
(Wübbeler et al. 2010, Metrologia 47, 317, doi 10.1088/0026-1394/47/3/023)."""

MAXIMUM_TRIALS = 3_000_000
"""Bounds time and memory; a result that has not settled by then says so."""

DECIDED = 0.2
"""Share of the tolerance within which the ends must be known for a close verdict (clause 8.2)."""

CLEAR = 1.5
"""A verdict is clear where the ends' doubt times this does not change it: the ends of all trials
together differ a little from the mean ends of the blocks."""

SLIGHT = 0.3
"""More trials are of no use where they are responsible for less than this share of the doubt; the
rest is the fault of too few given draws."""

NORMAL_FACTOR = 1.959963984540054
"""97.5 % quantile of the standard normal distribution."""

FLAT = 0.005
"""Intervals this much wider than the narrowest, relatively, take part in finding the shortest."""


Measure: TypeAlias = Callable[[FloatArray], FloatArray]
"""From inputs, shape (m, k), to results, shape (m,)."""


@dataclass(frozen=True)
class Interval:
    """A coverage interval, in the unit of the result."""

    low: float
    high: float


@dataclass(frozen=True)
class MonteCarlo:
    """Summary of the distribution of a result.

    Parameters
    ----------
    estimate, standard_uncertainty
        Mean and standard deviation; None where the distribution has none.
    symmetric
        95 % interval with 2.5 % on either side.
    shortest
        The shortest 95 % interval.
    trials
        Number of trials.
    tolerance
        Numerical tolerance delta (7.9.2) that belongs to `digits` digits of the uncertainty.
    numerical_estimate, numerical_uncertainty, numerical_low, numerical_high
        Twice the standard deviation of the mean, of the standard uncertainty and of the ends of the
        symmetric interval: how far they may be off for want of trials and of given draws.
    stable
        Whether the number of trials sufficed: their part of the four above is within `tolerance`,
        or so small that only more given draws would help.
    limited_by_draws
        Whether given draws are too few to reach the tolerance.
    """

    estimate: float | None
    standard_uncertainty: float | None
    symmetric: Interval
    shortest: Interval
    trials: int
    tolerance: float
    numerical_estimate: float
    numerical_uncertainty: float
    numerical_low: float
    numerical_high: float
    stable: bool
    limited_by_draws: bool


@dataclass(frozen=True)
class MonteCarloValidation:
    """Verdict on the linear result (JCGM 101, clause 8).

    Parameters
    ----------
    linear
        y ± k u.
    coverage_factor
        k.
    difference_low, difference_high
        Distances of its ends from those of the symmetric Monte Carlo interval.
    tolerance
        What they may be.
    validated
        Whether both are within `tolerance`, their own numerical uncertainty considered.
    """

    linear: Interval
    coverage_factor: float
    difference_low: float
    difference_high: float
    tolerance: float
    validated: bool


def numerical_tolerance(standard_uncertainty: float, *, digits: int) -> float:
    """Return half a unit in the last of `digits` significant digits (JCGM 101, 7.9.2)."""
    exponent = int(f"{standard_uncertainty:.{digits - 1}e}".split("e")[1])
    return float(0.5 * 10.0 ** (exponent - digits + 1))


class Results:
    """Results of one quantity, block by block, until their summary is numerically stable (7.9.4).

    Parameters
    ----------
    inputs
        The independent blocks of inputs that the results come from; block i of results draws from
        part i of given draws.
    digits
        Significant digits of the uncertainty that are to be right.
    linear
        An interval to be judged by clause 8; trials go on until the verdict is clear.
    maximum_trials
        A bound; beyond it the summary says that it is not stable.
    """

    def __init__(
        self,
        inputs: Sequence[Inputs],
        *,
        digits: int = 2,
        linear: Interval | None = None,
        maximum_trials: int = MAXIMUM_TRIALS,
    ) -> None:
        given = any(isinstance(block, GivenInputs) for block in inputs)
        self._parts = PARTS if given else 1
        self._finite_std = not any(
            isinstance(block, StudentInputs) and block.degrees_of_freedom <= 2 for block in inputs
        )
        self._digits, self._linear = digits, linear
        self._fewest = max(MINIMUM_BLOCKS, 2 * PARTS if given else 0)
        self._most = max(maximum_trials // BLOCK_TRIALS, self._fewest)
        self._blocks: list[FloatArray] = []
        self._ledger: list[tuple[float, float, float, float]] = []

    def add(self, values: FloatArray) -> None:
        """Take the results of one more block, shape (BLOCK_TRIALS,).

        Raises
        ------
        EstimationError
            If so many have no finite result that the interval has no end.
        """
        ordered = np.sort(values)
        self._blocks.append(ordered)
        self._ledger.append(_statistics(ordered, finite_std=self._finite_std))

    @property
    def settled(self) -> bool:
        """Whether no more trials are needed, or allowed."""
        count = len(self._blocks)
        if count < self._fewest:
            return False
        return count >= self._most or self._numerics.settled(self._linear)

    @property
    def _numerics(self) -> _Numerics:
        return _Numerics.of(self._ledger, self._parts, self._digits)

    def draws(self) -> Draws:
        """Return all results so far."""
        return Draws(np.sort(np.concatenate(self._blocks)), self._numerics, self._finite_std)


def propagate(
    measure: Measure,
    inputs: Sequence[Inputs],
    rng: np.random.Generator,
    *,
    digits: int = 2,
    linear: Interval | None = None,
    maximum_trials: int = MAXIMUM_TRIALS,
) -> Draws:
    """Draw results until their summary is numerically stable.

    Parameters
    ----------
    measure
        The measurement model on the columns of all `inputs` side by side. It may return infinity
        for a draw without a result.
    inputs
        Mutually independent blocks.
    rng
        Equal generators give equal results.
    digits, linear, maximum_trials
        As in `Results`.

    Raises
    ------
    EstimationError
        If so many draws have no finite result that the interval has no end.
    """
    results = Results(inputs, digits=digits, linear=linear, maximum_trials=maximum_trials)
    number = 0
    while not results.settled:
        drawn = [draw(block, rng, BLOCK_TRIALS, part=number) for block in inputs]
        results.add(measure(np.hstack(drawn)))
        number += 1
    return results.draws()


def _statistics(values: FloatArray, *, finite_std: bool) -> tuple[float, float, float, float]:
    """Return mean, standard deviation, low and high end of the symmetric interval of a block."""
    interval = _symmetric(values)
    if not math.isfinite(interval.high) or not math.isfinite(interval.low):
        raise EstimationError(
            "the 95 % interval has no end: in too many Monte Carlo trials the ray does not meet "
            "the gaze plane; ask for a smaller depth, or calibrate with more or better rows"
        )
    if finite_std and math.isfinite(float(values[-1])):
        return float(values.mean()), float(values.std(ddof=1)), interval.low, interval.high
    # Without moments, the median and the interval's width speak for them.
    spread = (interval.high - interval.low) / (2 * NORMAL_FACTOR)
    return float(values[len(values) // 2]), spread, interval.low, interval.high


@dataclass(frozen=True)
class _Numerics:
    """Means over blocks and their standard deviations, order as in `_statistics`."""

    mean: FloatArray
    by_trials: FloatArray
    total: FloatArray
    tolerance: float

    @classmethod
    def of(
        cls, ledger: Sequence[tuple[float, float, float, float]], parts: int, digits: int
    ) -> _Numerics:
        table = np.array(ledger)
        count = len(table)
        part = np.arange(count) % parts
        centres = np.array([table[part == k].mean(axis=0) for k in range(parts)])
        within = ((table - centres[part]) ** 2).sum(axis=0) / (count - parts)
        by_trials = np.sqrt(within / count)
        total = centres.std(axis=0, ddof=1) / math.sqrt(parts) if parts > 1 else by_trials
        spread = math.sqrt(float(np.mean(table[:, 1] ** 2) + np.var(table[:, 0])))
        return cls(
            mean=table.mean(axis=0),
            by_trials=by_trials,
            total=np.maximum(by_trials, total),
            tolerance=numerical_tolerance(spread, digits=digits),
        )

    @property
    def stable(self) -> bool:
        enough = np.maximum(self.tolerance, 2 * SLIGHT * self.total)
        return bool(np.all(2 * self.by_trials <= enough))

    def settled(self, linear: Interval | None) -> bool:
        """Whether trials may end."""
        if not self.stable or linear is None:
            return self.stable
        doubt = CLEAR * 2 * self.by_trials[2:]
        away = np.abs(np.array([linear.low, linear.high]) - self.mean[2:])
        agree = bool(np.all(away + doubt <= self.tolerance))
        differ = bool(np.any(away - doubt > self.tolerance))
        return agree or differ or bool(np.all(doubt <= CLEAR * DECIDED * self.tolerance))


@dataclass(frozen=True)
class Draws:
    """The sorted results of all trials, shape (m,), with what is known of their numerical error."""

    values: FloatArray
    numerics: _Numerics
    finite_std: bool

    def share_within(self, low: float, high: float) -> float:
        """Return the share of trials in [low, high]: a probability."""
        first = np.searchsorted(self.values, low, side="left")
        last = np.searchsorted(self.values, high, side="right")
        return float(last - first) / len(self.values)

    def summary(self) -> MonteCarlo:
        """Return the summary of the distribution."""
        moments = self.finite_std and math.isfinite(float(self.values[-1]))
        doubt = 2 * self.numerics.total
        return MonteCarlo(
            estimate=float(self.values.mean()) if moments else None,
            standard_uncertainty=float(self.values.std(ddof=1)) if moments else None,
            symmetric=_symmetric(self.values),
            shortest=shortest_interval(self.values),
            trials=len(self.values),
            tolerance=self.numerics.tolerance,
            numerical_estimate=float(doubt[0]),
            numerical_uncertainty=float(doubt[1]),
            numerical_low=float(doubt[2]),
            numerical_high=float(doubt[3]),
            stable=self.numerics.stable,
            limited_by_draws=bool(np.any(doubt > self.numerics.tolerance)) and self.numerics.stable,
        )


def _covered(count: int) -> int:
    """Return the number of trials inside a 95 % interval (7.7.2)."""
    return int(COVERAGE * count + 0.5)


def _symmetric(ordered: FloatArray) -> Interval:
    """Return the probabilistically symmetric 95 % interval of sorted values (7.7.2)."""
    inside = _covered(len(ordered))
    first = int((len(ordered) - inside) / 2 + 0.5)
    return Interval(float(ordered[first - 1]), float(ordered[first - 1 + inside]))


def shortest_interval(ordered: FloatArray) -> Interval:
    """Return the shortest 95 % interval of sorted values (7.7.4).

    The width hardly changes about its minimum, so that the place of the narrowest interval found
    wanders far with the sample. A parabola through the widths about it finds the place several
    times more surely; the interval there still holds 95 % of the trials.
    """
    inside = _covered(len(ordered))
    low = ordered[: len(ordered) - inside]
    high = ordered[inside:]
    with np.errstate(invalid="ignore"):
        width = np.where(np.isfinite(high), high - low, np.inf)
    best = int(np.argmin(width))
    near = np.flatnonzero(width <= (1 + FLAT) * width[best])
    first, last = int(near[0]), int(near[-1])
    if last - first >= 8:
        place = np.unique(np.linspace(first, last, 500).astype(int))
        finite = np.isfinite(width[place])
        offset = (place[finite] - best) / (last - first)
        bend, slope, _ = np.polyfit(offset, width[place][finite], 2)
        if bend > 0:
            best = int(np.clip(best - (last - first) * slope / (2 * bend), first, last))
    return Interval(float(low[best]), float(high[best]))


def validate(
    result: MonteCarlo, *, estimate: float, standard_uncertainty: float, coverage_factor: float
) -> MonteCarloValidation:
    """Return whether y ± k u may stand for the distribution (JCGM 101, clause 8)."""
    half = coverage_factor * standard_uncertainty
    linear = Interval(estimate - half, estimate + half)
    away = (abs(linear.low - result.symmetric.low), abs(linear.high - result.symmetric.high))
    doubt = (result.numerical_low, result.numerical_high)
    known = max(doubt) <= DECIDED * result.tolerance
    margin = (0.0, 0.0) if known else doubt
    return MonteCarloValidation(
        linear=linear,
        coverage_factor=coverage_factor,
        difference_low=away[0],
        difference_high=away[1],
        tolerance=result.tolerance,
        validated=all(d + m <= result.tolerance for d, m in zip(away, margin, strict=True)),
    )
