"""Gates and warnings: whether a result may be used, and what its reader should know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import chi2

from calib.checks.diagnosis import diagnosis_gate, diagnosis_warnings, structure_words
from calib.checks.field import field_gate
from calib.core.gate import Gate
from calib.diagnosis.structure import structured
from calib.fit.chains import ESS_GOAL, R_HAT_LIMIT
from calib.fit.group_check import GroupCheck
from calib.fit.identifiability import Identifiability
from calib.fit.posterior import Posterior
from calib.fit.priors import NOISE_SCALE
from calib.fit.robust import RobustFit
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.images.result import ImageResult
from calib.instrument.adjusted import ROWS
from calib.instrument.averaging import doubt_of
from calib.instrument.calibrated import DepthTable
from calib.results.calibration import GazeResult
from calib.uncertainty.format import widening

NOISE_SCALE_LIMIT = 5.0
"""Residuals five times what the manifest states: no honest estimate is that far off; either a
statement, a row or the model is wrong."""

NOISE_SCALE_REMARK = 2.0
"""Also the limit where the rows are too few for any model but the smallest: nothing then tells
uncertainties stated too small from an axis that stands off."""

TOO_CAREFUL, TOO_CAREFUL_CHANCE = 0.5, 1e-4
"""Residuals smaller than this part of what is stated are remarked on, where chance makes them so
small no more often than that."""

ZERO_ERROR_REMARK_RAD = float(np.deg2rad(5.0))
"""An axis set by eye is right to a degree or two. Readings in gon look like a zero error of 9."""

DEPTH_LIMIT_REL = 0.2
"""Relative standard uncertainty, in the middle of the calibrated depths, above which nothing has
been calibrated that a look would not tell."""

NAMED = 10
"""Outliers that a text names; calibration.json has all."""

PAIRS_NOISE_RATIO, PAIRS_NOISE_PX = 5.0, 0.25
"""Of the residuals of pairs over those of the boards for the lenses, and what needs no excuse.
Small squares far off double or treble the noise; a C2 bumped by 0.3 degrees half-way through leaves
0.8 px, as the boards' own poses take up most of it, and turns 1T2 by half of that."""

OUTLIER_SHARE_LIMIT = 1 / 6
"""Above it the noise scale itself may be an outlier's: see `calib.fit.noise`."""


def all_gates(
    images: ImageResult, gaze: GazeResult | None, failures: Mapping[str, str]
) -> tuple[Gate, ...]:
    """Return the gates of a whole run.

    Parameters
    ----------
    failures
        Why stages that should have had a result have none, by their names.
    """
    gates = [Gate(name, passed=False, detail=reason) for name, reason in failures.items()]
    for intrinsics in images.intrinsics.values():
        gates += intrinsics.gates
    if images.stereo is not None:
        lenses = tuple(i.selected.rms_px for i in images.intrinsics.values())
        gates += [*images.stereo.gates, *_pairs_noise(images.stereo.rms_px, lenses)]
    gates += images.sweep.gates if images.sweep is not None else ()
    if gaze is not None:
        if "c1" in images.intrinsics:
            gates.append(field_gate(images.intrinsics["c1"], gaze))
        gates += gaze_gates(gaze)
    return tuple(gates)


def _pairs_noise(pairs_px: float, lenses_px: tuple[float, ...]) -> list[Gate]:
    """Return a gate on how well pairs fit one pose of C2, beside how well boards fit the lenses.

    Parameters
    ----------
    pairs_px
        Root mean square of the pairs' residuals, px; NaN where 1T2 is given.
    lenses_px
        Of the boards of each camera whose lens was solved.
    """
    if not np.isfinite(pairs_px) or not lenses_px:
        return []
    limit = max(PAIRS_NOISE_PX, PAIRS_NOISE_RATIO * max(lenses_px))
    passed = pairs_px <= limit
    detail = (
        f"the pairs fit one pose of C2 to {pairs_px:.3f} px, the boards the lenses to "
        f"{max(lenses_px):.3f} px (limit for the pairs {limit:.2f})"
    )
    if not passed:
        detail += "; was C2 moved or bumped between the pairs, or a lens between pairs and boards?"
    return [Gate("stereo-noise", passed, detail)]


