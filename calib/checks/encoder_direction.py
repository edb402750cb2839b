"""Does the rig turn and stand as the frame says? Recognises a wrong sign before it is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class _Fit:
    """The best start on rows: its log likelihood, baseline, mm, and encoder zero, rad."""

    density: float
    baseline: float
    delta2: float

    @classmethod
    def of(cls, rows: Observations) -> _Fit:
        theta = find_start(rows, axis_z=True)
        standardised = misclosure_value(theta, rows.gaze, rows.z_mm) / row_noise(theta, rows).sigma
        density = float(log_density(standardised[:, None], SCALE_GRID[None]).sum(axis=0).max())
        return cls(density, float(theta[INDEX["baseline_mm"]]), float(theta[INDEX["delta2_rad"]]))

    @property
    def plausible(self) -> bool:
        """Whether the zero is one that a rig may have."""
        return abs(self.delta2) < PLAUSIBLE_ZERO_RAD

    def words(self, sign: float) -> str:
        """Return the figures in the rig's own frame, of which this may be the mirror image."""
        return (
            f"L_b = {sign * self.baseline:.1f} mm, delta2 = {sign * np.rad2deg(self.delta2):.2f} "
            f"deg, log likelihood {self.density:.1f}"
        )


def check_encoder_direction(rows: Observations, *, is_left: bool = False) -> Gate:
    """Return whether encoder and baseline have the signs of the frame.

    The encoder counts from -X towards +Z, and C2 stands on the side that is stated. Rows fit either
    as read or with the encoder reversed, and with a baseline on either side. As read and on the
    other side, C2 stands there, or C1 and C2 are swapped. Reversed and on this side, the encoder
    counts the wrong way round. Reversed and on the other side, x1c is mirrored, or C2 stands there
    and the encoder counts the wrong way round: rows cannot tell the two.

    Parameters
    ----------
    rows
        The rig's; with `is_left` those of its mirror image, in which C2 stands at +X.
    is_left
        Whether C2 stands at -X of C1.
    """
    name, rows = "encoder-direction", some_rows(rows)
    reversed_rows = replace(
        rows, alpha2_rad=np.pi - rows.alpha2_rad, gaze_residual_rad=-rows.gaze_residual_rad
    )
    try:
        read = _Fit.of(rows)
    except EstimationError as error:
        return Gate(name, passed=False, detail=str(error))
    try:
        turned = _Fit.of(reversed_rows)
    except EstimationError:
        turned = _Fit(-np.inf, 0.0, 0.0)
    sign = -1.0 if is_left else 1.0
    figures = f"as read {read.words(sign)}; with the encoder reversed {turned.words(sign)}"
    fault = _fault(read, turned, is_left=is_left)
    if fault is None:
        return Gate(name, passed=True, detail=figures)
    what, remedy = fault
    return Gate(name, passed=False, detail=f"{what}: {figures}; {remedy}")


def _fault(read: _Fit, turned: _Fit, *, is_left: bool) -> tuple[str, str] | None:
    """Return what is wrong and its remedy; None if the signs are as stated."""
    here, there = ("-X", "+X") if is_left else ("+X", "-X")
    other = "right" if is_left else "left"
    fits = read.plausible and read.baseline > 0
    decisive = turned.density > read.density + DECISIVE
    if turned.plausible and turned.baseline > 0 and (decisive or not fits):
        return (
            "the encoder counts the wrong way round",
            "give 180 deg less the reading as alpha2_deg",
        )
    if turned.plausible and turned.baseline < 0 and decisive:
        return (
            "x1c has the wrong sign",
            "X of C1 counts to the right: are C1's pictures mirrored? Or, if C2 stands on the "
            f'{other} of C1, write c2 = "{other}" in [rig] and give 180 deg less the reading as '
            "alpha2_deg",
        )
    if read.baseline <= 0:
        return (
            f"C2 stands at {there} of C1, not at {here}",
            f'if it does, write c2 = "{other}" in [rig]; if not, C1 and C2 are swapped, or x1c '
            "and alpha2 both have the wrong sign",
        )
    return None
