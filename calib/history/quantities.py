"""What is charted of a rig: quantities that the rows identify, one series each.

L_b and e by themselves are left out, as the prior decides how their sum is shared. A depth is what
the calibration makes of one fixed reading, that of a target straight ahead of C1 at the distance
under the first calibration; so it moves with the parameters alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import Gaze, drawn_planes, gaze_at
from calib.history.entry import IndexEntry

DISTANCES = 3
"""Depths charted: the ends and the middle of what the first calibration covers."""

STEP = 1e-3
"""Of the differences by which depths are differentiated, in standard uncertainties: the error is
of the order of its square."""


@dataclass(frozen=True)
class Series:
    """One quantity of one rig over time.

    Parameters
    ----------
    name, unit
        As printed.
    dates
        ISO 8601, shape (n,).
    values, std
        With standard uncertainties, shape (n,).
    """

    name: str
    unit: str
    dates: tuple[str, ...]
    values: FloatArray
    std: FloatArray


def series(entries: Sequence[IndexEntry]) -> tuple[Series, ...]:
    """Return the charted quantities of a rig's calibrations, in time order.

    Under another model delta2 and axis_z mean something else: theirs are only of calibrations
    with the model of the first.
    """
    alike = [e for e in entries if e.model == entries[0].model]
    found = [_linear(entries, "effective baseline", "mm", ("baseline_mm", "eccentricity_mm"))]
    for name, unit in (("delta2_rad", "rad"), ("axis_z_mm", "mm")):
        if name in entries[0].names:
            found.append(_linear(alike, name.rpartition("_")[0], unit, (name,)))
    return (*found, *_depths(entries))


def _linear(entries: Sequence[IndexEntry], name: str, unit: str, of: tuple[str, ...]) -> Series:
    values, std = [], []
    for e in entries:
        pick = np.array([float(n in of) for n in e.names])
        values.append(float(pick @ e.values))
        std.append(float(np.sqrt(pick @ e.covariance @ pick)))
    return Series(name, unit, _dates(entries), np.array(values), np.array(std))


def _depths(entries: Sequence[IndexEntry]) -> list[Series]:
    z = np.linspace(*entries[0].range_mm, DISTANCES)
    gaze = gaze_at(_theta(entries[0]), np.column_stack([np.zeros((DISTANCES, 2)), z]))
    values, std = np.empty((len(entries), DISTANCES)), np.empty((len(entries), DISTANCES))
    alike: dict[tuple[str, ...], list[int]] = {}
    for i, e in enumerate(entries):
        alike.setdefault(e.names, []).append(i)
    for places in alike.values():
        values[places], std[places] = _depths_of([entries[i] for i in places], gaze)
    return [
        Series(f"depth at {at:.0f} mm", "mm", _dates(entries), values[:, k], std[:, k])
        for k, at in enumerate(z)
    ]


def _depths_of(entries: Sequence[IndexEntry], gaze: Gaze) -> tuple[FloatArray, FloatArray]:
    """Return depths of readings and their standard uncertainties, shape (n, q) each.

    Of calibrations with the same free parameters, all together: one by one they would take the
    most time of a fleet's page.
    """
    theta = np.array([_theta(e) for e in entries])
    covariance = np.array([e.covariance for e in entries])
    step = STEP * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    slope = np.empty((len(entries), len(gaze), step.shape[1]))
    for k, name in enumerate(entries[0].names):
        ends = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[:, INDEX[name]] += sign * step[:, k]
            ends.append(_depths_under(moved, gaze))
        slope[:, :, k] = (ends[0] - ends[1]) / (2 * step[:, None, k])
    variance = np.einsum("nqi,nij,nqj->nq", slope, covariance, slope)
    return _depths_under(theta, gaze), np.sqrt(variance)


def _depths_under(theta: FloatArray, gaze: Gaze) -> FloatArray:
    """Return depths, mm, of q readings under n parameter vectors, shape (n, q)."""
    planes = drawn_planes(theta)
    found = []
    for i in range(len(gaze)):
        parts = (gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual)
        found.append(planes.depth(Gaze(*(np.full(len(theta), part[i]) for part in parts))))
    return np.stack(found, axis=1)


def _theta(e: IndexEntry) -> FloatArray:
    return vector(dict(zip(e.names, e.values.tolist(), strict=True)))


def _dates(entries: Sequence[IndexEntry]) -> tuple[str, ...]:
    return tuple(e.date for e in entries)