def all_warnings(images: ImageResult, gaze: GazeResult | None) -> tuple[str, ...]:
    """Return what the reader should know of a whole run."""
    found = [f"{name}: {text}" for name, c in images.corners.items() for text in c.remarks]
    found += [text for intrinsics in images.intrinsics.values() for text in intrinsics.warnings]
    return (*found, *(gaze_warnings(gaze) if gaze is not None else ()))


def gaze_gates(gaze: GazeResult) -> tuple[Gate, ...]:
    """Return the gates of the gaze calibration."""
    gates = [gaze.encoder_direction, _fitted(gaze)]
    if gaze.posterior:
        gates += [convergence(gaze.posterior), _agreement(gaze.posterior)]
    if gaze.comparison is not None:
        selected = gaze.comparison.selected
        gates += [_residuals(gaze, selected), outliers_gate(gaze.robust[selected])]
        # Of the other models it is no fault to be undetermined: they were not selected.
        gates.append(gaze.identifiability[selected].gate)
    if gaze.calibrated is not None and gaze.depths is not None:
        gates.append(_depth(gaze.depths))
    if gaze.diagnosis is not None:
        gates.append(diagnosis_gate(gaze.diagnosis))
    return tuple(gates)


def _fitted(gaze: GazeResult) -> Gate:
    if gaze.posterior:
        return Gate("fit", passed=True, detail=f"fitted: {', '.join(gaze.posterior)}")
    reasons = "; ".join(f"{name}: {reason}" for name, reason in gaze.refused.items())
    return Gate("fit", passed=False, detail=f"no model could be fitted: {reasons}")


def convergence(posteriors: Mapping[str, Posterior]) -> Gate:
    """Return whether the chains of all models have reached their posteriors."""
    details = []
    for name, p in posteriors.items():
        detail = (
            f"{name}: {p.steps} steps, {p.steps / p.tau.max():.0f} autocorrelation times, at least "
            f"{min(p.ess_bulk.min(), p.ess_tail.min()):.0f} effective draws (wanted "
            f"{ESS_GOAL:.0f}), R-hat at most {p.r_hat.max():.4f} (limit {R_HAT_LIMIT})"
        )
        if p.left_out is not None:
            detail += (
                f"; another solution, {_solution(p)}, has {100 * p.left_out.share:.3g} % of the "
                "probability and is left out: look for rows that contradict each other, state "
                "tighter priors"
            )
        elif not p.converged:
            detail += ", not converged: add rows, state tighter priors, look for outliers"
        details.append(detail)
    passed = all(p.converged for p in posteriors.values())
    return Gate("convergence", passed=passed, detail="; ".join(details))


def _solution(p: Posterior) -> str:
    """Return parameters of the mode left out, as text."""
    if p.left_out is None:
        return ""
    values = zip(p.names[:-1], p.left_out.place[:-1], strict=True)
    return ", ".join(f"{name} {value:.6g}" for name, value in values)


def _agreement(posteriors: Mapping[str, Posterior]) -> Gate:
    details = []
    for name, p in posteriors.items():
        detail = (
            f"{name}: k-hat {p.k_hat:.2f}, {p.importance_ess:.0f} effective draws, means within "
            f"{p.agreement:.2f} of what may differ"
        )
        if not p.agrees:
            detail += ", not confirmed: do not use this posterior"
        details.append(detail)
    return Gate(
        "agreement",
        passed=all(p.agrees for p in posteriors.values()),
        detail=f"importance sampling against emcee, {'; '.join(details)}",
    )


