"""Rigs on which every parameter of the table is off neutral, a new one too."""

from __future__ import annotations

import numpy as np

from calib.geometry.parameters import PARAMETERS, vector

SIZE = {"mm": 8.0, "rad": 0.03, "1": 0.02}


def general_rig() -> np.ndarray:
    """Return such a rig: a baseline of 80 mm, the others of the sizes above, with either sign."""
    share = 0.6 + 0.4 * np.cos(np.arange(len(PARAMETERS)))
    others = {
        p.name: (-1) ** i * share[i] * SIZE[p.unit] for i, p in enumerate(PARAMETERS) if i > 0
    }
    return vector({**others, "baseline_mm": 80.0})
