"""A check standard: targets of certified length or depth, measured between calibrations.

A calibration is rare and a rig may be knocked any day. Whoever measures the same standard each
morning sees it: ILAC-G24:2022 / OIML D 10, method 4 (in-service checking). All measurements use one
calibration, so its error is common to all of them: what is charted is what changes, against the
uncertainty of the readings alone, and whether the standard agrees with its certificate is a
question of its own, answered with everything.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.history.certified import CertifiedDepth, CertifiedLength, Standard
from calib.history.quantities import Series
from calib.history.sessions import ReadingSession, read_sessions
from calib.instrument.calibration_file import Measuring
from calib.instrument.measuring import Measured
from calib.uncertainty.charts import Chart, charts, reference

COVERAGE = 1.96
"""Of the 95 % intervals that a deviation from the certificate is held against."""


@dataclass(frozen=True)
class Checked:
    """A standard measured again and again with one calibration; q quantities, n sessions.

    Parameters
    ----------
    names, dates
        Of quantities and sessions.
    values
        As measured, mm, shape (n, q).
    readings
        Covariance of the quantities of a session by its readings alone, shape (n, q, q), mm^2.
    std
        Standard uncertainty with everything but the certificate's own, shape (n, q).
    certified, u_certified
        Values on the certificate and their standard uncertainties, shape (q,).
    standard
        What is measured.
    targets_mm
        Where its targets were measured, in the order of `Standard.targets`, shape (n, t, 3).
    theta
        Parameters of the calibration, as `calib.geometry.parameters` orders them.
    """

    names: tuple[str, ...]
    dates: tuple[str, ...]
    values: FloatArray
    readings: FloatArray
    std: FloatArray
    certified: FloatArray
    u_certified: FloatArray
    standard: Standard
    targets_mm: FloatArray
    theta: FloatArray

    @property
    def normalised(self) -> FloatArray:
        """Deviations from the certificate over the 95 % uncertainty of the two, shape (n, q)."""
        expanded = COVERAGE * np.hypot(self.std, self.u_certified)
        found: FloatArray = (self.values - self.certified) / expanded
        return found

    def series(self) -> tuple[Series, ...]:
        """Return the quantities over time, with the uncertainty of their readings."""
        std = np.sqrt(np.diagonal(self.readings, axis1=1, axis2=2))
        return tuple(
            Series(name, "mm", self.dates, self.values[:, k], std[:, k])
            for k, name in enumerate(self.names)
        )


SINGULAR = 1e-9
"""Smallest ratio of eigenvalues of what is not linearly dependent."""


def check_standard(measuring: Measuring, standard: Standard, text: str, *, name: str) -> Checked:
    """Return what a calibration makes of the readings of a standard.

    Parameters
    ----------
    text
        A table with the columns of `calib measure` (``id`` is the target) and ``date``; targets
        read at one date are one session.
    name
        Of the table, for messages.

    Raises
    ------
    InputError
        If the table is none, a reading cannot be measured, or a session lacks a target.
    """
    read = read_sessions(measuring, standard, text, name=name)
    found = [_quantities(measured, standard, one) for measured, one in read]
    certified = [
        (q.length_mm if isinstance(q, CertifiedLength) else q.z_mm, q.u_mm)
        for q in standard.quantities
    ]
    return Checked(
        names=tuple(q.name for q in standard.quantities),
        dates=tuple(one.date for _, one in read),
        values=np.array([values for values, _, _ in found]),
        readings=np.array([readings for _, readings, _ in found]),
        std=np.array([std for _, _, std in found]),
        certified=np.array([value for value, _ in certified]),
        u_certified=np.array([u for _, u in certified]),
        standard=standard,
        targets_mm=np.array(
            [[measured.position_mm[one.at[n]] for n in standard.targets] for measured, one in read]
        ),
        theta=measuring.instrument.theta,
    )


def chart_all(checked: Checked, *, accepted: int) -> tuple[tuple[Chart, ...], ...]:
    """Return the charts of each quantity, of the sessions after acceptance, if there are any."""
    if len(checked.dates) <= accepted:
        return ((),) * len(checked.names)
    found = []
    for one in checked.series():
        at = reference(one.values[:accepted], one.std[:accepted])
        found.append(charts(one.values[accepted:], one.std[accepted:], at))
    return tuple(found)


def lasting(outside: BoolArray) -> int | None:
    """Return since when a chart is outside without a break up to the last value; None if not."""
    inside = np.flatnonzero(~outside)
    since = int(inside[-1]) + 1 if len(inside) else 0
    return since if since < len(outside) else None


def degrees_of_freedom(checked: Checked) -> int:
    """Return of how much the quantities tell independently: some lengths follow from others."""
    return int(np.linalg.matrix_rank(checked.readings[0], rtol=SINGULAR, hermitian=True))


def inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverse, of what is linearly dependent the pseudo-inverse."""
    return np.asarray(np.linalg.pinv(matrices, rcond=SINGULAR, hermitian=True), dtype=np.float64)


def mean_of(checked: Checked, of: slice) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean of sessions and its covariance by the readings."""
    weights = inverse(checked.readings[of])
    covariance = inverse(weights.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", weights, checked.values[of]), covariance


def _quantities(
    measured: Measured, standard: Standard, session: ReadingSession
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, their covariance by readings alone, and their whole standard uncertainty."""
    by_reading, by_common = [], []
    own = measured.by_depth_row.shape[2]
    place = {target: k for k, target in enumerate(standard.targets)}
    for quantity in standard.quantities:
        row = np.zeros((len(place), own))
        if isinstance(quantity, CertifiedDepth):
            at = session.at[quantity.target]
            row[place[quantity.target]] = measured.by_depth_row[at, 2]
            common = measured.by_common[at, 2]
        else:
            start, end = (session.at[target] for target in quantity.between)
            across = measured.position_mm[end] - measured.position_mm[start]
            along: FloatArray = across / float(np.linalg.norm(across))
            for target, at, sign in zip(quantity.between, (start, end), (-1, 1), strict=True):
                row[place[target]] = sign * (along @ measured.by_depth_row[at])
            common = along @ (measured.by_common[end] - measured.by_common[start])
        by_reading.append(row.ravel())
        by_common.append(common)
    sensitivities, shared = np.array(by_reading), np.array(by_common)
    readings = sensitivities @ sensitivities.T
    common = np.diag(shared @ measured.common @ shared.T)
    values = values_of(measured.position_mm, standard, session.at)
    return values, readings, np.sqrt(np.diag(readings) + common)


def values_of(position_mm: FloatArray, standard: Standard, at: Mapping[str, int]) -> FloatArray:
    """Return the certified quantities, mm, shape (q,), of targets whose places are given."""
    found = []
    for quantity in standard.quantities:
        if isinstance(quantity, CertifiedDepth):
            found.append(position_mm[at[quantity.target], 2])
        else:
            start, end = (position_mm[at[target]] for target in quantity.between)
            found.append(np.linalg.norm(end - start))
    return np.array(found)
