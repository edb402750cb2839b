"""A hypothesis tried on rows: what it makes of the fit, and the evidence for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.diagnosis.bases import Base, measured, prior_volume
from calib.diagnosis.hypotheses import HYPOTHESES, Hypothesis
from calib.diagnosis.refit import Added, Refit, Setting, corrected
from calib.diagnosis.small_prior import by_small_prior
from calib.diagnosis.trials import Distorted, Loaded, Mended, Periodic, Search, Trial, TwoSided
from calib.fit.noise import ROBUST, log_density
from calib.fit.start import find_start
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import INDEX, REFERENCE_OFFSET
from calib.rows.observations import Observations

REFITTED = 3
"""Places of a search that are refitted, the most promising by the score test."""

SIDES_ROUNDS = 8
"""Rounds in which rows of a two-sided error are allotted to their sides."""

LEAST_SIDES = 2.0
"""Half width of a two-sided error, in standard uncertainties of a row, from which it is seen."""

FAR_OFF = 2.0
"""Noise scale from which rows may be mirrored or in other units."""

AGREES = 2.5
"""Noise standard deviations within which rows must lie once they are exchanged back."""

LEAST_TWO_SIDED = 10
"""Rows from which two-sided errors are looked for: of fewer any two levels can be made."""

SHARE_STD = 3.0
"""Prior standard deviation of the size of a mistake that should have size 1."""

SHARE_TOLERANCE = 0.25
"""Of a mistake that has no size, how far the size found may be from 1."""

NORMAL_QUARTILE = 0.6745
"""Median size of a standard normal number."""

IMPLICIT_ROUNDS = 8
"""Rounds in which errors settle that depend on the true gaze."""

SETTLED = 1e-3
"""Change of the largest of them, relative, at which they have."""


@dataclass(frozen=True)
class BestTrial:
    """The best trial of a hypothesis.

    `gain` is its evidence, nats; `rival` that of an error which no hypothesis names and which is as
    free to choose its rows.
    """

    at: str | None
    refit: Refit
    loadings: FloatArray
    gain: float
    values: FloatArray
    covariance: FloatArray
    before: Refit
    ids: tuple[str, ...]
    is_carried: bool = False
    mended: Observations | None = None
    rival: float = 0.0

    @property
    def lead(self) -> float:
        """Evidence for it above that for its rival."""
        return self.gain - self.rival


def best_of(hypothesis: Hypothesis, base: Base) -> BestTrial | None:
    """Return the best trial of a hypothesis, with the evidence of all its places together."""
    if hypothesis.name == "reference-offset" and REFERENCE_OFFSET in base.setting.model.free:
        return None
    trials = hypothesis.trials(base.looked)
    places = sum(len(t.at) if isinstance(t, Search) else 1 for t in trials)
    if not places:
        return None
    if any(isinstance(t, Mended) and t.exchanged for t in trials):
        # Of all pairs of rows only those that disagree are looked at.
        places = len(base.looked.rows) * (len(base.looked.rows) - 1)
    penalty = float(np.log(len(HYPOTHESES)) + np.log(places))
    found = [outcome for trial in trials for outcome in _tried(trial, hypothesis, base)]
    if not found:
        return None
    # Each place is as probable as another: what they gain is averaged, those not refitted as 0.
    gain = float(np.logaddexp.reduce([outcome.gain for outcome in found])) - penalty
    return replace(max(found, key=lambda outcome: outcome.gain), gain=gain)


def _tried(trial: Trial, hypothesis: Hypothesis, base: Base) -> Iterator[BestTrial]:
    """Yield what comes of a trial, its places refitted where they are promising."""
    found: BestTrial | None
    match trial:
        case Search():
            yield from _searched(trial, hypothesis, base)
            return
        case Loaded(loadings=loadings):
            found = _loaded(loadings, _prior(hypothesis, loadings.shape[2]), base)
        case Periodic() | Distorted():
            found = _implicit(trial, hypothesis, base)
        case TwoSided(loadings=loadings, rival=rival, rival_std=std):
            found = _two_sided(loadings, _prior(hypothesis, 1), base)
            other = None if found is None else _two_sided(rival, np.full(1, std), base)
            if found is not None and other is not None:
                found = replace(found, rival=max(0.0, other.gain))
        case Mended():
            found = _mended(trial, base)
    if found is not None:
        yield found


def _searched(trial: Search, hypothesis: Hypothesis, base: Base) -> Iterator[BestTrial]:
    gains = base.linear.gains(trial.column, trial.patterns)
    for place in np.argsort(-gains, kind="stable")[:REFITTED]:
        loadings = trial.loadings(int(place))
        found = _loaded(loadings, _prior(hypothesis, loadings.shape[2]), base)
        if found is not None:
            yield replace(found, at=trial.at[place])


def _prior(hypothesis: Hypothesis, count: int) -> FloatArray:
    return np.full(count, hypothesis.typical * hypothesis.per_unit)


def _loaded(
    loadings: FloatArray, prior_std: FloatArray, base: Base, start: FloatArray | None = None
) -> BestTrial | None:
    extra = Added(loadings, prior_std)
    found = base.setting.refit(base.refit.theta, base.refit.scale, extra, start)
    if found is None:
        return None
    refit = found[0]
    gain = base.gain(refit) + by_small_prior(
        refit, loadings, extra.prior_std, base.linear, base.refit.scale
    )
    return BestTrial(
        None, refit, loadings, gain, refit.added, refit.covariance, base.refit, base.looked.rows.ids
    )


def _implicit(trial: Periodic | Distorted, hypothesis: Hypothesis, base: Base) -> BestTrial | None:
    """Return the fit of errors that depend on the true gaze, which they are taken off to get."""
    rows = base.looked.rows
    loadings, best = trial.loadings(rows.gaze), None
    for _ in range(IMPLICIT_ROUNDS):
        found = _loaded(loadings, _prior(hypothesis, loadings.shape[2]), base)
        if found is None:
            break
        if best is None or found.gain > best.gain:
            best = found
        before, loadings = loadings, trial.loadings(corrected(rows, loadings, found.values)[0])
        if np.abs(loadings - before).max() < SETTLED * np.abs(loadings).max():
            break
    return best


def _two_sided(loadings: FloatArray, prior_std: FloatArray, base: Base) -> BestTrial | None:
    """Return the fit with each row on the side where it fits better.

    The evidence counts both sides of each row: nobody said on which it is.
    """
    if len(loadings) < LEAST_TWO_SIDED:
        return None
    push = np.einsum("nq,nqk->n", base.linear.by_observable, loadings)
    side, found, half = base.linear.sides(push), None, push
    for _ in range(SIDES_ROUNDS):
        found = _loaded(loadings * side[:, None, None], prior_std, base)
        if found is None:
            return None
        half = push * found.values[0]
        middle = found.refit.standardised + side * half
        now = np.where(np.abs(middle - half) <= np.abs(middle + half), 1.0, -1.0)
        if np.array_equal(now, side):
            break
        side = now
    if found is None or np.median(np.abs(half)) < LEAST_SIDES * max(1.0, found.refit.scale):
        return None
    r, log_scale = found.refit.standardised, float(np.log(found.refit.scale))
    here = log_density(r, log_scale, ROBUST)
    other = log_density(r + 2 * side * half, log_scale, ROBUST)
    loss = float((np.logaddexp(here, other) - np.log(2) - here).sum())
    # Which side is called the upper one is arbitrary: the one with which the size is positive.
    sign = 1.0 if found.values[0] >= 0 else -1.0
    return replace(
        found, gain=found.gain + loss, values=sign * found.values, loadings=sign * found.loadings
    )


def _mended(trial: Mended, base: Base) -> BestTrial | None:
    if trial.exchanged and not _agree_better(trial, base):
        return None
    start = _start(trial, base)
    if start is None:
        return None
    setting, theta, scale = start
    found = setting.refit(theta, scale, Added.none(len(trial.rows)))
    if found is None or (trial.exchanged and not _agree(trial, found[0])):
        return None
    refit = found[0]
    none = Added.none(len(trial.rows)).loadings
    mended = BestTrial(
        at=trial.at,
        refit=refit,
        loadings=none,
        gain=base.gain(refit),
        values=np.zeros(0),
        covariance=np.zeros((0, 0)),
        before=base.refit,
        ids=base.looked.rows.ids,
        mended=trial.rows,
    )
    return mended if trial.share is None else _sized(trial.share, mended, base)


def _start(trial: Mended, base: Base) -> tuple[Setting, FloatArray, float] | None:
    """Return the setting of mended rows, with parameters and noise scale to set out from."""
    setting, theta, scale = base.setting, base.refit.theta, base.refit.scale
    if not trial.anew:
        return replace(setting, rows=trial.rows), theta, scale
    if scale < FAR_OFF:
        return None
    try:
        theta = find_start(trial.rows, axis_z="axis_z_mm" in setting.model.free)
    except EstimationError:
        return None
    anew = Setting.of(trial.rows, setting.stated, setting.model, setting.priors, theta)
    missed = misclosure_value(theta, trial.rows.gaze, trial.rows.z_mm) / anew.unit[0]
    return anew, theta, float(np.median(np.abs(missed))) / NORMAL_QUARTILE


def _sized(share: FloatArray, mended: BestTrial, base: Base) -> BestTrial | None:
    """Return what was mended with the size that the rows give the mistake; None if not near 1."""
    extra = Added(share, np.full(1, SHARE_STD))
    found = base.setting.refit(mended.refit.theta, mended.refit.scale, extra, np.ones(1))
    if found is None:
        return None
    size, covariance = found[0].added, found[0].covariance
    if abs(float(size[0]) - 1) > max(SHARE_TOLERANCE, 3 * float(np.sqrt(covariance[0, 0]))):
        return None
    return replace(mended, values=size, covariance=covariance)


def _agree(trial: Mended, refit: Refit) -> bool:
    """Whether rows that may have been exchanged are no outliers as mended."""
    left = np.abs(refit.standardised[list(trial.exchanged)])
    return bool(np.all(left < AGREES * refit.scale))


def _agree_better(trial: Mended, base: Base) -> bool:
    """Whether rows that may have been exchanged both agree better with the fit as mended."""
    pair = list(trial.exchanged)
    rows = trial.rows.take(np.array(pair))
    after = misclosure_value(base.refit.theta, rows.gaze, rows.z_mm)
    return bool(
        np.all(np.abs(after / base.setting.unit[0, pair]) < np.abs(base.refit.standardised[pair]))
    )


def carried_offset(bases: tuple[Base, ...]) -> BestTrial | None:
    """Return the evidence for the offset that the models have as a parameter."""
    without: list[tuple[float, Refit]] = []
    for base in bases:
        model = base.setting.model
        less = replace(model, free=tuple(n for n in model.free if n != REFERENCE_OFFSET))
        found = replace(base.setting, model=less).refit(
            measured(base.refit.theta), base.refit.scale, Added.none(len(base.looked.rows))
        )
        if found is not None:
            without.append((found[0].evidence + base.volume, found[0]))
    if not without:
        return None
    best = max(bases, key=lambda base: base.gain(base.refit))
    model = best.setting.model
    evidence, refit = max(without, key=lambda pair: pair[0])
    gain = best.refit.evidence + best.volume - evidence - float(np.log(len(HYPOTHESES)))
    gain += prior_volume(best.setting.priors, model, (REFERENCE_OFFSET,))
    place = model.free.index(REFERENCE_OFFSET)
    value = best.refit.theta[[INDEX[REFERENCE_OFFSET]]]
    covariance = best.linear.covariance[place : place + 1, place : place + 1]
    none = Added.none(len(best.looked.rows)).loadings
    return BestTrial(
        None,
        best.refit,
        none,
        gain,
        value,
        covariance,
        refit,
        best.looked.rows.ids,
        is_carried=True,
    )
