"""Stage: a diagnosed cause that the manifest accepts, corrected in the rows.

The rows are corrected by the estimate, found together with the model's parameters; its standard
uncertainty becomes an error that the rows have in common, so that parameters, depths and intervals
carry it. To first order that is the joint posterior of parameters and correction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.diagnosis.attempts import BestTrial
from calib.diagnosis.engine import MOST_ROWS, Tried, attempt_of
from calib.diagnosis.findings import Attempt
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.refit import corrected
from calib.diagnosis.session import RowHistory
from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.rows.observations import Observations

MODELS_TRIED = ("axis-offset", "base")
"""Models with which the correction is estimated: the first that the rows can carry."""


@dataclass(frozen=True)
class Correction:
    """Rows as corrected, and what for.

    Parameters
    ----------
    rows
        Corrected; `alone` holds the uncertainty of the correction.
    cause
        With its estimate.
    """

    rows: Observations
    cause: Attempt

    @property
    def text(self) -> str:
        """What was corrected, for console and certificate."""
        return f"corrected as {self.cause.name} ([corrections]): {self.cause.text}"


def correct_rows(
    rows: Observations, priors: Priors, history: RowHistory, *, accepted: str, is_left: bool
) -> Correction:
    """Return the rows without the error of an accepted cause.

    Raises
    ------
    EstimationError
        If the rows cannot tell it.
    """
    if len(rows) > MOST_ROWS:
        raise EstimationError(
            f"[corrections] is for tables of up to {MOST_ROWS} rows; thin the table, or mend the "
            "rows themselves"
        )
    found = _outcome(rows, priors, history, accepted=accepted, is_left=is_left)
    cause = attempt_of(HYPOTHESES[accepted], found)
    if found.mended is not None:
        good = found.mended
        return Correction(
            replace(rows, x1c=good.x1c, y1c=good.y1c, alpha2_rad=good.alpha2_rad, z_mm=good.z_mm),
            cause,
        )
    place = {name: i for i, name in enumerate(found.ids)}
    missing = [name for name in rows.ids if name not in place]
    if missing:
        raise EstimationError(
            f"[corrections] accept = {accepted}: rows {', '.join(missing[:5])} are outliers even "
            "so, and cannot be corrected; leave them out of the table"
        )
    gaze, z = corrected(rows, found.loadings, found.values)
    std = np.sqrt(np.linalg.eigvalsh(found.covariance)[-1:])
    alone: FloatArray = found.loadings * std
    return Correction(
        replace(
            rows,
            x1c=gaze.x1c, y1c=gaze.y1c, alpha2_rad=gaze.alpha2,
            gaze_residual_rad=gaze.residual, z_mm=z,
            alone=alone, alone_names=(f"correction of {accepted}",),
        ),
        cause,
    )  # fmt: skip


def _outcome(
    rows: Observations, priors: Priors, history: RowHistory, *, accepted: str, is_left: bool
) -> BestTrial:
    """Return what the rows make of the accepted cause, all rows looked at."""
    for model in MODELS_TRIED:
        try:
            fit = fit_model(rows, priors, model=model)
        except EstimationError:
            continue
        everything = replace(fit, rejected=np.zeros(len(rows), dtype=np.bool_))
        found = Tried.of(rows, priors, everything, history, is_left=is_left, only=(accepted,))
        if found is not None and accepted in found.outcomes:
            return found.outcomes[accepted]
    raise EstimationError(
        f"[corrections] accept = {accepted}: the rows cannot tell it; remove the section"
    )
