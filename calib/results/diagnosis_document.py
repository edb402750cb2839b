"""Diagnosed causes, for calibration.json."""

from __future__ import annotations

from typing import Any

from calib.diagnosis.engine import Attempt, Diagnosis


def diagnosis_document(found: Diagnosis) -> list[dict[str, Any]]:
    """Return the causes named, best first."""
    return [
        {
            "cause": cause.name,
            "at": cause.at,
            "seen_in": cause.seen_in,
            "estimate": cause.estimate,
            "std": cause.std,
            "unit": cause.hypothesis.unit,
            "gain": cause.gain,
            "noise_scale": list(cause.noise_scale),
            "depth_change_over_u": cause.effect,
            "in_model": cause.is_carried,
            "text": cause.text,
            "remedy": cause.hypothesis.remedy,
            "fits_as_well": list(found.others(cause)),
            "told_apart_by": cause.hypothesis.tells,
        }
        for cause in found.causes
    ]


def correction_document(cause: Attempt) -> dict[str, Any]:
    """Return a cause that was accepted, with its estimate."""
    return {
        "cause": cause.name,
        "at": cause.at,
        "estimate": cause.estimate,
        "std": cause.std,
        "unit": cause.hypothesis.unit,
        "text": cause.text,
    }
