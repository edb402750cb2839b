"""Diagnosed causes, for calibration.json."""

from __future__ import annotations

from calib.diagnosis.engine import Attempt, Diagnosis
from calib.document.findings import CausePart, CorrectionPart


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
