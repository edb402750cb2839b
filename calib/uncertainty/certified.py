"""Stage: the depths a certificate states, each at the least certain ray of the field."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.errors import EstimationError
from calib.uncertainty.conformity import (
    Conformity,
    ToleranceRule,
    measured_conformity,
    predicted_conformity,
)
from calib.uncertainty.depth import (
    DepthUncertainty,
    PointUncertainty,
    PositionUncertainty,
    least_certain,
    point_uncertainties,
)
from calib.uncertainty.measurement import Instrument, Reading
from calib.uncertainty.montecarlo import NORMAL_FACTOR

CERTIFIED_DEPTHS = 5
"""Depths a certificate states, from the nearest to the farthest calibrated: three at least."""


@dataclass(frozen=True)
class CertifiedDepth:
    """A depth with all that a certificate says of it.

    Parameters
    ----------
    result, position
        Uncertainty of depth and of position.
    conformity
        None without a tolerance.
    extrapolated
        Whether the depth lies outside the calibrated ones.
    """

    result: DepthUncertainty
    position: PositionUncertainty
    conformity: Conformity | None
    extrapolated: bool


@dataclass(frozen=True)
class CheckedDepth:
    """A measured depth against a reference that took no part in the calibration.

    Parameters
    ----------
    name
        Of the row.
    reference_mm, u_reference_mm
        Reference depth with its standard uncertainty.
    z_mm, u_mm, low95_mm, high95_mm
        Measured depth, standard uncertainty (infinite where there is none), 95 % interval.
    conformity
        Of the error; None without a tolerance.
    extrapolated
        Whether the reference lies outside the calibrated depths.
    """

    name: str
    reference_mm: float
    u_reference_mm: float
    z_mm: float
    u_mm: float
    low95_mm: float
    high95_mm: float
    conformity: Conformity | None
    extrapolated: bool

    @property
    def allowed_mm(self) -> float:
        """The error's own 95 % uncertainty on its side, reference included."""
        above = self.z_mm > self.reference_mm
        side = self.z_mm - self.low95_mm if above else self.high95_mm - self.z_mm
        return math.hypot(side, NORMAL_FACTOR * self.u_reference_mm)

    @property
    def consistent(self) -> bool:
        """Whether the error lies within its own 95 % uncertainty, reference included."""
        return abs(self.z_mm - self.reference_mm) <= self.allowed_mm


def depths_to_certify(low_mm: float, high_mm: float) -> tuple[float, ...]:
    """Return round depths from `low_mm` to `high_mm`, all inside, `CERTIFIED_DEPTHS` of them."""
    span = high_mm - low_mm
    if span <= 0:
        return (low_mm,)
    # Round to a twentieth of the range or finer: the ends come near those of the calibration.
    step = 10.0 ** math.floor(math.log10(span / 20))
    first, last = math.ceil(low_mm / step), math.floor(high_mm / step)
    places = np.linspace(first, last, CERTIFIED_DEPTHS).round()
    return tuple(float(place * step) for place in dict.fromkeys(places.tolist()))


def certify_depths(
    instrument: Instrument,
    rays: Sequence[Sequence[Reading]],
    rng: np.random.Generator,
    *,
    calibrated_mm: tuple[float, float],
    tolerance: ToleranceRule | None,
) -> tuple[CertifiedDepth | EstimationError, ...]:
    """Return what a certificate says of depths, each at the least certain of its rays.

    In place of a depth so uncertain that it has no upper limit stands the error.

    Parameters
    ----------
    rays
        For each depth, readings of points there over the field of view.
    calibrated_mm
        Least and greatest depth of the calibration.
    tolerance
        None where the manifest states none.
    """
    readings = [least_certain(instrument, some) for some in rays]
    return tuple(
        found
        if isinstance(found, EstimationError)
        else _certified(found, calibrated_mm=calibrated_mm, tolerance=tolerance)
        for found in point_uncertainties(instrument, readings, rng)
    )


def _certified(
    point: PointUncertainty, *, calibrated_mm: tuple[float, float], tolerance: ToleranceRule | None
) -> CertifiedDepth:
    conformity = None
    if tolerance is not None:
        conformity = predicted_conformity(point.depth, point.draws, tolerance=tolerance)
    return CertifiedDepth(
        result=point.depth,
        position=point.position,
        conformity=conformity,
        extrapolated=_outside(point.depth.z_mm, calibrated_mm),
    )


def check_depth(
    *,
    name: str,
    reference_mm: float,
    u_reference_mm: float,
    z_mm: float,
    u_mm: float,
    low95_mm: float,
    high95_mm: float,
    calibrated_mm: tuple[float, float],
    tolerance: ToleranceRule | None,
) -> CheckedDepth:
    """Return a measured depth against its reference, with the statement of conformity."""
    conformity = None
    if tolerance is not None:
        conformity = measured_conformity(
            z_mm=z_mm,
            u_mm=u_mm,
            low95_mm=low95_mm,
            high95_mm=high95_mm,
            reference_mm=reference_mm,
            u_reference_mm=u_reference_mm,
            tolerance=tolerance,
        )
    return CheckedDepth(
        name=name,
        reference_mm=reference_mm,
        u_reference_mm=u_reference_mm,
        z_mm=z_mm,
        u_mm=u_mm,
        low95_mm=low95_mm,
        high95_mm=high95_mm,
        conformity=conformity,
        extrapolated=_outside(reference_mm, calibrated_mm),
    )


def _outside(z_mm: float, calibrated_mm: tuple[float, float]) -> bool:
    low, high = calibrated_mm
    # The ends of the range are calibrated depths themselves, whatever their last bit.
    slack = 1e-9 * high
    return not low - slack <= z_mm <= high + slack
