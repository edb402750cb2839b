"""What the rows can tell of each model, as it stands in calibration.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calib.fit.identifiability import Combination, Identifiability


def identifiability_document(told: Mapping[str, Identifiability]) -> dict[str, Any]:
    """Return what the rows can tell of each model."""
    return {model: _model(found) for model, found in told.items()}


def _model(found: Identifiability) -> dict[str, Any]:
    """Return what the rows can tell of a model; what is infinite is left out."""
    columns = {
        "known_beforehand": found.scale,
        "std_rows": found.rows_std,
        "std_rows_and_sweep": found.sweep_std if found.has_sweep else None,
        "std": found.std,
        "decided_by": found.decided_by,
    }
    return {
        "names": list(found.names),
        "parameters": {
            name: {key: column[i] for key, column in columns.items() if column is not None}
            for i, name in enumerate(found.names)
        },
        "combinations": [_combination(found, c) for c in found.combinations],
        "correlation": found.correlation,
        "condition": found.condition,
        "depth_std_rel": found.depth_std_rel,
    }


def _combination(found: Identifiability, c: Combination) -> dict[str, Any]:
    document: dict[str, Any] = {
        "direction": dict(zip(found.names, c.direction, strict=True)),
        "singular_value": c.singular_value,
        "std_rows": c.std,
        "std_rows_and_sweep": c.std_with_sweep if found.has_sweep else None,
        "std": c.std_with_priors,
        "told_by": c.told_by,
    }
    return document | ({"words": c.words} if c.words else {})
