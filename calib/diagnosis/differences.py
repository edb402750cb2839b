"""What an instrument measures less independent references, linear in what is uncertain of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.unit_diagonal import Spectrum
from calib.dataset.tables import LengthTable
from calib.fit.robust import RobustFit
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibrated import CalibratedInstrument
from calib.instrument.validation import reference_std
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations

MOST_ROWS = 200
"""Validation rows looked at: of a longer table so many, evenly."""


@dataclass(frozen=True)
class Differences:
    """Measured less reference, linear in what is uncertain of it.

    Parameters
    ----------
    ids
        Of the depths and lengths, m of them.
    error_mm
        Measured less reference, shape (m,); of depths as their inverse has it.
    by_common
        Derivatives by common errors of unit variance: parameters, shared errors; shape (m, k).
    own
        Derivatives by independent errors of unit variance, shape (m, q).
    by_scale, by_zero, by_origin
        Change per unit of scale, per rad of zero, per mm of origin, shape (m,).
    per_rad
        Change per rad of a reading at that place, for residuals as angles, shape (m,).
    """

    ids: tuple[str, ...]
    error_mm: FloatArray
    by_common: FloatArray
    own: FloatArray
    by_scale: FloatArray
    by_zero: FloatArray
    by_origin: FloatArray
    per_rad: FloatArray

    def __len__(self) -> int:
        return len(self.error_mm)


def differences(
    calibrated: CalibratedInstrument,
    fit: RobustFit,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None,
    *,
    theta: FloatArray | None = None,
) -> Differences:
    """Return depths and lengths by the instrument less their references.

    Parameters
    ----------
    theta
        Parameters in place of those of the fit, shape (COUNT,).
    """
    at = fit.theta if theta is None else theta
    parts: list[Differences] = []
    if validation is not None:
        own = np.flatnonzero(validation.depth_of == np.arange(len(validation.rows)))
        own = own[np.isfinite(validation.depth_from_c1(at)[own])]
        if len(own) > MOST_ROWS:
            own = own[np.linspace(0, len(own) - 1, MOST_ROWS).astype(np.int64)]
        parts.append(_of_depths(calibrated, fit, at, validation, own))
    if lengths is not None:
        parts.append(_of_lengths(fit, at, rows, validation, lengths))
    return _joined([part for part in parts if len(part)])


def _of_depths(
    calibrated: CalibratedInstrument,
    fit: RobustFit,
    theta: FloatArray,
    validation: ValidationRows,
    some: IntArray,
) -> Differences:
    rows = validation.rows.take(some)
    points = _points(rows, fit, theta)
    reference = validation.depth_from_c1(theta)[some]
    u_reference = reference_std(calibrated, validation)[some]
    good = np.isfinite(points.z_mm) & (points.z_mm > 0)
    z = points.z_mm[good]
    # Inverse depth is linear in the zero and in a scale where depth is not: -z^2 (1/z - 1/z_ref).
    longer = z / reference[good]
    own = np.column_stack([points.by_own[good], longer**2 * u_reference[good]])
    return Differences(
        ids=tuple(name for name, kept in zip(rows.ids, good, strict=True) if kept),
        error_mm=longer * (z - reference[good]),
        by_common=points.by_common[good],
        own=own,
        by_scale=z,
        by_zero=points.by_zero[good],
        by_origin=longer,
        per_rad=np.abs(points.by_zero[good]),
    )


def _of_lengths(
    fit: RobustFit,
    theta: FloatArray,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable,
) -> Differences:
    tables = [(rows, np.arange(len(rows)))]
    if validation is not None:
        tables.append((validation.rows, validation.depth_of))
    place: dict[str, tuple[int, int]] = {}
    points = []
    for number, (table, source) in enumerate(tables):
        points.append(_points(table, fit, theta, source))
        place |= {name: (number, i) for i, name in enumerate(table.ids)}
    known = [
        k
        for k in np.flatnonzero(np.isfinite(lengths.length_mm))
        if lengths.start[k] in place and lengths.end[k] in place
    ]
    errors, common, own, scale, zero, ids = [], [], [], [], [], []
    for k in known:
        (at, i), (bt, j) = place[lengths.start[k]], place[lengths.end[k]]
        a, b = points[at], points[bt]
        line = a.ray[i] * a.z_mm[i] - b.ray[j] * b.z_mm[j]
        length = float(np.linalg.norm(line))
        if not (np.isfinite(length) and length > 0):
            continue
        by_a, by_b = float(line @ a.ray[i]) / length, -float(line @ b.ray[j]) / length
        errors.append(length - lengths.length_mm[k])
        common.append(by_a * a.by_common[i] + by_b * b.by_common[j])
        own.append(
            np.concatenate([by_a * a.by_own[i], by_b * b.by_own[j], [lengths.u_length_mm[k]]])
        )
        scale.append(length)
        zero.append(by_a * a.by_zero[i] + by_b * b.by_zero[j])
        ids.append(lengths.ids[k])
    if not errors:
        return _NOTHING
    by_zero = np.array(zero)
    return Differences(
        tuple(ids), np.array(errors), np.array(common), np.array(own), np.array(scale), by_zero,
        np.zeros(len(errors)), np.maximum(np.abs(by_zero), 1e-300),
    )  # fmt: skip


_NOTHING = Differences(
    (), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), *(np.zeros(0) for _ in range(4))
)


def _joined(parts: list[Differences]) -> Differences:
    if not parts:
        return _NOTHING
    width = max(part.own.shape[1] for part in parts)
    return Differences(
        ids=tuple(name for part in parts for name in part.ids),
        error_mm=np.concatenate([part.error_mm for part in parts]),
        by_common=np.concatenate([part.by_common for part in parts]),
        own=np.concatenate(
            [np.pad(part.own, ((0, 0), (0, width - part.own.shape[1]))) for part in parts]
        ),
        by_scale=np.concatenate([part.by_scale for part in parts]),
        by_zero=np.concatenate([part.by_zero for part in parts]),
        by_origin=np.concatenate([part.by_origin for part in parts]),
        per_rad=np.concatenate([part.per_rad for part in parts]),
    )


@dataclass(frozen=True)
class _Points:
    """Depths along rays, with their derivatives by errors of unit variance."""

    ray: FloatArray
    z_mm: FloatArray
    by_common: FloatArray
    by_own: FloatArray
    by_zero: FloatArray


def _points(
    rows: Observations, fit: RobustFit, theta: FloatArray, source: IntArray | None = None
) -> _Points:
    """Return the points of rows, each with the depth of the row that `source` says."""
    used = rows if source is None else rows.take(source)
    at = depth_jacobian(theta, used.gaze)
    names = [name for name in fit.names if name != REFERENCE_OFFSET]
    place = [fit.names.index(name) for name in names]
    by_shared = fit.by_shared[place]
    own = fit.covariance[np.ix_(place, place)] - by_shared @ by_shared.T
    root = Spectrum.of(own).root()
    by_theta = at.by_theta[:, [INDEX[name] for name in names]]
    # Parameters follow the errors that calibration rows share; later readings have them as well.
    through = by_theta @ by_shared
    if rows.shared_names and rows.shared_names == fit.shared_names[: len(rows.shared_names)]:
        count = len(rows.shared_names)
        shared = used.shared[:, : OBSERVABLE.z]
        through[:, :count] += np.einsum("nq,nqk->nk", at.by_observable, shared)
    by_common = np.hstack([by_theta @ root, through])
    by_own = at.by_observable * used.std[:, : OBSERVABLE.z] * fit.noise_scale
    ray = np.stack([rows.x1c, rows.y1c, np.ones(len(rows))], axis=1)
    return _Points(ray, at.z, by_common, by_own, at.by_theta[:, INDEX["delta2_rad"]])
