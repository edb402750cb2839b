"""Stage: the instrument as the adjustment of all pictures describes it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.fit.robust import identified_by
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import embed
from calib.images.adjustment.result import AdjustedModel, Adjustment
from calib.instrument.calibrated import (
    EVALUATION,
    CalibratedInstrument,
    DepthTable,
    ValidationResult,
)
from calib.rows.common_errors import Shared
from calib.rows.from_table import CameraSet, RowSettings, Setup
from calib.rows.observations import Observations
from calib.uncertainty.measurement import ParameterKnowledge, SharedErrors


@dataclass(frozen=True)
class Described:
    """An instrument and what it measures.

    Parameters
    ----------
    calibrated
        The instrument.
    depths
        Its depth uncertainty.
    validation
        What it measures on the validation rows; None without any.
    """

    calibrated: CalibratedInstrument
    depths: DepthTable
    validation: ValidationResult | None


def adjusted_setup(adjustment: Adjustment, settings: RowSettings) -> Setup:
    """Return cameras and shared errors as the adjustment has them."""
    record = adjustment.complete
    shared = Shared.of(record.lens_names, record.lens_covariance)
    return Setup(settings, CameraSet(*record.cameras), shared)


def adjust_instrument(
    calibrated: CalibratedInstrument, adjustment: Adjustment
) -> CalibratedInstrument:
    """Return the instrument with parameters and cameras of the adjustment.

    The errors of a reading are as the rows have shown them.

    Parameters
    ----------
    calibrated
        The instrument by the rows.
    """
    record = adjustment.complete
    setup = adjusted_setup(adjustment, calibrated.setup.settings)
    parameters = ParameterKnowledge(
        names=record.names,
        values=record.values,
        covariance=record.covariance,
        degrees_of_freedom=None,
        evaluation=tuple(EVALUATION[identified_by(float(s))] for s in record.data_share),
    )
    shared = None
    if setup.shared.names:
        moved = moved_by_lenses(record, setup.shared)
        shared = SharedErrors(setup.shared.error_names, with_parameters=moved)
    instrument = replace(calibrated.instrument, parameters=parameters, shared=shared)
    return replace(calibrated, model=record.model, instrument=instrument, setup=setup)


def moved_by_lenses(record: AdjustedModel, shared: Shared) -> FloatArray:
    """Return how far a unit of each error of the lenses moves the parameters, shape (p, k).

    With L the factor of the lenses' covariance and S the covariance of parameters with lenses,
    S = W L': the part of the parameters' errors that comes with those of the lenses.
    """
    kept = [record.lens_names.index(name) for name in shared.names]
    unit = np.sqrt(np.diag(record.lens_covariance))[kept]
    root = shared.factor / unit[:, None]
    moved: FloatArray = (record.with_lens[:, kept] / unit) @ np.linalg.pinv(root).T
    return moved


def row_pulls(adjustment: Adjustment, rows: Observations) -> FloatArray:
    """Return by how many standard uncertainties rows miss the adjusted gaze planes, shape (n,).

    All that is uncertain of a row counts, what it shares with others too.
    """
    record = adjustment.complete
    found = misclosure(embed(record.values, record.names), rows.gaze, rows.z_mm)
    by = found.by_observable
    variance = (by**2 * rows.std**2).sum(axis=1)
    if rows.shared_names:
        variance = variance + (np.einsum("nq,nqk->nk", by, rows.shared) ** 2).sum(axis=1)
    pulls: FloatArray = found.value / np.sqrt(variance)
    return pulls


BY_RULE, ROWS, ADJUSTMENT = "rule", "rows", "adjustment"
"""From what the instrument is taken: by the rule of `choose`, or as the user says."""

AS_ASKED = "as asked for by --method"

ROWS_LIMIT = 3.0
"""Root mean square of `row_pulls` up to which rows and pictures agree: 1 if all that is stated is
so; rows whose reference depths are another scale than the board's squares miss by ten and more."""


@dataclass(frozen=True)
class Choice:
    """From what the instrument of record is taken, and why.

    Parameters
    ----------
    method
        `ROWS` or `ADJUSTMENT`.
    reason
        In words.
    """

    method: str
    reason: str


def choose(
    asked: str, adjustment: Adjustment | None, rows: Observations, *, corrected: bool
) -> Choice | None:
    """Return the choice; None where there is no adjustment.

    The instrument is taken from the adjustment where there is one, its gates pass and the rows
    agree with it.

    Parameters
    ----------
    asked
        `BY_RULE`, or the method that the user has asked for.
    corrected
        Whether the manifest accepts a correction of the rows, which the adjustment knows not of.

    Raises
    ------
    UsageError
        If the user asks for an adjustment and there is none.
    """
    if adjustment is None:
        if asked == ADJUSTMENT:
            raise UsageError(
                "--method adjustment: there is no adjustment: it needs pictures of a board by both "
                "cameras at known readings of the encoder; leave the option out"
            )
        return None
    if asked != BY_RULE:
        return Choice(asked, AS_ASKED)
    failed = [gate.name for gate in adjustment.gates if not gate.passed]
    if failed:
        return Choice(ROWS, f"the adjustment fails {', '.join(failed)}")
    if corrected:
        return Choice(ROWS, "[corrections] are of the rows, and the adjustment has none")
    missed = float(np.sqrt(np.mean(row_pulls(adjustment, rows) ** 2)))
    agree = (
        f"rows miss its gaze planes by {missed:.2f} standard uncertainties (limit {ROWS_LIMIT:g})"
    )
    if missed > ROWS_LIMIT:
        return Choice(
            ROWS,
            f"{agree}: reference depths and the squares of the board contradict each other, or "
            "rows and pictures do not belong together",
        )
    return Choice(ADJUSTMENT, f"all gates of the adjustment pass, and {agree}")