def _residuals(gaze: GazeResult, model: str) -> Gate:
    shown = None if gaze.diagnosis is None else structured(gaze.diagnosis.structure)
    said = None if shown is None else structure_words(shown)
    return residuals_gate(gaze.robust[model], alone=len(gaze.robust) == 1, structure=said)


def residuals_gate(fit: RobustFit, *, alone: bool = False, structure: str | None = None) -> Gate:
    """Return whether residuals are of the size that the stated uncertainties lead to expect.

    Parameters
    ----------
    alone
        Whether no other model could be fitted.
    structure
        What the residuals follow, in words; None if nothing.
    """
    scale = fit.noise_scale
    detail = (
        f"residuals of {fit.model} are {scale:.2f} times what the stated uncertainties lead to "
        "expect"
    )
    limit = NOISE_SCALE_REMARK if alone else NOISE_SCALE_LIMIT
    passed = scale <= limit
    if passed and scale > NOISE_SCALE_REMARK and structure is not None:
        passed = False
        detail += f"; they have structure: {structure}; see the diagnosis"
    elif not passed and alone:
        detail += (
            f" (limit {limit:g} where no other model could be fitted): add rows, which tell "
            "whether the model or a statement in dataset.toml is wrong"
        )
    elif not passed:
        detail += (
            f" (limit {limit:g}): a statement in dataset.toml, some rows or the model "
            "are wrong; look at the residuals in the report"
        )
    return Gate("residuals", passed=passed, detail=detail)


def outliers_gate(fit: RobustFit) -> Gate:
    """Return whether so few rows disagree with the others that it may be chance."""
    outliers, count = fit.outliers, len(fit.rejected)
    passed = len(outliers) <= OUTLIER_SHARE_LIMIT * count
    named = f": {', '.join(outliers[:NAMED])}" if outliers else ""
    detail = f"{len(outliers)} of {count} rows disagree with the others{named}"
    if not passed:
        detail += "; too many to be chance: check these rows, units and groups"
    return Gate("outliers", passed=passed, detail=detail)


def _depth(depths: DepthTable) -> Gate:
    """Gate on a measured depth: parameters, shared errors and the reading's own together."""
    relative = depths.middle_u_mm / depths.middle_mm
    passed = relative <= DEPTH_LIMIT_REL
    known = f"is measured to {100 * relative:.2g} %"
    if not np.isfinite(relative):
        known = "has no standard uncertainty: one reading gives it no upper limit"
    detail = f"a depth of {depths.middle_mm:.0f} mm {known}"
    if not passed:
        detail += (
            f" (limit {100 * DEPTH_LIMIT_REL:.0f} %): add targets at other depths and yaw angles, "
            "or look for what makes a reading so uncertain (table of sources in the report)"
        )
    return Gate("depth", passed=passed, detail=detail)


def gaze_warnings(gaze: GazeResult) -> tuple[str, ...]:
    """Return what the reader should know of the gaze calibration."""
    found = []
    if gaze.comparison is not None:
        model = gaze.comparison.selected
        fit = gaze.robust[model]
        if fit.noise_scale > NOISE_SCALE_REMARK:
            found.append(
                f"residuals of {model} are {fit.noise_scale:.2f} times what the manifest's "
                f"uncertainties lead to expect; those of a reading are widened by "
                f"{widening(_widened(gaze))}, as the ratio is uncertain too ({NOISE_SCALE})"
            )
        found += _too_careful(fit)
        zero = float(fit.theta[INDEX["delta2_rad"]])
        if abs(zero) > ZERO_ERROR_REMARK_RAD:
            found.append(
                f"the zero error of the encoder comes out as {np.rad2deg(zero):.1f} deg: if that "
                "is a surprise, check unit (degrees) and origin of alpha2_deg (at 90 C2 looks "
                "parallel to Z of C1)"
            )
        found += _named_outliers(gaze, model)
        if gaze.choice is None or gaze.choice.method == ROWS:
            found += _left_to_priors(gaze.identifiability[model])
        found += [
            f"model {score.model}: left-out density of row {', '.join(score.unreliable)} is "
            "unreliable, its importance weights have a heavy tail"
            for score in gaze.comparison.scores
            if score.unreliable
        ]
    if gaze.groups is not None and gaze.groups.together:
        found.append(_together(gaze.groups))
    found += diagnosis_warnings(gaze.diagnosis, gaze.correction)
    if gaze.average is not None and gaze.depths is not None and gaze.by_rows is not gaze.beside:
        told = doubt_of(gaze.average, gaze.depths)
        found += [] if told is None else [told]
    if gaze.calibrated is not None and gaze.calibrated.measures_residual:
        found.append(
            "depth uncertainties are those of readings with C2's image (u2_px), as in the "
            "calibration rows; a reading without it carries the encoder's step too, which "
            "calib measure adds"
        )
    if gaze.convex is not None and not gaze.convex.optimal:
        found.append(
            f"base/convex is not proved optimal: duality gap {gaze.convex.duality_gap:.1e}"
        )
    return tuple(found)


