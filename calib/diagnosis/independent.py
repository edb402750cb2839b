"""Stage: what independent references say of mistakes that calibration rows cannot show.

A scale that all calibration references have in common goes into the baseline and leaves no trace in
the rows. Depths and lengths that were not used to fit show it; but so they show a zero that moved
between the two tables, and references that count from another place. The three are compared by
their marginal likelihoods: measured less reference is normal with the covariance of calibration,
readings and references, and each mistake adds one linear term with a normal prior (Kass and Raftery
1995, doi 10.1080/01621459.1995.10476572). What the calibration itself leaves uncertain explains no
less than a mistake does, so that over a narrow range of depths none is named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calib.core.arrays import FloatArray
from calib.dataset.tables import LengthTable
from calib.diagnosis.differences import Differences, differences
from calib.diagnosis.engine import AS_GOOD
from calib.diagnosis.findings import Attempt, Cause, Diagnosis, Suspect
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.later import as_meant
from calib.diagnosis.session import RowHistory
from calib.fit.priors import NOISE_SCALE_PRIOR
from calib.fit.robust import RobustFit
from calib.instrument.calibrated import CalibratedInstrument, DepthTable
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations

LEAST = 3
"""Independent depths and lengths from which mistakes are told by them."""

LEAST_GAIN = 2.0
"""Evidence from which a mistake is named, nats."""

SCALES = np.linspace(-3.0, 4.0, 57)
"""Logarithms of the noise scale over which evidence is summed."""


_MISTAKES: tuple[tuple[str, Callable[[Differences], FloatArray]], ...] = (
    ("reference-scale", lambda d: d.by_scale),
    ("reading-step", lambda d: d.by_zero),
    ("reference-offset", lambda d: d.by_origin),
)
"""Mistakes by name, and what a unit of each adds to measured less reference."""

_NAMES = tuple(name for name, _ in _MISTAKES)


def diagnose_references(
    found: Diagnosis,
    calibrated: CalibratedInstrument,
    fit: RobustFit,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None,
    depths: DepthTable,
    history: RowHistory,
) -> Diagnosis:
    """Return the diagnosis with what independent references add to it.

    Nothing where the rows themselves show a mistake that matters: an instrument that is calibrated
    by such rows contradicts every reference.

    Parameters
    ----------
    found
        The diagnosis by calibration rows.
    calibrated, fit
        The instrument and the robust fit of its model.
    rows, validation, lengths
        Calibration rows, and what was not used to fit; None without.
    depths
        Uncertainty of depth, against which effects are held.
    history
        Of the rows: steps of encoder and motor.
    """
    suspects, found = found.suspects, replace(found, suspects=())
    if found.left_out is not None:
        return found
    seen = differences(calibrated, fit, rows, validation, lengths)
    if len(seen) < LEAST:
        return found
    trials = [_Trial.of(name, seen, by(seen)) for name, by in _MISTAKES]
    for suspect in suspects:
        if suspect.attempt.name not in _NAMES:
            tables = as_meant(suspect, rows, validation, history)
            if tables is not None:
                meant = differences(calibrated, fit, *tables, lengths, theta=suspect.theta)
                trials.append(_Trial.of_suspect(suspect, seen, meant))
    ranked = sorted((t for t in trials if t is not None), key=lambda t: -t.attempt.gain)
    if not ranked:
        return found
    least = max(LEAST_GAIN, ranked[0].attempt.gain - AS_GOOD)
    causes = tuple(t.cause(seen, depths) for t in ranked if t.attempt.gain >= least)
    return replace(
        found,
        causes=(*found.causes, *causes),
        tried=(*found.tried, *(t.attempt for t in ranked if t.attempt.name in _NAMES)),
    )


@dataclass(frozen=True)
class _Trial:
    """A mistake tried on independent references."""

    attempt: Attempt
    push: FloatArray
    value: float
    scales: tuple[float, float]

    @classmethod
    def of(cls, name: str, seen: Differences, push: FloatArray) -> _Trial | None:
        """Return what comes of a mistake, its change per unit in `push`, shape (m,)."""
        hypothesis = HYPOTHESES[name]
        size = hypothesis.typical * hypothesis.per_unit
        without, with_it = _evidence(seen, None), _evidence(seen, push * size)
        if without is None or with_it is None:
            return None
        gain = with_it.log - without.log - float(np.log(len(_MISTAKES)))
        value, std = with_it.mean * size, with_it.std * size
        attempt = Attempt(
            name, None, value / hypothesis.per_unit, std / hypothesis.per_unit, gain,
            seen_in="references",
        )  # fmt: skip
        return cls(attempt, push, value, (without.scale, with_it.scale))

    @classmethod
    def of_suspect(cls, suspect: Suspect, seen: Differences, meant: Differences) -> _Trial | None:
        """Return what comes of a mistake that the rows leave open, with their evidence for it.

        Parameters
        ----------
        meant
            The differences as they are if it was made.
        """
        if meant.ids != seen.ids:
            return None
        push = seen.error_mm - meant.error_mm
        without = _evidence(seen, None)
        # The rows know its size but for its uncertainty.
        rest = replace(seen, error_mm=meant.error_mm)
        with_it = _evidence(rest, push * suspect.relative_std)
        if without is None or with_it is None:
            return None
        gain = suspect.attempt.gain + with_it.log - without.log
        attempt = replace(suspect.attempt, gain=gain, seen_in="both")
        return cls(attempt, push, 1.0, (without.scale, with_it.scale))

    def cause(self, seen: Differences, depths: DepthTable) -> Cause:
        """Return it as one that the references speak for."""
        moved = np.abs(self.push * self.value)
        of_depths = seen.by_origin > 0
        some = of_depths if of_depths.any() else np.ones(len(seen), dtype=np.bool_)
        u = np.interp(seen.by_scale[some], depths.depth_mm, depths.prediction.u_mm)
        before = seen.error_mm / seen.per_rad
        after = (seen.error_mm - self.push * self.value) / seen.per_rad
        a = self.attempt
        return Cause(
            a.name, a.at, a.estimate, a.std, a.gain, a.seen_in,
            noise_scale=self.scales,
            effect=float((moved[some] / u).max()),
            is_carried=False,
            ids=seen.ids,
            residual_mrad=1e3 * np.stack([before, after]),
        )  # fmt: skip


@dataclass(frozen=True)
class _Evidence:
    """Logarithm of a marginal likelihood, with the term's mean, std and the noise scale."""

    log: float
    mean: float
    std: float
    scale: float


