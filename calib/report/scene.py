"""The rig in three dimensions, for the page's script to draw and turn: numbers only."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import INDEX
from calib.geometry.plane import frame
from calib.report.plotting import thinned
from calib.rows.observations import Observations
from calib.uncertainty.certified import CertifiedDepth

TARGETS = 80
"""Targets drawn at most; more hide each other."""


def scene_data(rows: Observations, theta: FloatArray, depths: Sequence[CertifiedDepth]) -> str:
    """Return the scene as JSON: lengths in mm, frame C1.

    Parameters
    ----------
    rows
        Calibration rows.
    theta
        The selected model, shape (COUNT,).
    depths
        Certified depths, with their 95 % ellipsoids.
    """
    parts = frame(theta)
    picked = thinned(len(rows), TARGETS)
    z = rows.z_mm + theta[INDEX["reference_offset_mm"]]
    points = np.stack([rows.x1c * z, rows.y1c * z, z], axis=1)
    return json.dumps(
        {
            "axis": {"point": _mm(parts.point), "direction": _mm(parts.rotation[:, 1], 6)},
            "targets": [{"name": rows.ids[i], "at": _mm(points[i])} for i in picked],
            "ellipsoids": [
                {
                    "at": _mm(d.position.position_mm),
                    # Half axes as vectors, longest first.
                    "axes": [_mm(a) for a in (d.position.directions * d.position.semi_axes_mm).T],
                }
                for d in depths
            ],
        },
        ensure_ascii=False,
        separators=(",", ":"),
    )


def _mm(vector: FloatArray, digits: int = 3) -> list[float]:
    return [round(float(v), digits) + 0.0 for v in vector]
