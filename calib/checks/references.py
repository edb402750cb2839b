"""Warnings where measured depths contradict a reference that took no part in the calibration."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.instrument.validation import normalised_error
from calib.results.calibration import GazeResult

MISSED_SHARE = 0.1
"""Share of validation depths outside their 95 % intervals that chance explains often enough."""

SCALE_ROWS, SCALE_RATIO = 6, 5.0
"""Validation rows that tell, and how far their median difference stands from 0 in median deviations
from it: six normal errors about 0 do so by chance in 1 of 100 cases."""

NAMED = 10
"""Rows that a text names."""


def disagreements(gaze: GazeResult) -> tuple[str, ...]:
    """Return a warning for each reference that the measured depths contradict.

    Rows that borrow their depth from one row are one measurement; that row stands for it, or the
    first that has a value of the reference.
    """
    validation = gaze.validation
    if validation is None:
        return ()
    p, found = validation.prediction, []
    for error in validation.errors:
        score = normalised_error(p, error)
        known = np.flatnonzero(np.isfinite(score))
        known = known[np.argsort(known != validation.depth_of[known], kind="stable")]
        first = known[np.unique(validation.depth_of[known], return_index=True)[1]]
        bad = first[score[first] > 1]
        if len(bad) > MISSED_SHARE * len(first):
            worst = bad[np.argsort(-score[bad], kind="stable")][:NAMED]
            named = ", ".join(validation.ids[i] for i in worst)
            against = "the reference" if error.name == "reference" else error.name
            found.append(
                f"{len(bad)} of {len(first)} validation depths differ from {against} by "
                "more than their 95 % uncertainties together (E_n > 1; the worst first: "
                f"{named}): calibration reference and validation reference contradict each other, "
                "or a row is mistaken. The uncertainties stated are against "
                f"the reference used to calibrate{_common_scale(error.error_rel[first])}"
            )
    return tuple(found)


def _common_scale(error_rel: FloatArray) -> str:
    """Return what to add where depths are wrong by one factor, as a wrong scale makes them."""
    middle = float(np.median(error_rel))
    scatter = float(np.median(np.abs(error_rel - middle)))
    if len(error_rel) < SCALE_ROWS or abs(middle) < SCALE_RATIO * scatter:
        return ""
    return (
        f". All differ by about {100 * middle:+.1f} %, as a wrong scale makes them: measure the "
        "board's squares again (square_mm), and check how both references were measured"
    )
