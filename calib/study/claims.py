"""What a study must show of the estimators, each claim with its figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.words import counted
from calib.study.conditions import ADVICE, CONDITIONS, GROUPS, MISTAKES
from calib.study.scores import RASH, StudyScore

INFINITY = float("inf")

UNIFORM_P = 0.01
"""Least corrected p of the rank test."""

CLEARLY = 2.5
"""Standard errors by which a score must lie beyond a limit before its claim counts as broken: of
some forty scores of honest estimators right at a limit, one in four studies shows one that far."""


LEAST_RIGS = 20
"""Of fewer rigs a standard error is itself too uncertain to call a claim held or broken."""


@dataclass(frozen=True)
class Claim:
    """A statement about all scores of one kind.

    Parameters
    ----------
    name
        One phrase.
    conditions
        Where it is claimed.
    subjects, estimators
        Of the scores meant; empty for all.
    statistic
        Of the scores meant.
    low, high
        Limits of each score's value.
    """

    name: str
    conditions: tuple[str, ...]
    subjects: tuple[str, ...]
    estimators: tuple[str, ...]
    statistic: str
    low: float
    high: float = INFINITY


@dataclass(frozen=True)
class Verdict:
    """A claim with the worst score of its kind.

    Parameters
    ----------
    claim
        Its name.
    held
        Whether every score is of `LEAST_RIGS` or more and within the limits by its standard error.
    broken
        Whether a score of `LEAST_RIGS` or more lies beyond a limit by more than `CLEARLY` standard
        errors; if neither, more rigs must decide.
    decided_by
        Rigs of which some such number would decide, if the score stays as it is; None if decided,
        or if no number would.
    worst
        The score nearest to a limit, or farthest beyond one.
    low, high
        The limits; None for none.
    """

    claim: str
    held: bool
    broken: bool
    decided_by: int | None
    worst: StudyScore
    low: float | None
    high: float | None


def _named(*, outliers: bool, model: str | None = None) -> tuple[str, ...]:
    return tuple(
        name
        for name in GROUPS["default"]
        if (CONDITIONS[name].outlier_share > 0) == outliers
        and model in (None, CONDITIONS[name].model)
    )


_CLEAN, _SPOILT = _named(outliers=False), _named(outliers=True)
_DEPTHS = ("depth inside", "depth beyond")
_LARGE = tuple(name for name in _CLEAN if CONDITIONS[name].rows == 60)

# fmt: off
CLAIMS: tuple[Claim, ...] = (
    Claim("95 % depth intervals cover 93 to 97 % inside the calibrated range",
          _CLEAN, _DEPTHS[:1], ("selected",), "coverage95", 0.93, 0.97),
    Claim("95 % depth intervals cover 92 to 98 % up to 1.5 times the range",
          _CLEAN, _DEPTHS[1:], ("selected",), "coverage95", 0.92, 0.98),
    Claim("with 10 % gross errors 95 % depth intervals cover over 90 %",
          _SPOILT, _DEPTHS, ("selected",), "coverage95", 0.90),
    Claim("averaged over the models they cover over 93 % where too simple a model was selected",
          _CLEAN, tuple(depth + RASH for depth in _DEPTHS), ("averaged",), "coverage95", 0.93),
    Claim("pulls of identified parameters have an rms of 0.9 to 1.1",
          _CLEAN, (), ("posterior",), "pull_rms", 0.9, 1.1),
    Claim("the robust fit reaches 90 % of the Cramer-Rao bound on clean rows",
          _LARGE, (), ("robust",), "efficiency", 0.90),
    Claim("ranks of true parameters and noise scale in their posterior are uniform",
          GROUPS["ranks"], (), ("posterior",), "uniformity_p", UNIFORM_P),
    Claim("the extended model is selected on at most 10 % of base rigs",
          _named(outliers=False, model="base"), ("model",), ("axis-offset",),
          "share", -INFINITY, 0.10),
    Claim("it is selected on at least 95 % of rigs with an axis offset over 5 standard errors",
          _named(outliers=False, model="axis-offset"), ("model",), ("axis-offset",),
          "share_clear", 0.95),
    Claim("advised targets leave u(z) at least 25 % below random ones",
          (ADVICE,), ("depth asked",), (), "u_ratio", -INFINITY, 0.75),
    Claim("a mistake is named on at most 1 % of rigs without one",
          (MISTAKES,), ("clean rigs",), (), "false_names", -INFINITY, 0.01),
    Claim("mistakes that move a depth by over 2 u and of which the rows have evidence are named, "
          "or are among those named, in 90 %",
          (MISTAKES,), (), (), "named_in_evidence", 0.90),
    Claim("another mistake alone is named in place of them in at most 5 %",
          (MISTAKES,), (), (), "wrong_name", -INFINITY, 0.05),
)
# fmt: on


def judge(scores: Sequence[StudyScore]) -> tuple[Verdict, ...]:
    """Return the verdicts on all claims of which there are scores."""
    return tuple(v for v in (_verdict(claim, scores) for claim in CLAIMS) if v is not None)


def _verdict(claim: Claim, scores: Sequence[StudyScore]) -> Verdict | None:
    meant = [s for s in scores if _means(claim, s)]
    if not meant:
        return None
    worst = max(meant, key=lambda s: _beyond(claim, s) + (s.std_error or 0.0))
    held = all(
        s.rigs >= LEAST_RIGS and _beyond(claim, s) + (s.std_error or 0.0) <= 0 for s in meant
    )
    broken = any(
        s.rigs >= LEAST_RIGS and _beyond(claim, s) > CLEARLY * (s.std_error or 0.0) for s in meant
    )
    more = None if held or broken else max(_needed(claim, s) for s in meant)
    low, high = (limit if np.isfinite(limit) else None for limit in (claim.low, claim.high))
    return Verdict(claim.name, held, broken and not held, more or None, worst, low, high)


def _needed(claim: Claim, score: StudyScore) -> int:
    """Return of how many rigs this score, as it is, would decide; 0 if none would."""
    beyond, error = _beyond(claim, score), score.std_error or 0.0
    if beyond == 0:
        return 0
    errors = CLEARLY if beyond > 0 else 1.0
    return max(LEAST_RIGS, int(np.ceil(score.rigs * (errors * error / beyond) ** 2)))


def _beyond(claim: Claim, score: StudyScore) -> float:
    """Return by how much a score lies beyond the nearer limit; negative within."""
    return max(claim.low - score.value, score.value - claim.high)


def _means(claim: Claim, score: StudyScore) -> bool:
    return (
        score.condition in claim.conditions
        and score.statistic == claim.statistic
        and (not claim.subjects or score.subject in claim.subjects)
        and (not claim.estimators or score.estimator in claim.estimators)
    )


def verdict_text(verdict: Verdict) -> str:
    """Return one line for the terminal."""
    s, mark = verdict.worst, "held  " if verdict.held else "BROKEN" if verdict.broken else "open  "
    error = "" if s.std_error is None else f" +- {s.std_error:.2g}"
    who = " ".join(part for part in (s.condition, s.subject, s.estimator) if part)
    rigs = counted(s.rigs, "rig")
    more = "" if verdict.decided_by is None else f"; some {verdict.decided_by} would tell"
    if s.rigs < LEAST_RIGS:
        more = f", too few to tell{more}"
    return f"{mark}  {verdict.claim}: {s.value:.3g}{error} ({who}, {rigs}{more})"
