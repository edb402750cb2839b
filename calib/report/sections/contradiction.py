"""What an independent reference says where it contradicts, for the first screen of the report."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.instrument.validation import ReferenceAgreement, ValidationResult
from calib.report.numbers import signed
from calib.results.calibration import GazeResult
from calib.uncertainty.format import significant

ORDERED = 0.8
"""Rank correlation from which errors are said to rise or fall with depth: of five independent ones
reached by chance in one of nine cases, of ten in one of a hundred."""

LEAST_ROWS = 4
"""Fewer errors show no trend."""


def what_the_errors_do(gaze: GazeResult, reference: str | None) -> str:
    """Return how the errors run and how the models compare; empty without validation rows.

    Parameters
    ----------
    reference
        What the validation rows' depths are; None where not stated.
    """
    if gaze.validation is None:
        return ""
    error = gaze.validation.errors[0]
    name = "the reference" if reference is None else f"the reference ({reference})"
    return f"{_run(gaze.validation, error, name)}{_other_model(gaze)}"


def _run(validation: ValidationResult, error: ReferenceAgreement, name: str) -> str:
    own = np.unique(validation.depth_of, return_index=True)[1]
    z, rel = error.reference_mm[own], error.error_rel[own]
    known = np.isfinite(rel)
    order = np.argsort(z[known], kind="stable")
    z, rel = z[known][order], rel[known][order]
    if not len(rel):
        return ""
    trend = _rank_correlation(rel) if len(rel) >= LEAST_ROWS else 0.0
    if abs(trend) < ORDERED:
        return (
            f"Against {name} depth is wrong by {_percent(rel.min())} to {_percent(rel.max())} %. "
        )
    word = "rise" if trend > 0 else "fall"
    return (
        f"Against {name} the errors of depth {word} with depth, from {_percent(rel[0])} % at "
        f"{z[0]:.0f} mm to {_percent(rel[-1])} % at {z[-1]:.0f} mm. "
    )


def _rank_correlation(values: FloatArray) -> float:
    """Return Spearman's correlation of values with their places."""
    ranks = np.argsort(np.argsort(values))
    return float(np.corrcoef(np.arange(len(values)), ranks)[0, 1])


def _percent(ratio: float) -> str:
    return signed(f"{100 * ratio:+.1f}")


def _other_model(gaze: GazeResult) -> str:
    """Return that another model fits the reference better than the one selected, and why not it."""
    if gaze.comparison is None:
        return ""
    scores = {
        score.model: score.validation_depth_rms_rel
        for score in gaze.comparison.scores
        if score.validation_depth_rms_rel is not None
    }
    selected = gaze.comparison.selected
    if selected not in scores:
        return ""
    best = min(scores, key=lambda model: scores[model])
    if best == selected or not scores[best] < scores[selected]:
        return ""
    ours, theirs = (significant(100 * scores[m], digits=2) for m in (selected, best))
    return (
        f"The selected model {selected} validates worse there than {best}, {ours} against {theirs} "
        f"% rms. Models are selected by the calibration rows alone (see below): a reference that "
        "helped to select one could no longer check it. "
    )
