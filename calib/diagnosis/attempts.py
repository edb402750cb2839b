"""A hypothesis tried on rows: what it makes of the fit, and the evidence for it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.diagnosis.hypotheses import HYPOTHESES, Hypothesis
from calib.diagnosis.refit import Added, Linear, Refit, Setting, stated_errors
from calib.diagnosis.session import Session
from calib.diagnosis.small_prior import by_small_prior
from calib.diagnosis.trials import Loaded, Looked, Mended, Periodic, Search, Trial, TwoSided
from calib.fit.noise import ROBUST, log_density
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.robust import LEFT_TO_PRIOR, RobustFit, fit_robust, too_much
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import INDEX, MODELS, REFERENCE_OFFSET, Model, model_for
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations

REFITTED = 3
"""Places of a search that are refitted, the most promising by the score test."""

LEAST_FREEDOM = 1.0
"""Degrees of freedom that must be left to the noise beside a hypothesis."""

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

PHASE_ROUNDS = 4
"""Rounds in which the phase of a periodic error settles."""

WIDER = 5.0
"""Factor by which priors of the manifest may be too narrow."""

RICHER = "axis-offset"
"""Model with which hypotheses are tried beside the selected one."""


@dataclass(frozen=True)
class Outcome:
    """The best trial of a hypothesis."""

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


@dataclass(frozen=True)
class Base:
    """The rows as a model has them without any hypothesis.

    Parameters
    ----------
    volume
        Logarithm of the greatest prior density of the parameters that the model has beyond those
        of the selected one.
    reference
        Evidence of the best model, volume included: what a hypothesis has to beat.
    """

    setting: Setting
    looked: Looked
    refit: Refit
    linear: Linear
    volume: float
    reference: float

    def gain(self, refit: Refit) -> float:
        """Return the evidence for a refit of this model, nats."""
        return refit.evidence + self.volume - self.reference

    def is_free_enough(self) -> bool:
        """Whether the rows can carry one more parameter."""
        told = [name for name in self.setting.model.free if name not in LEFT_TO_PRIOR]
        return len(self.looked.rows) - len(told) > LEAST_FREEDOM


def measured(theta: FloatArray) -> FloatArray:
    """Return the parameters that a measured depth has."""
    theta = theta.copy()
    theta[INDEX[REFERENCE_OFFSET]] = 0.0
    return theta


def bases(rows: Observations, session: Session, priors: Priors, fit: RobustFit) -> tuple[Base, ...]:
    """Return the rows as the selected model has them, and as the next richer one does.

    A mistake may have led the selection astray, and some are told by a richer model only.
    """
    own, stated = stated_errors(rows)
    setting = Setting.of(own, stated, fit.structure, priors, fit.theta)
    found: list[Base] = []
    for model in _models(rows, fit):
        result = replace(setting, model=model).refit(
            fit.theta, fit.noise_scale, Added.none(len(rows))
        )
        if result is None:
            continue
        refit, linear = result
        volume = _prior_volume(priors, model, set(model.free) - set(fit.names))
        looked = Looked(own, session, refit.standardised)
        found.append(Base(replace(setting, model=model), looked, refit, linear, volume, np.nan))
    if not found or found[0].setting.model.free != fit.names:
        return ()
    reference = max(base.refit.evidence + base.volume for base in found)
    reference = max(reference, *(_with_wide_priors(base, fit) for base in found))
    told = [base for base in found if base.setting.model.name in (fit.model, RICHER)]
    return tuple(replace(base, reference=reference) for base in told)


def _with_wide_priors(base: Base, fit: RobustFit) -> float:
    """Return the evidence of a model with the priors of the manifest too narrow, nats.

    It is no mistake of the rows if priors were stated too narrow: what they then push into a
    hypothesis is no evidence for it. Each wider prior costs the logarithm of its factor.
    """
    setting = base.setting
    wide = {
        name: (mean, WIDER * std)
        for name, (mean, std) in setting.priors.stated.items()
        if name in setting.model.free and name != REFERENCE_OFFSET
    }
    if not wide:
        return -np.inf
    priors = replace(setting.priors, stated={**setting.priors.stated, **wide})
    found = replace(setting, priors=priors).refit(
        base.refit.theta, base.refit.scale, Added.none(len(setting.rows))
    )
    if found is None:
        return -np.inf
    volume = _prior_volume(priors, setting.model, set(setting.model.free) - set(fit.names))
    cost = sum(np.log(WIDER) for name in wide if name in fit.names)
    return found[0].evidence + volume - float(cost) - float(np.log(len(HYPOTHESES)))


def _models(rows: Observations, fit: RobustFit) -> list[Model]:
    """Return the model of the fit and those with more parameters that rows can carry."""
    found = [fit.structure]
    for name in MODELS:
        model = model_for(
            name, off_centre=rows.off_centre, offset_open=REFERENCE_OFFSET in fit.names
        )
        if set(model.free) > set(fit.names) and too_much(rows, model) is None:
            found.append(model)
    return found


def _prior_volume(priors: Priors, model: Model, names: Iterable[str]) -> float:
    """Return the logarithm of the greatest prior density of some parameters of a model."""
    known = prior_of(model, priors) + measured_of(model, priors)
    some = [model.free.index(name) for name in names]
    return float(0.5 * np.log(np.diag(known.precision)[some] / (2 * np.pi)).sum())


def best_of(hypothesis: Hypothesis, base: Base) -> Outcome | None:
    """Return the trial of a hypothesis that has the greatest evidence."""
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
    best: Outcome | None = None
    for trial in trials:
        for found in _tried(trial, hypothesis, base):
            if best is None or found.gain > best.gain:
                best = found
    return None if best is None else replace(best, gain=best.gain - penalty)


def _tried(trial: Trial, hypothesis: Hypothesis, base: Base) -> Iterator[Outcome]:
    """Yield what comes of a trial, its places refitted where they are promising."""
    found: Outcome | None
    match trial:
        case Search():
            yield from _searched(trial, hypothesis, base)
            return
        case Loaded(loadings=loadings):
            found = _loaded(loadings, hypothesis, base)
        case Periodic():
            found = _periodic(trial, hypothesis, base)
        case TwoSided(loadings=loadings):
            found = _two_sided(loadings, hypothesis, base)
        case Mended():
            found = _mended(trial, base)
    if found is not None:
        yield found


def _searched(trial: Search, hypothesis: Hypothesis, base: Base) -> Iterator[Outcome]:
    gains = base.linear.gains(trial.column, trial.patterns)
    for place in np.argsort(-gains, kind="stable")[:REFITTED]:
        found = _loaded(trial.loadings(int(place)), hypothesis, base)
        if found is not None:
            yield replace(found, at=trial.at[place])


def _prior(hypothesis: Hypothesis, count: int) -> FloatArray:
    return np.full(count, hypothesis.typical * hypothesis.per_unit)


def _loaded(
    loadings: FloatArray, hypothesis: Hypothesis, base: Base, start: FloatArray | None = None
) -> Outcome | None:
    extra = Added(loadings, _prior(hypothesis, loadings.shape[2]))
    found = base.setting.refit(base.refit.theta, base.refit.scale, extra, start)
    if found is None:
        return None
    refit = found[0]
    gain = base.gain(refit) + by_small_prior(
        refit, loadings, extra.prior_std, base.linear, base.refit.scale
    )
    return Outcome(
        None, refit, loadings, gain, refit.added, refit.covariance, base.refit, base.looked.rows.ids
    )


def _periodic(trial: Periodic, hypothesis: Hypothesis, base: Base) -> Outcome | None:
    """Return the fit of errors that repeat with the true angle, which they are taken off to get."""
    alpha = base.looked.rows.alpha2_rad
    loadings, best = trial.loadings(alpha), None
    for _ in range(PHASE_ROUNDS):
        found = _loaded(loadings, hypothesis, base)
        if found is None:
            break
        if best is None or found.gain > best.gain:
            best = found
        error = loadings[:, OBSERVABLE.alpha2] @ found.values
        loadings = trial.loadings(alpha - error)
    return best


def _two_sided(loadings: FloatArray, hypothesis: Hypothesis, base: Base) -> Outcome | None:
    """Return the fit with each row on the side where it fits better.

    The evidence counts both sides of each row: nobody said on which it is.
    """
    if len(loadings) < LEAST_TWO_SIDED:
        return None
    push = np.einsum("nq,nqk->n", base.linear.by_observable, loadings)
    side, found, half = base.linear.sides(push), None, push
    for _ in range(SIDES_ROUNDS):
        found = _loaded(loadings * side[:, None, None], hypothesis, base)
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
    return replace(found, gain=found.gain + loss, values=np.abs(found.values))


def _mended(trial: Mended, base: Base) -> Outcome | None:
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
    mended = Outcome(
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
        fit = fit_robust(trial.rows, setting.model, setting.priors)
    except EstimationError:
        return None
    theta = fit.theta
    anew = Setting.of(trial.rows, setting.stated, setting.model, setting.priors, theta)
    return anew, theta, fit.noise_scale


def _sized(share: FloatArray, mended: Outcome, base: Base) -> Outcome | None:
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


def carried_offset(bases: tuple[Base, ...]) -> Outcome | None:
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
    gain += _prior_volume(best.setting.priors, model, (REFERENCE_OFFSET,))
    place = model.free.index(REFERENCE_OFFSET)
    value = best.refit.theta[[INDEX[REFERENCE_OFFSET]]]
    covariance = best.linear.covariance[place : place + 1, place : place + 1]
    none = Added.none(len(best.looked.rows)).loadings
    return Outcome(
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
