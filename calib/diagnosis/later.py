"""Readings as they would be without a mistake of the rig, which later readings have as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.attempts import IMPLICIT_ROUNDS
from calib.diagnosis.findings import Suspect
from calib.diagnosis.refit import corrected
from calib.diagnosis.session import HistoryArrays, RowHistory
from calib.diagnosis.trials import Distorted, Loaded, Looked, Mended, Periodic
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations


def as_meant(
    suspect: Suspect,
    rows: Observations,
    validation: ValidationRows | None,
    history: RowHistory,
) -> tuple[Observations, ValidationRows | None] | None:
    """Return calibration and validation readings without a mistake, if they have it.

    Reference depths of validation stay as they are. None where it is not known what the mistake
    does to a reading that was not looked at.
    """
    if not suspect.attempt.hypothesis.of_readings:
        return rows, validation
    mended = _mended(suspect, rows, history)
    if mended is None or validation is None:
        return None if mended is None else (mended, None)
    later = _mended(suspect, validation.rows, history)
    return None if later is None else (mended, replace(validation, rows=later))


def _mended(suspect: Suspect, rows: Observations, history: RowHistory) -> Observations | None:
    """Return readings without the mistake, their depths as they are."""
    here = RowHistory({}, {}, history.step_rad, history.full_step_rad)
    session = HistoryArrays.of(rows, here, is_left=False)
    trials = suspect.attempt.hypothesis.trials(Looked(rows, session, np.zeros(len(rows))))
    if len(trials) != 1:
        return None
    match trials[0]:
        case Loaded(loadings=loadings):
            pass
        case (Periodic() | Distorted()) as implicit:
            loadings = implicit.loadings(rows.gaze)
            for _ in range(IMPLICIT_ROUNDS):
                loadings = implicit.loadings(corrected(rows, loadings, suspect.values)[0])
        case Mended(rows=mended):
            return replace(mended, z_mm=rows.z_mm)
        case _:
            return None
    if loadings.shape[2] != len(suspect.values):
        return None
    return _less(rows, loadings, suspect.values)


def _less(rows: Observations, loadings: FloatArray, values: FloatArray) -> Observations:
    gaze, _ = corrected(rows, loadings, values)
    return replace(
        rows,
        x1c=gaze.x1c,
        y1c=gaze.y1c,
        alpha2_rad=gaze.alpha2,
        gaze_residual_rad=gaze.residual,
    )
