"""Diagnosed causes, back from the mirror."""

from __future__ import annotations

from dataclasses import replace

from calib.diagnosis.engine import Cause, Diagnosis


def mirror_diagnosis(found: Diagnosis) -> Diagnosis:
    """Return the causes: what is read and where targets are across changes its sign."""
    return replace(found, causes=tuple(_cause(cause) for cause in found.causes))


def _cause(cause: Cause) -> Cause:
    sign = -1.0 if cause.hypothesis.is_odd else 1.0
    return replace(
        cause,
        estimate=sign * cause.estimate + 0.0,
        residual_mrad=-cause.residual_mrad + 0.0,
    )
