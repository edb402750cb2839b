"""Does the rig turn and stand as the frame says? Recognises a wrong sign before it is fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.errors import EstimationError
from calib.core.gate import Gate
from calib.fit.noise import log_density, row_noise
from calib.fit.start import SCALE_GRID, find_start, some_rows
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import INDEX
from calib.rows.observations import Observations

DECISIVE = 5.0
"""Log likelihood a row-independent fit must gain to call a sign wrong: odds of 150 to 1."""

PLAUSIBLE_ZERO_RAD = float(np.deg2rad(20.0))
"""Encoder zeros beyond this are reference marks on the wrong side, not errors."""


def _score(rows: Observations) -> tuple[float, float, float]:
    """Return the log likelihood of the best start, its baseline, mm, and encoder zero, rad."""
    theta = find_start(rows, axis_z=True)
    standardised = misclosure_value(theta, rows.gaze, rows.z_mm) / row_noise(theta, rows).sigma
    density = float(log_density(standardised[:, None], SCALE_GRID[None]).sum(axis=0).max())
    return density, float(theta[INDEX["baseline_mm"]]), float(theta[INDEX["delta2_rad"]])


def _plausible(baseline: float, delta2: float) -> bool:
    return baseline > 0 and abs(delta2) < PLAUSIBLE_ZERO_RAD


def check_encoder_direction(rows: Observations) -> Gate:
    """Return whether encoder and baseline have the signs of the frame.

    The encoder counts from -X towards +Z and C2 stands at +X. If the mirrored encoder explains the
    rows far better, or only it with a baseline above 0, its sign is wrong; if a baseline below 0
    explains them, C1 and C2 are swapped or the images mirrored.
    """
    name, rows = "encoder-direction", some_rows(rows)
    mirrored = replace(
        rows, alpha2_rad=np.pi - rows.alpha2_rad, gaze_residual_rad=-rows.gaze_residual_rad
    )
    try:
        score, baseline, delta2 = _score(rows)
    except EstimationError as error:
        return Gate(name, passed=False, detail=str(error))
    try:
        other, other_baseline, other_delta2 = _score(mirrored)
    except EstimationError:
        other, other_baseline, other_delta2 = -np.inf, 0.0, 0.0
    figures = (
        f"as read L_b = {baseline:.1f} mm, delta2 = {np.rad2deg(delta2):.2f} deg, log likelihood "
        f"{score:.1f}; with the encoder reversed L_b = {other_baseline:.1f} mm, delta2 = "
        f"{np.rad2deg(other_delta2):.2f} deg, log likelihood {other:.1f}"
    )
    fits, other_fits = _plausible(baseline, delta2), _plausible(other_baseline, other_delta2)
    if other_fits and (other > score + DECISIVE or not fits):
        return Gate(
            name,
            passed=False,
            detail=f"the encoder counts the wrong way round: {figures}; "
            "give 180 deg less the reading as alpha2_deg",
        )
    if baseline <= 0:
        return Gate(
            name,
            passed=False,
            detail=f"the baseline is negative: {figures}; C2 must stand at +X of C1: "
            "are C1 and C2 swapped, or is x1c mirrored?",
        )
    return Gate(name, passed=True, detail=figures)
