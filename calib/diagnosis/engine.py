"""Stage: each hypothesis tried on the rows, and the decisive ones named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.attempts import Base, Outcome, bases, best_of, carried_offset, measured
from calib.diagnosis.hypotheses import HYPOTHESES, Hypothesis
from calib.diagnosis.refit import corrected
from calib.diagnosis.session import RowHistory, Session
from calib.diagnosis.structure import (
    Stretched,
    Structure,
    residual_structure,
    stretched_priors,
)
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.geometry.plane import Gaze, depth
from calib.instrument.calibrated import DepthTable
from calib.rows.observations import Observations

MOST_ROWS = 1000
"""Rows looked at: of a longer table so many, evenly; they tell any cause worth naming."""

DECISIVE = 2.0
"""Evidence from which a cause is named, in nats, all penalties paid."""

MATTERS = 1.0
"""Effect on a depth, in its standard uncertainties, from which a cause may not be left out."""

AS_GOOD = 3.0
"""Causes whose evidence is within so many nats of the best are named with it."""

_OF_OUTLIERS = ("rows-exchanged", "unit", "group-reference")
"""Hypotheses about rows that the fit rejects."""


SeenIn = Literal["rows", "references"]


@dataclass(frozen=True)
class Attempt:
    """A hypothesis as the rows have it.

    Parameters
    ----------
    name
        Of `HYPOTHESES`.
    at
        Where it struck; None where it has no place.
    estimate, std
        Its parameter and the standard uncertainty of it, in the hypothesis' unit; NaN where it has
        none.
    gain
        Evidence for it, nats: the gain in the logarithm of the marginal likelihood, less penalties
        for hypotheses and places tried.
    seen_in
        Where the evidence is from: calibration "rows", or independent "references".
    """

    name: str
    at: str | None
    estimate: float
    std: float
    gain: float
    seen_in: SeenIn = "rows"

    @property
    def hypothesis(self) -> Hypothesis:
        """Its entry in the table."""
        return HYPOTHESES[self.name]

    @property
    def text(self) -> str:
        """What it says, with its figures."""
        value = f"{self.estimate:.3g} +- {self.std:.2g} {self.hypothesis.unit}".removesuffix(" 1")
        by_rows, by_references = self.hypothesis.text, self.hypothesis.by_references
        text = by_rows if self.seen_in == "rows" else by_references
        return text.format(value=value, at=self.at)


@dataclass(frozen=True, kw_only=True)
class Cause(Attempt):
    """A hypothesis that the rows speak for.

    Parameters
    ----------
    noise_scale
        Without and with it.
    effect
        Largest change of a depth by it, over the depth's standard uncertainty.
    is_carried
        Whether the model has it as a parameter anyway, so that nothing is left out.
    ids
        Rows looked at.
    residual_mrad
        Theirs, without and with it, shape (2, n).
    """

    noise_scale: tuple[float, float]
    effect: float
    is_carried: bool
    ids: tuple[str, ...]
    residual_mrad: FloatArray

    @property
    def text(self) -> str:
        """What it says, with its figures."""
        return f"{super().text}; the model allows for it" if self.is_carried else super().text


@dataclass(frozen=True)
class Diagnosis:
    """What explains the rows better than the model alone.

    Parameters
    ----------
    model
        Model of the fit that was diagnosed.
    causes
        Those named, best first; all of them fit nearly as well.
    tried
        All that were tried and that the rows can tell something of, best first.
    structure
        Tests of the residuals of the model alone.
    stretched
        Parameters whose estimates lie far out in their priors.
    """

    model: str
    causes: tuple[Cause, ...] = ()
    tried: tuple[Attempt, ...] = ()
    structure: tuple[Structure, ...] = ()
    stretched: tuple[Stretched, ...] = ()

    @property
    def left_out(self) -> Cause | None:
        """The first cause that the model does not allow for and that matters for depths."""
        found = [c for c in self.causes if not c.is_carried and c.effect > MATTERS]
        return found[0] if found else None

    def others(self, cause: Cause) -> tuple[str, ...]:
        """Return the names of causes that explain the same data about as well as one of them."""
        same = [other for other in self.causes if other.seen_in == cause.seen_in]
        return tuple(other.name for other in same if other.name != cause.name)

    def words(self, cause: Cause) -> str:
        """Return what a cause says, its remedy and what else it may be."""
        text = f"{cause.name}: {cause.text}; {cause.hypothesis.remedy}"
        if others := self.others(cause):
            text += f". As well it may be {' or '.join(others)}: {cause.hypothesis.tells}"
        return text


def diagnose(
    rows: Observations,
    priors: Priors,
    fit: RobustFit,
    history: RowHistory,
    depths: DepthTable,
    *,
    is_left: bool,
) -> Diagnosis:
    """Return what labs do wrong and these rows show.

    Parameters
    ----------
    fit
        The robust fit of the selected model.
    depths
        Uncertainty of depth, against which effects are held.
    is_left
        Whether the rows are those of a rig in a mirror.
    """
    tried = Tried.of(rows, priors, fit, history, is_left=is_left)
    if tried is None:
        return Diagnosis(fit.model, stretched=stretched_priors(fit, priors))
    return replace(
        tried.diagnosis(depths),
        structure=residual_structure(tried.base),
        stretched=stretched_priors(fit, priors),
    )


@dataclass(frozen=True)
class Tried:
    """All hypotheses tried.

    Parameters
    ----------
    model
        Name of the model.
    base
        The rows without those rejected as outliers, as the selected model has them.
    outcomes
        By name, the decisive ones and the others.
    """

    model: str
    base: Base
    outcomes: dict[str, Outcome]

    @classmethod
    def of(
        cls,
        rows: Observations,
        priors: Priors,
        fit: RobustFit,
        history: RowHistory,
        *,
        is_left: bool,
        only: Sequence[str] = tuple(HYPOTHESES),
    ) -> Tried | None:
        """Return what came of it; None where the rows are too few.

        Parameters
        ----------
        only
            Hypotheses to try.
        """
        session = Session.of(rows, history, is_left=is_left)
        rejected = fit.rejected
        if len(rows) > MOST_ROWS:
            some = np.linspace(0, len(rows) - 1, MOST_ROWS).astype(np.int64)
            rows, session, rejected = rows.take(some), session.take(some), rejected[some]
        whole = bases(rows, session, priors, fit)
        kept = whole
        if rejected.any():
            kept = bases(rows.take(~rejected), session.take(~rejected), priors, fit)
        if not kept or not whole or not kept[0].is_free_enough():
            return None
        outcomes: dict[str, Outcome] = {}
        for hypothesis in (HYPOTHESES[name] for name in only):
            for base in whole if hypothesis.name in _OF_OUTLIERS else kept:
                found = best_of(hypothesis, base)
                best = outcomes.get(hypothesis.name)
                if found is not None and (best is None or found.gain > best.gain):
                    outcomes[hypothesis.name] = found
        if REFERENCE_OFFSET in fit.names and "reference-offset" in only:
            carried = carried_offset(kept)
            if carried is not None:
                outcomes["reference-offset"] = carried
        return cls(fit.model, kept[0], outcomes)

    @property
    def named(self) -> tuple[str, ...]:
        """The decisive hypotheses, best first: those nearly as good as the best."""
        ranked = sorted(self.outcomes, key=lambda name: -self.outcomes[name].gain)
        best = self.outcomes[ranked[0]].gain if ranked else 0.0
        return tuple(n for n in ranked if self.outcomes[n].gain >= max(DECISIVE, best - AS_GOOD))

    def diagnosis(self, depths: DepthTable) -> Diagnosis:
        """Return the decisive ones, with their effects on depths."""
        causes = tuple(self._cause(name, depths) for name in self.named)
        ranked = sorted(self.outcomes, key=lambda name: -self.outcomes[name].gain)
        tried = tuple(self._attempt(name) for name in ranked)
        return Diagnosis(self.model, causes, tried)

    def _attempt(self, name: str) -> Attempt:
        return attempt_of(HYPOTHESES[name], self.outcomes[name])

    def _cause(self, name: str, depths: DepthTable) -> Cause:
        hypothesis, found = HYPOTHESES[name], self.outcomes[name]
        value, std = _stated(hypothesis, found)
        return Cause(
            name=name,
            at=found.at,
            estimate=value,
            std=std,
            gain=found.gain,
            noise_scale=(found.before.scale, found.refit.scale),
            effect=0.0 if found.is_carried else self._effect(hypothesis, found, depths),
            is_carried=found.is_carried,
            ids=found.ids,
            residual_mrad=np.stack([found.before.residual_mrad, found.refit.residual_mrad]),
        )

    def _effect(self, hypothesis: Hypothesis, found: Outcome, depths: DepthTable) -> float:
        """Return the largest change of a depth over its standard uncertainty."""
        rows = self.base.looked.rows
        gaze: Gaze = rows.gaze
        before = depth(measured(self.base.refit.theta), gaze)
        if hypothesis.of_readings and len(found.loadings) == len(rows):
            gaze, _ = corrected(rows, found.loadings, found.values)
        after = depth(measured(found.refit.theta), gaze)
        u = np.interp(before, depths.depth_mm, depths.prediction.u_mm)
        change = np.abs(after - before) / u
        good = np.isfinite(change)
        return float(change[good].max()) if good.any() else 0.0


def attempt_of(hypothesis: Hypothesis, found: Outcome) -> Attempt:
    """Return the best trial of a hypothesis in its unit."""
    value, std = _stated(hypothesis, found)
    return Attempt(hypothesis.name, found.at, value, std, found.gain)


def _stated(hypothesis: Hypothesis, found: Outcome) -> tuple[float, float]:
    """Return estimate and standard uncertainty in the hypothesis' unit."""
    values = found.values / hypothesis.per_unit
    if not len(values):
        return float("nan"), float("nan")
    covariance = found.covariance / hypothesis.per_unit**2
    if not hypothesis.is_size:
        return float(values[0]), float(np.sqrt(covariance[0, 0]))
    size = float(np.sqrt(values @ values))
    return size, float(np.sqrt(values @ covariance @ values)) / max(size, 1e-300)
