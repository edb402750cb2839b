"""Stage: what the certificate states of the accuracy, from the calibrated instrument."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import IntArray
from calib.core.errors import EstimationError
from calib.dataset.tables import LengthTable
from calib.geometry.plane import OBSERVABLE, gaze_at
from calib.instrument.calibrated import CalibratedInstrument
from calib.instrument.validation import ValidationResult, reference_std
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations
from calib.uncertainty.certified import (
    CertifiedDepth,
    CheckedDepth,
    certify_depths,
    check_depth,
    depths_to_certify,
)
from calib.uncertainty.conformity import DecisionRule, ToleranceRule
from calib.uncertainty.evidence import Evidence, NotCertified
from calib.uncertainty.lengths import Length, LengthError, length_errors, length_limit
from calib.uncertainty.measurement import Instrument, Reading


def gather_evidence(
    calibrated: CalibratedInstrument,
    rows: Observations,
    validation: ValidationRows | None,
    measured: ValidationResult | None,
    lengths: LengthTable | None,
    *,
    check_reference: str | None,
    depth_rel: float | None,
    rule: DecisionRule,
    seed: SeedSequence,
) -> Evidence:
    """Return certified depths, independent checks and length errors.

    Parameters
    ----------
    calibrated, rows
        The instrument, and the rows it was calibrated on: their rays span the field of view that
        is certified.
    validation, measured
        Rows of the independent reference and what the instrument measures of them.
    lengths
        Reference lengths between rows of either table.
    check_reference
        What the independent reference is.
    depth_rel, rule
        Tolerance on depth relative to it, None without one, and the decision rule.
    seed
        Of the Monte Carlo trials: all depths share theirs, and all lengths.
    """
    low, high = (float(z) for z in calibrated.calibrated_mm)
    tolerance = None if depth_rel is None else ToleranceRule(depth_rel, rule)
    depth_seed, length_seed = seed.spawn(2)
    wanted = depths_to_certify(low, high)
    found = certify_depths(
        calibrated.instrument,
        [_rays(calibrated, rows, z) for z in wanted],
        np.random.default_rng(depth_seed),
        calibrated_mm=(low, high),
        tolerance=tolerance,
    )
    refused = [
        NotCertified(z, str(error))
        for z, error in zip(wanted, found, strict=True)
        if isinstance(error, EstimationError)
    ]
    lengths_found = _lengths(
        calibrated.instrument, rows, validation, lengths, np.random.default_rng(length_seed)
    )
    return Evidence(
        depths=tuple(depth for depth in found if isinstance(depth, CertifiedDepth)),
        not_certified=tuple(refused),
        checks=_checks(calibrated, validation, measured, tolerance),
        check_reference=check_reference,
        lengths=lengths_found,
        length_limit=length_limit(lengths_found) if lengths_found else None,
        tolerance=tolerance,
    )


def _rays(calibrated: CalibratedInstrument, rows: Observations, z_mm: float) -> list[Reading]:
    """Return readings at depth `z_mm` along the outermost and the middle rays of the rows."""
    order = np.argsort(rows.x1c, kind="stable")
    chosen = [int(order[0]), int(order[len(order) // 2]), int(order[-1])]
    if rows.has_height:
        chosen += [int(np.argmin(rows.y1c)), int(np.argmax(rows.y1c))]
    some = list(dict.fromkeys(chosen))
    ray = np.stack([rows.x1c[some], rows.y1c[some], np.ones(len(some))], axis=1)
    gaze = gaze_at(calibrated.instrument.theta, z_mm * ray)
    loadings = calibrated.loadings(gaze)
    return [
        Reading(
            x1c=float(gaze.x1c[i]),
            y1c=float(gaze.y1c[i]),
            alpha2_rad=float(gaze.alpha2[i]),
            shared=None if loadings is None else loadings[i],
        )
        for i in range(len(some))
    ]


def _checks(
    calibrated: CalibratedInstrument,
    validation: ValidationRows | None,
    measured: ValidationResult | None,
    tolerance: ToleranceRule | None,
) -> tuple[CheckedDepth, ...]:
    """Return the checks of rows that were gazed at themselves and have a reference."""
    if validation is None or measured is None:
        return ()
    own = validation.depth_of == np.arange(len(validation.rows))
    p, u_z = measured.prediction, reference_std(calibrated, validation)
    low, high = (float(z) for z in calibrated.calibrated_mm)
    return tuple(
        check_depth(
            name=measured.ids[i],
            reference_mm=float(measured.reference_mm[i]),
            u_reference_mm=float(u_z[i]),
            z_mm=float(p.z_mm[i]),
            u_mm=float(p.u_mm[i]),
            low95_mm=float(p.low95_mm[i]),
            high95_mm=float(p.high95_mm[i]),
            calibrated_mm=(low, high),
            tolerance=tolerance,
        )
        for i in np.flatnonzero(own & np.isfinite(measured.reference_mm))
    )


def _lengths(
    instrument: Instrument,
    rows: Observations,
    validation: ValidationRows | None,
    lengths: LengthTable | None,
    rng: np.random.Generator,
) -> tuple[LengthError, ...]:
    if lengths is None:
        return ()
    points = _points(rows, np.arange(len(rows)))
    if validation is not None:
        points |= _points(validation.rows, validation.depth_of)
    known = [
        Length(
            name=lengths.ids[i],
            start=points[lengths.start[i]],
            end=points[lengths.end[i]],
            reference_mm=float(lengths.length_mm[i]),
            u_reference_mm=float(lengths.u_length_mm[i]),
        )
        for i in range(len(lengths))
        if np.isfinite(lengths.length_mm[i])
    ]
    return length_errors(instrument, known, rng)


def _points(rows: Observations, depth_of: IntArray) -> dict[str, Reading]:
    """Return the readings of rows by id, each with the row whose depth it has."""
    plain = [
        Reading(
            x1c=float(rows.x1c[i]),
            y1c=float(rows.y1c[i]),
            alpha2_rad=float(rows.alpha2_rad[i]),
            gaze_residual_rad=float(rows.gaze_residual_rad[i]),
            shared=rows.shared[i, : OBSERVABLE.z] if rows.shared_names else None,
        )
        for i in range(len(rows))
    ]
    return {
        name: plain[i] if depth_of[i] == i else replace(plain[i], depth_from=plain[depth_of[i]])
        for i, name in enumerate(rows.ids)
    }
