"""Stage: mistakes tried on the rows, a second one beside the first.

Two mistakes at once hide each other: neither explains the rows, or a third follows both in part.
Where the best single cause leaves residuals unexplained, some others are tried as the first one,
and the pair with the greatest evidence counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.attempts import BestTrial, best_of
from calib.diagnosis.bases import bases
from calib.diagnosis.engine import AS_GOOD, DECISIVE, Tried, looked_at
from calib.diagnosis.findings import Diagnosis
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.refit import Added
from calib.diagnosis.session import HistoryArrays, RowHistory
from calib.diagnosis.structure import residual_structure, stretched_priors
from calib.fit.noise import is_outlier
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit
from calib.instrument.calibrated import DepthTable
from calib.rows.observations import Observations

UNEXPLAINED = 1.5
"""Noise scale beside the best single cause from which others are tried as the first of a pair."""

FIRSTS = 5
"""Causes tried as the first of a pair."""

LEAST_ROWS = 12
"""Rows from which pairs are looked for that no single cause leads to."""


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
    task = Task(rows, priors, fit, history, is_left=is_left)
    tried = task.tried()
    if tried is None:
        return Diagnosis(fit.model, stretched=stretched_priors(fit, priors))
    tried, second = task.with_second(tried)
    found = tried.diagnosis(depths)
    if second is not None:
        first = tried.named[0]
        more = (replace(c, beside=first) for c in second.diagnosis(depths).causes)
        found = replace(found, causes=(*found.causes, *more))
    return replace(
        found,
        structure=residual_structure(tried.base),
        stretched=stretched_priors(fit, priors),
    )


@dataclass(frozen=True)
class Task:
    """What is diagnosed; arguments as of `diagnose`."""

    rows: Observations
    priors: Priors
    fit: RobustFit
    history: RowHistory
    is_left: bool = False

    def tried(self) -> Tried | None:
        """Return what comes of single mistakes; None where the rows are too few."""
        return Tried.of(self.rows, self.priors, self.fit, self.history, is_left=self.is_left)

    def with_second(self, tried: Tried) -> tuple[Tried, Tried | None]:
        """Return what was tried, the first of a pair as it is beside the second, and the second."""
        named = tried.named
        name = named[0] if named else None
        second = None if name is None else self.beside(tried, name)
        if _unexplained(tried, second) and len(tried.base.looked.rows) >= LEAST_ROWS:
            # One more choice of a first cause has to be paid for.
            most = max([DECISIVE, *(_gain(tried, one, second) for one in named[:1])]) + AS_GOOD
            for other in tried.ranked[:FIRSTS]:
                found = None if other == name else self.beside(tried, other)
                if found is not None and _gain(tried, other, found) > most:
                    name, second, most = other, found, _gain(tried, other, found)
        if name is None or second is None:
            return tried, None
        return _together(tried, name, second), second

    def beside(self, tried: Tried, name: str) -> Tried | None:
        """Return what else shows once a cause is allowed for; None if nothing is named.

        A cause with a size stays a parameter beside the second one; of one without a size the rows
        are mended.
        """
        found = tried.outcomes[name]
        if found.is_carried:
            return None
        rows, session, _ = looked_at(self.rows, self.history, self.fit, is_left=self.is_left)
        if found.mended is None:
            found = self._on_all_rows(name, found, rows, session)
        place = {row: i for i, row in enumerate(rows.ids)}
        some = np.array([place[row] for row in found.ids])
        rows, session = rows.take(some), session.take(some)
        known: Added | None = None
        if found.mended is None:
            size = HYPOTHESES[name].typical * HYPOTHESES[name].per_unit
            known = Added(found.loadings, np.full(found.loadings.shape[2], size))
        else:
            good = found.mended
            rows = replace(
                rows, x1c=good.x1c, y1c=good.y1c, alpha2_rad=good.alpha2_rad, z_mm=good.z_mm
            )
        whole = bases(rows, session, self.priors, self.fit, known)
        if not whole:
            return None
        outlier = is_outlier(whole[0].refit.standardised, whole[0].refit.scale)
        kept = whole
        if outlier.any():
            left = None if known is None else replace(known, loadings=known.loadings[~outlier])
            kept = bases(rows.take(~outlier), session.take(~outlier), self.priors, self.fit, left)
        second = Tried.on(whole, kept, self.fit)
        return second if second is not None and second.named else None

    def _on_all_rows(
        self, name: str, found: BestTrial, rows: Observations, session: HistoryArrays
    ) -> BestTrial:
        """Return a cause as all rows have it, those that were outliers without it among them."""
        if len(found.ids) == len(rows):
            return found
        for base in bases(rows, session, self.priors, self.fit):
            other = best_of(HYPOTHESES[name], base)
            if other is not None and other.at == found.at:
                return other
        return found


def _gain(tried: Tried, name: str, second: Tried | None) -> float:
    """Return the evidence for a cause and the best one beside it, nats."""
    beside = 0.0 if second is None else second.outcomes[second.named[0]].gain
    return tried.outcomes[name].lead + beside


def _unexplained(tried: Tried, second: Tried | None) -> bool:
    """Whether rows scatter more than stated beside all that is named."""
    best = tried if second is None else second
    named = best.named
    left = best.outcomes[named[0]].refit.scale if named else best.base.refit.scale
    return left > UNEXPLAINED


def _together(tried: Tried, name: str, second: Tried) -> Tried:
    """Return what was tried, the first cause estimated together with the second."""
    found, other = tried.outcomes[name], second.outcomes[second.named[0]]
    if found.mended is None:
        own = slice(-len(found.values), None)
        found = replace(
            found,
            values=other.refit.stated[own],
            covariance=other.refit.stated_covariance[own, own],
        )
    first = tried.first
    if name not in tried.named[:1]:
        first, found = name, replace(found, gain=_gain(tried, name, second))
    return replace(tried, outcomes={**tried.outcomes, name: found}, first=first)