def _widened(gaze: GazeResult) -> float:
    return 1.0 if gaze.calibrated is None else gaze.calibrated.noise_factor


def _too_careful(fit: RobustFit) -> list[str]:
    """Return a warning where residuals are far smaller than the stated uncertainties."""
    kept = fit.standardised[~fit.rejected]
    freedom = len(kept) - fit.data_parameters
    ratio = float(np.sqrt(kept @ kept / max(freedom, 1.0)))
    if freedom < 1 or ratio > TOO_CAREFUL or chi2.cdf(kept @ kept, freedom) > TOO_CAREFUL_CHANCE:
        return []
    return [
        f"residuals of {fit.model} are only {ratio:.2g} times what the stated uncertainties lead "
        "to expect: if u_x1c, u_z_rel, u_z_mm or resolution_deg are too large (per cent for "
        "parts, tolerances for standard uncertainties), depths are more certain than stated"
    ]


def _named_outliers(gaze: GazeResult, model: str) -> list[str]:
    """Return a warning that names outliers too few for their gate: gross errors of single rows."""
    outliers = gaze.robust[model].outliers
    if not outliers or not outliers_gate(gaze.robust[model]).passed:
        return []
    more = f" and {len(outliers) - NAMED} more" if len(outliers) > NAMED else ""
    return [
        f"{len(outliers)} of {len(gaze.rows)} rows disagree with the others and hardly move the "
        f"result: {', '.join(outliers[:NAMED])}{more}; look at their pictures, reading and "
        "reference depth"
    ]


def _together(found: GroupCheck) -> str:
    """Return what to do where rows of a group err together."""
    return (
        f"rows of one group have a common error (p = {found.probability:.0e} if they were "
        f"independent, {found.groups} groups). If a group has its reference depth from one "
        f"measurement, state u_z_group_rel = {found.u_z_rel:.1g} or so in [gaze], or keep one row "
        "a group; until then the intervals of depth may be too short"
    )


def _left_to_priors(found: Identifiability) -> list[str]:
    """Return what the rows leave open, with the parameters that priors therefore decide."""
    left = [
        name
        for name, who in zip(found.names, found.decided_by, strict=True)
        if who == "prior" and name not in found.idle
    ]
    texts: list[str] = []
    for combination in found.open:
        if any(text.startswith(combination.words) for text in texts):
            continue  # two combinations may ask for the same
        own = [name for name in found.names if name in combination.names and name in left]
        left = [name for name in left if name not in own]
        rest = "rests" if len(own) == 1 else "rest"
        decided = f"; until then {' and '.join(own)} {rest} on prior knowledge" if own else ""
        texts.append(f"{combination.words}{decided}")
    texts += [
        f"{name} ({PARAMETERS[INDEX[name]].meaning}) is identified by prior knowledge, not by "
        "the rows"
        for name in left
    ]
    return texts
