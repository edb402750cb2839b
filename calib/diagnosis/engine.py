"""Each hypothesis tried on the rows, and the decisive ones named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray
from calib.diagnosis.attempts import BestTrial, best_of, carried_offset
from calib.diagnosis.bases import Base, bases, measured
from calib.diagnosis.findings import Attempt, Cause, Diagnosis, Suspect
from calib.diagnosis.hypotheses import HYPOTHESES, Hypothesis
from calib.diagnosis.refit import corrected
from calib.diagnosis.session import HistoryArrays, RowHistory
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.geometry.plane import Gaze, depth
from calib.instrument.calibrated import DepthTable
from calib.rows.observations import Observations

MOST_ROWS = 1000
"""Rows looked at: of a longer table so many, evenly; they tell any cause worth naming."""

DECISIVE = 2.0
"""Evidence from which a cause is named, in nats, all penalties paid: of 200 sound simulated rigs
none has so much, two have 0.5."""

AS_GOOD = 3.0
"""Causes whose evidence is within so many nats of the best are named with it."""

RUNNER_UP = 4.6
"""The second best cause is named with the best unless the odds between them are 100 to 1."""

OPEN = -10.0
"""Evidence from which independent references are asked about a cause that rows do not show."""

SCATTERED = 2.0
"""Noise scale above which references are asked about nothing that rows do not show: of a fit that a
few wrong rows have spoilt whatever takes their weight away predicts depths better."""

OF_OUTLIERS = ("rows-exchanged", "unit", "group-reference")
"""Hypotheses about rows that the fit rejects."""


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
    first
        The first of two mistakes that are named together, if they are.
    """

    model: str
    base: Base
    outcomes: dict[str, BestTrial]
    first: str | None = None

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
        rows, session, rejected = looked_at(rows, history, fit, is_left=is_left)
        whole = bases(rows, session, priors, fit)
        kept = whole
        if rejected.any():
            kept = bases(rows.take(~rejected), session.take(~rejected), priors, fit)
        return cls.on(whole, kept, fit, only)

    @classmethod
    def on(
        cls,
        whole: tuple[Base, ...],
        kept: tuple[Base, ...],
        fit: RobustFit,
        only: Sequence[str] = tuple(HYPOTHESES),
    ) -> Tried | None:
        """Return what came of all rows and of those that are no outliers."""
        if not kept or not whole or not kept[0].is_free_enough():
            return None
        outcomes: dict[str, BestTrial] = {}
        for hypothesis in (HYPOTHESES[name] for name in only):
            for base in whole if hypothesis.name in OF_OUTLIERS else kept:
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
    def ranked(self) -> tuple[str, ...]:
        """All hypotheses, best first."""
        return tuple(sorted(self.outcomes, key=lambda name: -self.outcomes[name].gain))

    @property
    def named(self) -> tuple[str, ...]:
        """The decisive hypotheses, best first: those nearly as good as the best."""
        if self.first is not None:
            return (self.first,)
        decisive = [n for n in self.ranked if self.outcomes[n].lead >= DECISIVE]
        return tuple(
            name
            for place, name in enumerate(decisive)
            if self.outcomes[decisive[0]].gain - self.outcomes[name].gain
            <= (RUNNER_UP if place == 1 else AS_GOOD)
        )

    def diagnosis(self, depths: DepthTable) -> Diagnosis:
        """Return the decisive ones, with their effects on depths."""
        causes = tuple(self._cause(name, depths) for name in self.named)
        tried = tuple(self._attempt(name) for name in self.ranked)
        return Diagnosis(self.model, causes, tried, suspects=tuple(self._suspects()))

    def _suspects(self) -> Iterator[Suspect]:
        """Yield what rows leave open and independent references may tell."""
        if self.base.refit.scale > SCATTERED:
            return
        for name in self.ranked:
            found = self.outcomes[name]
            if found.lead > OPEN and not found.is_carried and name not in self.named:
                yield Suspect(
                    attempt=self._attempt(name),
                    values=found.values,
                    covariance=found.covariance,
                    theta=found.refit.theta,
                    noise_scale=(found.before.scale, found.refit.scale),
                )

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

    def _effect(self, hypothesis: Hypothesis, found: BestTrial, depths: DepthTable) -> float:
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


def looked_at(
    rows: Observations, history: RowHistory, fit: RobustFit, *, is_left: bool
) -> tuple[Observations, HistoryArrays, BoolArray]:
    """Return the rows looked at, how they came about, and which of them are outliers."""
    session = HistoryArrays.of(rows, history, is_left=is_left)
    if len(rows) <= MOST_ROWS:
        return rows, session, fit.rejected
    some = np.linspace(0, len(rows) - 1, MOST_ROWS).astype(np.int64)
    return rows.take(some), session.take(some), fit.rejected[some]


def attempt_of(hypothesis: Hypothesis, found: BestTrial) -> Attempt:
    """Return the best trial of a hypothesis in its unit."""
    value, std = _stated(hypothesis, found)
    return Attempt(hypothesis.name, found.at, value, std, found.gain)


def _stated(hypothesis: Hypothesis, found: BestTrial) -> tuple[float, float]:
    """Return estimate and standard uncertainty in the hypothesis' unit."""
    values = found.values / hypothesis.per_unit
    if not len(values):
        return float("nan"), float("nan")
    covariance = found.covariance / hypothesis.per_unit**2
    if not hypothesis.is_size:
        return float(values[0]), float(np.sqrt(covariance[0, 0]))
    size = float(np.sqrt(values @ values))
    return size, float(np.sqrt(values @ covariance @ values)) / max(size, 1e-300)
