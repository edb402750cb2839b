"""Stage: what independent references say of mistakes that calibration rows cannot show.

A scale that all calibration references have in common goes into the baseline and leaves no trace in
the rows. Depths and lengths that were not used to fit show it; but so they show a zero that moved
between the two tables, and references that count from another place. The three are compared by
their marginal likelihoods: measured less reference is normal with the covariance of calibration,
readings and references, and each mistake adds one linear term with a normal prior (Kass and Raftery
1995, doi 10.1080/01621459.1995.10476572). What the calibration itself leaves uncertain explains no
less than a mistake does, so that over a narrow range of depths none is named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from calib.core.arrays import FloatArray, IntArray
from calib.dataset.tables import LengthTable
from calib.diagnosis.engine import AS_GOOD
from calib.diagnosis.findings import Attempt, Cause, Diagnosis
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.fit.priors import NOISE_SCALE_PRIOR
from calib.fit.robust import RobustFit
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibrated import CalibratedInstrument, DepthTable
from calib.instrument.validation import reference_std
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations

LEAST = 3
"""Independent depths and lengths from which mistakes are told by them."""

LEAST_GAIN = 2.0
"""Evidence from which a mistake is named, nats."""

MOST_ROWS = 200
"""Validation rows looked at: of a longer table so many, evenly."""

SCALES = np.linspace(-3.0, 4.0, 57)
"""Logarithms of the noise scale over which evidence is summed."""


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


_MISTAKES: tuple[tuple[str, Callable[[Differences], FloatArray]], ...] = (
    ("reference-scale", lambda d: d.by_scale),
    ("reading-step", lambda d: d.by_zero),
    ("reference-offset", lambda d: d.by_origin),
)
"""Mistakes by name, and what a unit of each adds to measured less reference."""


def diagnose_references(
    found: Diagnosis,
    calibrated: CalibratedInstrument,
    fit: RobustFit,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None,
    depths: DepthTable,
) -> Diagnosis:
    """Return the diagnosis with what independent references add to it.

    Nothing where the rows themselves show a mistake that matters: an instrument that is calibrated
    by such rows contradicts every reference.

    Parameters
    ----------
    found
        The diagnosis by calibration rows.
    calibrated, fit
        The instrument and the robust fit of its model.
    rows, validation, lengths
        Calibration rows, and what was not used to fit; None without.
    depths
        Uncertainty of depth, against which effects are held.
    """
    if found.left_out is not None:
        return found
    seen = differences(calibrated, fit, rows, validation, lengths)
    if len(seen) < LEAST:
        return found
    trials = [_Trial.of(name, seen, by(seen)) for name, by in _MISTAKES]
    ranked = sorted((t for t in trials if t is not None), key=lambda t: -t.attempt.gain)
    if not ranked:
        return found
    least = max(LEAST_GAIN, ranked[0].attempt.gain - AS_GOOD)
    causes = tuple(t.cause(seen, depths) for t in ranked if t.attempt.gain >= least)
    return replace(
        found,
        causes=(*found.causes, *causes),
        tried=(*found.tried, *(t.attempt for t in ranked)),
    )


def differences(
    calibrated: CalibratedInstrument,
    fit: RobustFit,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None,
) -> Differences:
    """Return depths and lengths by the instrument less their references."""
    parts: list[Differences] = []
    if validation is not None:
        own = np.flatnonzero(validation.depth_of == np.arange(len(validation.rows)))
        own = own[np.isfinite(validation.depth_from_c1(fit.theta)[own])]
        if len(own) > MOST_ROWS:
            own = own[np.linspace(0, len(own) - 1, MOST_ROWS).astype(np.int64)]
        parts.append(_of_depths(calibrated, fit, validation, own))
    if lengths is not None:
        parts.append(_of_lengths(fit, rows, validation, lengths))
    return _joined([part for part in parts if len(part)])


def _of_depths(
    calibrated: CalibratedInstrument, fit: RobustFit, validation: ValidationRows, some: IntArray
) -> Differences:
    rows = validation.rows.take(some)
    points = _points(rows, fit)
    reference = validation.depth_from_c1(fit.theta)[some]
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
    fit: RobustFit, rows: Observations, validation: ValidationRows | None, lengths: LengthTable
) -> Differences:
    tables = [(rows, np.arange(len(rows)))]
    if validation is not None:
        tables.append((validation.rows, validation.depth_of))
    place: dict[str, tuple[int, int]] = {}
    points = []
    for number, (table, source) in enumerate(tables):
        points.append(_points(table, fit, source))
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


def _points(rows: Observations, fit: RobustFit, source: IntArray | None = None) -> _Points:
    """Return the points of rows, each with the depth of the row that `source` says."""
    used = rows if source is None else rows.take(source)
    at = depth_jacobian(fit.theta, used.gaze)
    names = [name for name in fit.names if name != REFERENCE_OFFSET]
    place = [fit.names.index(name) for name in names]
    by_shared = fit.by_shared[place]
    own = fit.covariance[np.ix_(place, place)] - by_shared @ by_shared.T
    values, vectors = np.linalg.eigh(own)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
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


@dataclass(frozen=True)
class _Trial:
    """A mistake tried on independent references."""

    attempt: Attempt
    push: FloatArray
    value: float
    scales: tuple[float, float]

    @classmethod
    def of(cls, name: str, seen: Differences, push: FloatArray) -> _Trial | None:
        """Return what comes of a mistake, its change per unit in `push`, shape (m,)."""
        hypothesis = HYPOTHESES[name]
        size = hypothesis.typical * hypothesis.per_unit
        without, with_it = _evidence(seen, None), _evidence(seen, push * size)
        if without is None or with_it is None:
            return None
        gain = with_it.log - without.log - float(np.log(len(_MISTAKES)))
        value, std = with_it.mean * size, with_it.std * size
        attempt = Attempt(
            name, None, value / hypothesis.per_unit, std / hypothesis.per_unit, gain,
            seen_in="references",
        )  # fmt: skip
        return cls(attempt, push, value, (without.scale, with_it.scale))

    def cause(self, seen: Differences, depths: DepthTable) -> Cause:
        """Return it as one that the references speak for."""
        moved = np.abs(self.push * self.value)
        of_depths = seen.by_origin > 0
        some = of_depths if of_depths.any() else np.ones(len(seen), dtype=np.bool_)
        u = np.interp(seen.by_scale[some], depths.depth_mm, depths.prediction.u_mm)
        before = seen.error_mm / seen.per_rad
        after = (seen.error_mm - self.push * self.value) / seen.per_rad
        a = self.attempt
        return Cause(
            a.name, a.at, a.estimate, a.std, a.gain, a.seen_in,
            noise_scale=self.scales,
            effect=float((moved[some] / u).max()),
            is_carried=False,
            ids=seen.ids,
            residual_mrad=1e3 * np.stack([before, after]),
        )  # fmt: skip


@dataclass(frozen=True)
class _Evidence:
    """Logarithm of a marginal likelihood, with the term's mean, std and the noise scale."""

    log: float
    mean: float
    std: float
    scale: float


