"""Stage: what the instrument measures on the validation rows, against each reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray, IntArray
from calib.fit.chains import Progress
from calib.fit.robust import RobustFit
from calib.geometry.plane import OBSERVABLE, depth
from calib.instrument.calibrated import CalibratedInstrument, origin_of
from calib.rows.from_table import (
    ValidationRows,
)
from calib.uncertainty.measurement import (
    with_standoff,
)
from calib.uncertainty.montecarlo import NORMAL_FACTOR
from calib.uncertainty.predictive import (
    DepthPrediction,
    predict_depths,
)


@dataclass(frozen=True)
class ReferenceAgreement:
    """Agreement of measured depths with one reference.

    Parameters
    ----------
    name
        "reference" for the first, else the name in the table.
    reference_mm, std_mm
        Its depths, shape (n,), NaN where a row has none, and their standard uncertainties, 0
        where none is stated.
    error_rel
        (measured - reference) / reference, shape (n,); NaN where a row has no such reference.
    rms_rel, mean_rel
        Over the rows that have it.
    """

    name: str
    reference_mm: FloatArray
    std_mm: FloatArray
    error_rel: FloatArray
    rms_rel: float
    mean_rel: float


@dataclass(frozen=True)
class ValidationResult:
    """What the instrument, and each other model, measures on the validation rows.

    Parameters
    ----------
    ids, groups
        Of the rows, n of them.
    depth_of
        For each row the place of the row whose depth it uses, shape (n,).
    reference_mm
        First reference depth, shape (n,).
    prediction
        Depth of each row, by the row whose depth it uses.
    position_mm
        x, y, z, shape (n, 3).
    own_depth_mm
        Depth by each row's own angle, by model, shape (n,) each.
    errors
        Against each reference.
    """

    ids: tuple[str, ...]
    groups: tuple[str, ...]
    depth_of: IntArray
    reference_mm: FloatArray
    prediction: DepthPrediction
    position_mm: FloatArray
    own_depth_mm: Mapping[str, FloatArray]
    errors: tuple[ReferenceAgreement, ...]


def measure_validation(
    calibrated: CalibratedInstrument,
    validation: ValidationRows,
    fits: Mapping[str, RobustFit],
    *,
    seed: SeedSequence,
    progress: Progress | None = None,
) -> ValidationResult:
    """Return what the instrument measures on the validation rows."""
    rows, source = validation.rows, validation.depth_of
    loadings = rows.shared[source, : OBSERVABLE.z] if rows.shared_names else None
    used, rng = rows.take(source), np.random.default_rng(seed)
    instrument = calibrated.instrument
    if used.off_centre:
        instrument = with_standoff(instrument, rng)
    prediction = predict_depths(
        instrument,
        used.gaze,
        rng,
        loadings=loadings,
        progress=progress,
    )
    z = prediction.z_mm
    reference = validation.depth_from_c1(calibrated.instrument.theta)
    first = _agreement_with("reference", z, reference, reference_std(calibrated, validation))
    others = [
        _agreement_with(name, z, depths, np.zeros(len(rows)))
        for name, depths in validation.references.items()
    ]
    return ValidationResult(
        ids=rows.ids,
        groups=rows.groups,
        depth_of=source,
        reference_mm=reference,
        prediction=prediction,
        position_mm=np.stack([rows.x1c * z, rows.y1c * z, z], axis=1),
        own_depth_mm={name: depth(fit.theta, rows.gaze) for name, fit in fits.items()},
        errors=(first, *others),
    )


def reference_std(calibrated: CalibratedInstrument, validation: ValidationRows) -> FloatArray:
    """Return standard uncertainties of validation references from C1's centre, mm, shape (n,).

    What is uncertain of where they count from is added as if depth did not depend on it: it does,
    by less than the offset itself, so that agreement is judged mildly.
    """
    own = validation.rows.std[:, OBSERVABLE.z]
    if not len(validation.same_origin):
        return own
    u_origin = origin_of(calibrated.instrument.parameters)[1]
    return np.where(validation.same_origin, np.hypot(own, u_origin), own)


def _agreement_with(
    name: str, z: FloatArray, reference: FloatArray, std: FloatArray
) -> ReferenceAgreement:
    error = z / reference - 1
    known = error[np.isfinite(error)]
    return ReferenceAgreement(
        name=name,
        reference_mm=reference,
        std_mm=std,
        error_rel=error,
        rms_rel=float(np.sqrt(np.mean(known**2))) if len(known) else 0.0,
        mean_rel=float(np.mean(known)) if len(known) else 0.0,
    )


def normalised_error(p: DepthPrediction, reference: ReferenceAgreement) -> FloatArray:
    """Return E_n of each measured depth, shape (n,), NaN without reference.

    The difference over the expanded uncertainty of the difference (ISO 13528, 9.7).
    """
    half = (p.high95_mm - p.low95_mm) / 2
    difference = np.abs(reference.error_rel * reference.reference_mm)
    score: FloatArray = difference / np.hypot(half, NORMAL_FACTOR * reference.std_mm)
    return score


@dataclass(frozen=True)
class GroupSpread:
    """How consistently each model measures the rows of one group, each by its own angle.

    Parameters
    ----------
    group, count
        Name, and number of rows.
    depth_mm
        Mean reference depth.
    spread_mm
        Standard deviation of depth by own angle less reference depth, by model.
    """

    group: str
    count: int
    depth_mm: float
    spread_mm: Mapping[str, float]


SPREAD_ROWS = 3
"""Fewer rows of a group show no spread."""


def spread_by_group(validation: ValidationResult) -> tuple[GroupSpread, ...]:
    """Return the spread over each group of `SPREAD_ROWS` rows or more."""
    found = []
    members: dict[str, list[int]] = {}
    for i, group in enumerate(validation.groups):
        members.setdefault(group, []).append(i)
    for group, rows in members.items():
        if len(rows) < SPREAD_ROWS:
            continue
        reference = validation.reference_mm[rows]
        spread = {
            model: float(np.std(z[rows] - reference, ddof=1))
            for model, z in validation.own_depth_mm.items()
        }
        found.append(GroupSpread(group, len(rows), float(reference.mean()), spread))
    return tuple(found)
