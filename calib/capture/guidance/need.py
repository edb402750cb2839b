"""How well lenses, pairs and axis must be known for depths of a stated tolerance.

By errors alone that a gaze shows: a ray off by d rad moves a depth z at baseline b by z d / b in
parts of z. The standard uncertainty of a depth is to be a quarter of its tolerance (a test
uncertainty ratio of 4, as ANSI/NCSL Z540.3 asks of calibrations). Four parts share it alike, in
squares: C1's lens, C2's lens, the yaw axis with its encoder, the gaze rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

RATIO: Final = 4.0
PARTS: Final = 4

TOLERANCE: Final = 0.02
"""Where none is stated: active gazing is good to 1 to 8 % (Xu and Wang, Table 2)."""

NEAR_BASELINES, FAR_BASELINES = 5.0, 12.0
"""Depths in baselines where none are stated: those of Xu and Wang's Table 1."""

BASELINE_MM: Final = 200.0
"""Where nothing is stated at all."""


@dataclass(frozen=True)
class Need:
    """What a rig is to be calibrated for.

    Parameters
    ----------
    tolerance
        Of depth, in parts of it.
    depths_mm
        Nearest and farthest depth.
    baseline_mm
        By tape measure, positive.
    """

    tolerance: float = TOLERANCE
    depths_mm: tuple[float, float] = (NEAR_BASELINES * BASELINE_MM, FAR_BASELINES * BASELINE_MM)
    baseline_mm: float = BASELINE_MM

    @property
    def depth_share(self) -> float:
        """Standard uncertainty that depth may have by one part, in parts of it."""
        return float(self.tolerance / RATIO / PARTS**0.5)

    @property
    def pairs_share(self) -> float:
        """The same by pairs, which hold both lenses and the pose of C2: three of the parts."""
        return float(self.tolerance / RATIO * (3 / PARTS) ** 0.5)

    def lens_px(self, focal_px: float) -> float:
        """Return how well a lens is to project, px."""
        return self.depth_share * focal_px * self.baseline_mm / self.depths_mm[1]


def need_for(
    *, tolerance: float | None, depths_mm: tuple[float, float] | None, baseline_mm: float | None
) -> Need:
    """Return the need, of usual proportions as far as nothing is stated."""
    if baseline_mm is not None:
        baseline = abs(baseline_mm)
    else:
        baseline = BASELINE_MM if depths_mm is None else depths_mm[1] / FAR_BASELINES
    depths = depths_mm or (NEAR_BASELINES * baseline, FAR_BASELINES * baseline)
    return Need(TOLERANCE if tolerance is None else tolerance, depths, baseline)
