"""Rows as models have them without any mistake: what a hypothesis sets out from and has to beat."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.refit import Added, Linear, Refit, Setting, stated_errors
from calib.diagnosis.session import HistoryArrays
from calib.diagnosis.trials import Looked
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.robust import LEFT_TO_PRIOR, RobustFit, too_much
from calib.geometry.parameters import INDEX, MODELS, REFERENCE_OFFSET, Model, model_for
from calib.rows.observations import Observations

LEAST_FREEDOM = 1.0
"""Degrees of freedom that must be left to the noise beside a hypothesis."""

WIDER = 5.0
"""Factor by which priors of the manifest may be too narrow."""

USUAL = "axis-offset"
"""Model with which hypotheses are tried beside the selected one."""


@dataclass(frozen=True)
class Base:
    """The rows as a model has them without any hypothesis.

    Parameters
    ----------
    volume
        Logarithm of the greatest prior density of the parameters that the model has beyond those
        of `base`, which all models have.
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


def bases(
    rows: Observations,
    session: HistoryArrays,
    priors: Priors,
    fit: RobustFit,
    known: Added | None = None,
) -> tuple[Base, ...]:
    """Return the rows as the selected model has them, and as the usual one does.

    A mistake may have led the selection astray: to a model without the parameters beside which it
    shows, or to one with parameters that follow it. Other models that contain one of the two are
    what a hypothesis has to beat as well.

    Parameters
    ----------
    known
        Errors of the rows that are allowed for, as parameters.
    """
    found = _all(_models(rows, fit), rows, session, priors, fit, known)
    if not found or found[0].setting.model.free != fit.names:
        return ()
    reference = max(base.refit.evidence + base.volume for base in found)
    reference = max(reference, *(_with_wide_priors(base, rows, fit) for base in found))
    told = [base for base in found if base.setting.model.name in (fit.model, USUAL)]
    return tuple(replace(base, reference=reference) for base in told)


def most_evident(rows: Observations, session: HistoryArrays, priors: Priors, fit: RobustFit) -> str:
    """Return the name of the model with the greatest evidence, of those that rows can carry."""
    models = [_model(name, rows, fit) for name in MODELS]
    some = [model for model in models if not too_much(rows, model)]
    found = _all(some, rows, session, priors, fit, None)
    if not found:
        return fit.model
    return max(found, key=lambda base: base.refit.evidence + base.volume).setting.model.name


def _all(
    models: Iterable[Model],
    rows: Observations,
    session: HistoryArrays,
    priors: Priors,
    fit: RobustFit,
    known: Added | None,
) -> list[Base]:
    """Return the rows as each of some models has them."""
    own, stated = stated_errors(rows)
    if known is not None:
        stated += known
    setting = Setting.of(own, stated, fit.structure, priors, fit.theta)
    found: list[Base] = []
    for model in models:
        result = replace(setting, model=model).refit(
            fit.theta, fit.noise_scale, Added.none(len(rows))
        )
        if result is None:
            continue
        refit, linear = result
        volume = prior_volume(priors, model, _beyond(model, rows, fit))
        looked = Looked(own, session, refit.standardised)
        found.append(Base(replace(setting, model=model), looked, refit, linear, volume, np.nan))
    return found


def _model(name: str, rows: Observations, fit: RobustFit) -> Model:
    return model_for(name, off_centre=rows.off_centre, offset_open=REFERENCE_OFFSET in fit.names)


def _beyond(model: Model, rows: Observations, fit: RobustFit) -> set[str]:
    """Return the parameters of a model that not all models have."""
    return set(model.free) - set(_model("base", rows, fit).free)


def _with_wide_priors(base: Base, rows: Observations, fit: RobustFit) -> float:
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
    beyond = _beyond(setting.model, rows, fit)
    volume = prior_volume(priors, setting.model, beyond)
    cost = sum(np.log(WIDER) for name in wide if name not in beyond)
    return found[0].evidence + volume - float(cost) - float(np.log(len(HYPOTHESES)))


def _models(rows: Observations, fit: RobustFit) -> list[Model]:
    """Return the model of the fit, then the usual one, and those that contain one of them."""
    usual = _model(USUAL, rows, fit)
    found = [fit.structure]
    for model in (usual, *(_model(name, rows, fit) for name in MODELS)):
        contains = set(model.free) > set(fit.names) or set(model.free) >= set(usual.free)
        if contains and model.free not in [m.free for m in found] and not too_much(rows, model):
            found.append(model)
    return found


def prior_volume(priors: Priors, model: Model, names: Iterable[str]) -> float:
    """Return the logarithm of the greatest prior density of some parameters of a model."""
    known = prior_of(model, priors) + measured_of(model, priors)
    some = [model.free.index(name) for name in names]
    return float(0.5 * np.log(np.diag(known.precision)[some] / (2 * np.pi)).sum())
