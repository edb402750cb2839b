"""Checks and diagnosed causes, for calibration.json."""

from __future__ import annotations

from collections.abc import Iterable

from calib.core.gate import Gate
from calib.diagnosis.findings import Attempt, Diagnosis
from calib.document.findings import CausePart, CorrectionPart, GatePart


def gates(checks: Iterable[Gate]) -> tuple[GatePart, ...]:
    """Return the outcomes of checks; a comparison by numpy gives numpy's own truth."""
    return tuple(GatePart(name=g.name, passed=bool(g.passed), detail=g.detail) for g in checks)


def causes(found: Diagnosis) -> tuple[CausePart, ...]:
    """Return the causes named, best first."""
    return tuple(
        CausePart(
            cause=cause.name,
            at=cause.at,
            seen_in=cause.seen_in,
            estimate=cause.estimate,
            std=cause.std,
            unit=cause.hypothesis.unit,
            gain=cause.gain,
            noise_scale=cause.noise_scale,
            depth_change_over_u=cause.effect,
            in_model=cause.is_carried,
            text=cause.text,
            remedy=cause.hypothesis.remedy,
            fits_as_well=tuple(found.others(cause)),
            told_apart_by=cause.hypothesis.tells,
            beside=cause.beside,
        )
        for cause in found.causes
    )


def correction(cause: Attempt) -> CorrectionPart:
    """Return a cause that was accepted, with its estimate."""
    return CorrectionPart(
        cause=cause.name,
        at=cause.at,
        estimate=cause.estimate,
        std=cause.std,
        unit=cause.hypothesis.unit,
        text=cause.text,
    )