def _evidence(seen: Differences, push: FloatArray | None) -> _Evidence | None:
    """Return the evidence with a term of unit variance, summed over the noise scale."""
    own = (seen.own**2).sum(axis=1)
    common = seen.by_common @ seen.by_common.T
    mean, std = NOISE_SCALE_PRIOR
    logs, means, variances = [], [], []
    for log_scale in SCALES:
        covariance = common + np.diag(np.exp(2 * log_scale) * own)
        try:
            factor = cho_factor(covariance)
        except LinAlgError:
            return None
        half = cho_solve(factor, seen.error_mm)
        log = -0.5 * seen.error_mm @ half - np.log(np.diag(factor[0])).sum()
        log -= 0.5 * ((log_scale - mean) / std) ** 2
        precision, shift = 1.0, 0.0
        if push is not None:
            information = float(push @ cho_solve(factor, push))
            precision, shift = 1.0 + information, float(push @ half)
            log += 0.5 * shift**2 / precision - 0.5 * np.log(precision)
        logs.append(float(log))
        means.append(shift / precision)
        variances.append(1 / precision)
    weights = np.exp(np.array(logs) - max(logs))
    total = float(weights.sum())
    weights /= total
    middle = float(weights @ np.array(means))
    spread = float(weights @ (np.array(variances) + (np.array(means) - middle) ** 2))
    scale = float(np.exp(weights @ SCALES))
    return _Evidence(max(logs) + float(np.log(total)), middle, float(np.sqrt(spread)), scale)
