"""Stage: the instrument as the adjustment of all pictures describes it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.core.unit_diagonal import Spectrum, unit_diagonal
from calib.fit.robust import identified_by
from calib.fit.start import some_rows
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import INDEX, embed
from calib.geometry.plane import OBSERVABLE
from calib.images.adjustment.result import AdjustedModel, Adjustment
from calib.images.stereo.triangulate import POSE_NAMES
from calib.instrument.calibrated import EVALUATION, CalibratedInstrument, DepthTable
from calib.instrument.validation import ValidationResult
from calib.rows.common_errors import RANK, CommonErrors
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
    shared = CommonErrors.of(record.lens_names, record.lens_covariance)
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


def moved_by_lenses(record: AdjustedModel, shared: CommonErrors) -> FloatArray:
    """Return how far a unit of each error of the lenses moves the parameters, shape (p, k).

    With L the factor of the lenses' covariance and S the covariance of parameters with lenses,
    S = W L': the part of the parameters' errors that comes with those of the lenses.
    """
    kept = [record.lens_names.index(name) for name in shared.names]
    unit = np.sqrt(np.diag(record.lens_covariance))[kept]
    root = shared.factor / unit[:, None]
    moved: FloatArray = (record.with_lens[:, kept] / unit) @ np.linalg.pinv(root).T
    return moved


ENOUGH_ROWS = 1000
"""Rows, spread over all, that tell whether they agree: their covariance is a full matrix."""


@dataclass(frozen=True)
class Agreement:
    """How gaze rows agree with the gaze planes of the adjustment.

    Parameters
    ----------
    statistic, freedom
        Misclosures of the rows by their covariance, chi-squared of so many degrees of freedom if
        rows and pictures agree.
    probability
        Of a statistic as large by chance.
    """

    statistic: float
    freedom: int
    probability: float


def agreement(
    adjustment: Adjustment,
    rows: Observations,
    shared: CommonErrors,
    *,
    noise_factor: float = 1.0,
    outliers: Collection[str] = (),
) -> Agreement:
    """Return how rows agree with the adjusted gaze planes.

    The covariance has all that is uncertain of a row, what it shares with others, the parameters,
    and what these have in common: lenses and pose of C2, by which rows are seen, are of pictures
    that the adjustment has as well. An efficient estimate does not covary with how much another
    one differs from it (Hausman 1978, doi 10.2307/1913827), so that the covariance with lenses and
    pose of the rows is that with its own. Corner noise of the rows' own pictures, which is part of
    the adjustment, would lessen it further: left out.

    Parameters
    ----------
    shared
        The estimated quantities by which `rows` have errors in common; none where they are not of
        the adjusted pictures.
    noise_factor
        By how much the rows' own fit proves their stated uncertainties too small: noise is no
        contradiction.
    outliers
        Rows that contradict the other rows: they say nothing of all rows.
    """
    record = adjustment.complete
    kept = rows.take(np.array([name not in outliers for name in rows.ids], dtype=np.bool_))
    kept = some_rows(kept, ENOUGH_ROWS)
    at = embed(record.values, record.names)
    found = misclosure(at, kept.gaze, kept.z_mm)
    by = found.by_observable
    covariance = np.diag((by**2 * kept.std**2).sum(axis=1))
    if kept.has_groups:
        common = by[:, OBSERVABLE.z] * kept.u_z_group_mm
        together = np.equal.outer(kept.z_group, kept.z_group) & ~np.eye(len(kept), dtype=np.bool_)
        covariance += np.where(together, np.outer(common, common), 0.0)
    covariance *= noise_factor**2
    slope = found.by_theta[:, [INDEX[name] for name in record.names]]
    covariance += slope @ record.covariance @ slope.T
    if kept.shared_names:
        loading = np.einsum("nq,nqk->nk", by, kept.shared)
        covariance += loading @ loading.T
    if kept.shared_names and shared.names:
        cross = slope @ _with_shared(record, shared) @ loading.T
        covariance += cross + cross.T
    std, correlation = unit_diagonal(covariance)
    pulls = found.value / std
    statistic = float(pulls @ np.linalg.solve(correlation, pulls))
    return Agreement(statistic, len(kept), float(chi2.sf(statistic, len(kept))))


def _with_shared(record: AdjustedModel, shared: CommonErrors) -> FloatArray:
    """Return the covariance of the parameters with the errors that rows share, shape (p, k).

    None is correlated by more than 1: factors by which views contradict each other are not the same
    in both estimates.
    """
    known = {
        **dict(zip(record.lens_names, record.with_lens.T, strict=True)),
        **dict(zip(POSE_NAMES, record.with_pose.T, strict=True)),
    }
    nothing = np.zeros(len(record.names))
    with_shared = np.stack([known.get(name, nothing) for name in shared.names], axis=1)
    unit = np.linalg.norm(shared.factor, axis=1)
    by_error = with_shared / unit @ np.linalg.pinv(shared.factor / unit[:, None], rcond=OPEN).T
    own = Spectrum.of(record.covariance)
    correlation = own.inverse_root(RANK).T @ by_error
    u, size, vt = np.linalg.svd(correlation, full_matrices=False)
    found: FloatArray = own.root(RANK) @ (u * np.minimum(size, 1.0)) @ vt
    return found


OPEN = 1e-6
"""Share of the greatest error in common below which one is not told from the others."""

BY_RULE, ROWS, ADJUSTMENT = "rule", "rows", "adjustment"
"""From what the instrument is taken: by the rule of `choose`, or as the user says."""

AS_ASKED = "as asked for by --method"

CONTRADICTED = 1e-3
"""Probability below which rows and adjustment contradict each other."""


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


def refuse_missing(asked: str, adjustment: Adjustment | None) -> None:
    """Raise where the user asks for an adjustment and there is none.

    Raises
    ------
    UsageError
        With what an adjustment needs.
    """
    if adjustment is None and asked == ADJUSTMENT:
        raise UsageError(
            "--method adjustment: there is no adjustment: it needs pictures of a board by both "
            "cameras at known readings of the encoder; leave the option out"
        )


def choose(
    asked: str, adjustment: Adjustment, agrees: Agreement | None, *, corrected: bool
) -> Choice:
    """Return the choice.

    The instrument is taken from the adjustment where its gates pass and the rows agree with it.

    Parameters
    ----------
    asked
        `BY_RULE`, or the method that the user has asked for.
    agrees
        How rows agree; None without rows that could.
    corrected
        Whether the manifest accepts a correction of the rows, which the adjustment knows not of.
    """
    if asked != BY_RULE:
        return Choice(asked, AS_ASKED)
    failed = [gate.name for gate in adjustment.gates if not gate.passed]
    if failed:
        return Choice(ROWS, f"the adjustment fails {', '.join(failed)}")
    if corrected:
        return Choice(ROWS, "[corrections] are of the rows, and the adjustment has none")
    if agrees is None:
        return Choice(ADJUSTMENT, "all gates of the adjustment pass, and no model fits the rows")
    told = f"chi2 {agrees.statistic:.3g} of {agrees.freedom} rows, p = {agrees.probability:.2g}"
    if agrees.probability < CONTRADICTED:
        return Choice(
            ROWS,
            f"rows contradict its gaze planes ({told}): reference depths and the squares of the "
            "board differ in scale, a camera or the encoder was moved in between, or rows and "
            "pictures do not belong together",
        )
    return Choice(
        ADJUSTMENT,
        f"all gates of the adjustment pass, and the rows agree with its gaze planes ({told})",
    )