def _evidence(seen: Differences, push: FloatArray | None) -> _Evidence | None:
    """Return the evidence with a term of unit variance, summed over the noise scale."""
    own = (seen.own**2).sum(axis=1)
    common = seen.by_common @ seen.by_common.T
    mean, std = NOISE_SCALE_PRIOR
    logs, means, variances = [], [], []
    for log_scale in SCALES:
        covariance = common + np.diag(np.exp(2 * log_scale) * own)
        try:
            factor = cho_factor(covariance)
        except LinAlgError:
            return None
        half = cho_solve(factor, seen.error_mm)
        log = -0.5 * seen.error_mm @ half - np.log(np.diag(factor[0])).sum()
        log -= 0.5 * ((log_scale - mean) / std) ** 2
        precision, shift = 1.0, 0.0
        if push is not None:
            information = float(push @ cho_solve(factor, push))
            precision, shift = 1.0 + information, float(push @ half)
            log += 0.5 * shift**2 / precision - 0.5 * np.log(precision)
        logs.append(float(log))
        means.append(shift / precision)
        variances.append(1 / precision)
    weights = np.exp(np.array(logs) - max(logs))
    total = float(weights.sum())
    weights /= total
    middle = float(weights @ np.array(means))
    spread = float(weights @ (np.array(variances) + (np.array(means) - middle) ** 2))
    scale = float(np.exp(weights @ SCALES))
    return _Evidence(max(logs) + float(np.log(total)), middle, float(np.sqrt(spread)), scale)
