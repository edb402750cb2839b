"""Statements of conformity with a tolerance on depth (JCGM 106, ILAC-G8:09/2019).

The quantity judged is an error of indication e with limits ±T. Where e was measured against a
reference, it is that error; where depth is only predicted, e is 0 and its uncertainty is all.

Decision rules
- "simple" (ILAC-G8, 4.2.1): pass if |e| <= T, else fail. The rule presumes an uncertainty that is
  small enough: where U exceeds T a pass would be an accident, and is a conditional pass.
- "guard-band" (ILAC-G8, 4.2.3) with g = 1.645 u, 95 % one-sided: pass if |e| <= T - g, conditional
  pass up to T, conditional fail up to T + g, fail beyond. Where T is so small that both limits
  matter, a pass also needs 95 % probability of conformance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from scipy.special import ndtr

from calib.uncertainty.depth import DepthUncertainty
from calib.uncertainty.montecarlo import NORMAL_FACTOR, Draws

DecisionRule: TypeAlias = Literal["simple", "guard-band"]
Verdict: TypeAlias = Literal["pass", "conditionalPass", "conditionalFail", "fail"]

GUARD_FACTOR = 1.6448536269514722
"""95 % quantile of the standard normal: 5 % risk beyond one limit (JCGM 106, 8.3.2)."""

CONFIDENCE = 0.95

SMALL_RATIO = 3.0
"""T / U below this: the statement hangs on the uncertainty more than on the instrument."""

ROUNDING = 1e-9
"""Relative slack for values that lie on a limit but for rounding errors."""

_ORDER: tuple[Verdict, ...] = ("pass", "conditionalPass", "conditionalFail", "fail")


@dataclass(frozen=True)
class ToleranceRule:
    """A tolerance on depth, ± `depth_rel` z, and the rule by which to decide."""

    depth_rel: float
    rule: DecisionRule


@dataclass(frozen=True)
class Conformity:
    """A statement of conformity with what it rests on.

    Parameters
    ----------
    error_mm
        The error of indication judged.
    limit_mm
        T: conforming errors lie within ±T.
    standard_uncertainty_mm, expanded_uncertainty_mm
        u and U (95 %) of the error.
    rule
        Decision rule.
    guard_band_mm
        g; 0 for the simple rule.
    acceptance_limit_mm
        T - g.
    probability
        That the error conforms.
    verdict
        The statement.
    ratio
        T / U.
    warning
        What to know before relying on the statement; None if nothing.
    """

    error_mm: float
    limit_mm: float
    standard_uncertainty_mm: float
    expanded_uncertainty_mm: float
    rule: DecisionRule
    guard_band_mm: float
    acceptance_limit_mm: float
    probability: float
    verdict: Verdict
    ratio: float
    warning: str | None


def conformance_probability(*, error: float, standard_uncertainty: float, limit: float) -> float:
    """Return the probability that a normally known error lies within ±limit (JCGM 106, 7.4)."""
    above = (limit - error) / standard_uncertainty
    below = (-limit - error) / standard_uncertainty
    # The upper tail as a lower one keeps its digits.
    return float(1 - ndtr(-above) - ndtr(below))


def assess(
    *,
    error_mm: float,
    standard_uncertainty_mm: float,
    expanded_uncertainty_mm: float,
    limit_mm: float,
    rule: DecisionRule,
    probability: float | None = None,
) -> Conformity:
    """Return the statement of conformity of an error with ±limit_mm.

    Parameters
    ----------
    error_mm, limit_mm
        e and T > 0.
    standard_uncertainty_mm, expanded_uncertainty_mm
        u > 0 and U > 0 of the error.
    rule
        Decision rule.
    probability
        Of conformance, where better known than from a normal distribution, such as from draws.
    """
    if probability is None:
        probability = conformance_probability(
            error=error_mm, standard_uncertainty=standard_uncertainty_mm, limit=limit_mm
        )
    guard = GUARD_FACTOR * standard_uncertainty_mm if rule == "guard-band" else 0.0
    ratio = limit_mm / expanded_uncertainty_mm
    likely, precise = probability >= CONFIDENCE - ROUNDING, ratio >= 1 - ROUNDING
    sure = likely if rule == "guard-band" else precise
    return Conformity(
        error_mm=error_mm,
        limit_mm=limit_mm,
        standard_uncertainty_mm=standard_uncertainty_mm,
        expanded_uncertainty_mm=expanded_uncertainty_mm,
        rule=rule,
        guard_band_mm=guard,
        acceptance_limit_mm=limit_mm - guard,
        probability=probability,
        verdict=_verdict(abs(error_mm), limit=limit_mm, guard=guard, sure=sure),
        ratio=ratio,
        warning=_warning(ratio),
    )


def predicted_conformity(
    result: DepthUncertainty, draws: Draws, *, tolerance: ToleranceRule
) -> Conformity:
    """Return the statement on an indicated depth of which no error was measured.

    The true depth is distributed as the draws; it conforms if it lies within the tolerance about
    the indication.
    """
    z, limit = result.z_mm, tolerance.depth_rel * result.z_mm
    half = max(z - result.interval.low, result.interval.high - z)
    u = result.standard_uncertainty_mm
    return assess(
        error_mm=0.0,
        standard_uncertainty_mm=half / NORMAL_FACTOR if u is None else u,
        expanded_uncertainty_mm=half,
        limit_mm=limit,
        rule=tolerance.rule,
        probability=draws.share_within(z - limit, z + limit),
    )


def measured_conformity(
    *,
    z_mm: float,
    u_mm: float,
    low95_mm: float,
    high95_mm: float,
    reference_mm: float,
    u_reference_mm: float,
    tolerance: ToleranceRule,
) -> Conformity:
    """Return the statement on the error of an indicated depth against a reference.

    `u_mm` may be infinite, and then `high95_mm` too: the depth has no standard uncertainty.
    """
    half = max(z_mm - low95_mm, high95_mm - z_mm)
    u = u_mm if math.isfinite(u_mm) else half / NORMAL_FACTOR
    return assess(
        error_mm=z_mm - reference_mm,
        standard_uncertainty_mm=math.hypot(u, u_reference_mm),
        expanded_uncertainty_mm=math.hypot(half, NORMAL_FACTOR * u_reference_mm),
        limit_mm=tolerance.depth_rel * reference_mm,
        rule=tolerance.rule,
    )


def _verdict(error: float, *, limit: float, guard: float, sure: bool) -> Verdict:
    slack = ROUNDING * limit
    if error <= limit - guard + slack and sure:
        return "pass"
    if error <= limit + slack:
        return "conditionalPass"
    return "conditionalFail" if guard > 0 and error <= limit + guard + slack else "fail"


def _warning(ratio: float) -> str | None:
    if ratio >= SMALL_RATIO - ROUNDING:
        return None
    shown = math.floor(ratio * 10) / 10
    if ratio < 1:
        return f"the expanded uncertainty exceeds the tolerance (tolerance / U = {shown:.1f})"
    return f"tolerance / U = {shown:.1f} is under {SMALL_RATIO:.0f}: a wrong statement is likely"


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst of verdicts: what can be said of all together.

    Raises
    ------
    ValueError
        If there is none.
    """
    return max(verdicts, key=_ORDER.index)
