"""Diagnosed causes, back from the mirror."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from calib.diagnosis.findings import Attempt, Cause, Diagnosis

T = TypeVar("T", bound=Attempt)


def mirror_diagnosis(found: Diagnosis) -> Diagnosis:
    """Return the causes: what is read and where targets are across changes its sign."""
    return replace(
        found,
        causes=tuple(_cause(cause) for cause in found.causes),
        tried=tuple(_attempt(attempt) for attempt in found.tried),
    )


def mirror_correction(correction: Attempt) -> Attempt:
    """Return what was corrected."""
    return _attempt(correction)


def _attempt(attempt: T) -> T:
    sign = -1.0 if attempt.hypothesis.is_odd else 1.0
    return replace(attempt, estimate=sign * attempt.estimate + 0.0)


def _cause(cause: Cause) -> Cause:
    return replace(_attempt(cause), residual_mrad=-cause.residual_mrad + 0.0)
