"""What the rows can tell of each model, as it stands in calibration.json."""

from __future__ import annotations

from calib.document import identifiability as document
from calib.document.part import matrix
from calib.fit.identifiability import Combination, Identifiability


def identifiability(found: Identifiability) -> document.Identifiability:
    """Return what the rows can tell of a model."""
    return document.Identifiability(
        names=found.names,
        parameters={
            name: document.Known(
                known_beforehand=float(found.scale[i]),
                std_rows=float(found.rows_std[i]),
                std_rows_and_sweep=float(found.sweep_std[i]) if found.has_sweep else None,
                std=float(found.std[i]),
                decided_by=found.decided_by[i],
            )
            for i, name in enumerate(found.names)
        },
        combinations=tuple(_combination(found, c) for c in found.combinations),
        correlation=matrix(found.correlation),
        condition=found.condition,
        depth_std_rel=found.depth_std_rel,
    )


def _combination(found: Identifiability, c: Combination) -> document.Combination:
    return document.Combination(
        direction=dict(zip(found.names, c.direction.tolist(), strict=True)),
        singular_value=c.singular_value,
        std_rows=c.std,
        std_rows_and_sweep=c.std_with_sweep if found.has_sweep else None,
        std=c.std_with_priors,
        told_by=c.told_by,
        words=c.words or None,
    )
