"""What several sections pick from the results."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.fit.robust import RobustFit
from calib.geometry.plane import OBSERVABLE
from calib.instrument.adjusted import ADJUSTMENT
from calib.report.plotting import thinned
from calib.results.calibration import GazeResult
from calib.results.headline import headline

AXIS_Z = "axis_z_mm"

TABLE_ROWS = 200
"""Rows of a table; more make the page slow and nobody reads them."""


def selected(gaze: GazeResult) -> str | None:
    """Return the name of the model that was selected."""
    return None if gaze.comparison is None else gaze.comparison.selected


def instrument_of_record(gaze: GazeResult) -> Markup:
    """Return by what depths are measured and certified: a model of the rows, or the adjustment."""
    if gaze.choice is not None and gaze.choice.method == ADJUSTMENT:
        return Markup("the adjustment of all pictures")
    return Markup("<em>{}</em>").format(selected(gaze) or "the rows")


def contrasted(gaze: GazeResult) -> tuple[RobustFit, ...]:
    """Return the fits shown before and after: base and the selected model.

    Where base itself was selected, beside it the best of the others.
    """
    chosen = selected(gaze)
    if gaze.comparison is None or chosen is None:
        return tuple(gaze.robust.values())
    others = sorted(gaze.comparison.scores, key=lambda s: -s.loo)
    rival = next((s.model for s in others if s.model not in ("base", chosen)), None)
    names = ["base", chosen] if chosen != "base" else ["base", rival]
    return tuple(gaze.robust[n] for n in names if n is not None and n in gaze.robust)


def chosen_fit(gaze: GazeResult) -> RobustFit | None:
    """Return the fit of the selected model."""
    name = selected(gaze)
    return None if name is None else gaze.robust.get(name)


def axis_z_mm(gaze: GazeResult) -> tuple[float, float] | None:
    """Return Z of the yaw axis with its u, mm, as verdict and certificate state it."""
    of_record = headline(gaze)
    if of_record is None or AXIS_Z not in of_record.names:
        return None
    i = of_record.names.index(AXIS_Z)
    return float(of_record.values[i]), float(np.sqrt(of_record.covariance[i, i]))


def reading_mrad(gaze: GazeResult) -> float:
    """Return the stated standard uncertainty of the gaze angle of a typical row, mrad.

    The encoder's, or the camera's where C2's image replaces the encoder's last digit.
    """
    own = gaze.rows.std[:, [OBSERVABLE.alpha2, OBSERVABLE.residual]]
    return float(1e3 * np.median(np.hypot(*own.T)))


def shown_rows(count: int) -> tuple[list[int], str]:
    """Return the places of the rows that a table shows, and a note where it leaves some out."""
    picked = [int(i) for i in thinned(count, TABLE_ROWS)]
    if len(picked) == count:
        return picked, ""
    return picked, f"{len(picked)} of {count} rows, evenly picked; results.h5 has them all."
