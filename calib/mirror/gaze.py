"""All results of the gaze calibration, back from the mirror."""

from __future__ import annotations

from dataclasses import replace

from calib.mirror.diagnosis import mirror_correction, mirror_diagnosis
from calib.mirror.fits import (
    mirror_convex,
    mirror_identifiability,
    mirror_linear,
    mirror_posterior,
    mirror_robust,
)
from calib.mirror.instruments import (
    mirror_average,
    mirror_calibrated,
    mirror_evidence,
    mirror_measured,
)
from calib.mirror.problem import Mirror
from calib.results.calibration import GazeResult
from calib.rows.from_table import Setup
from calib.rows.observations import Observations


def mirror_gaze(
    result: GazeResult, mirror: Mirror, *, rows: Observations, setup: Setup
) -> GazeResult:
    """Return the result in the frame of the rig whose mirror image was calibrated.

    Scores of models, tables of depth and their uncertainties are the same on either side.

    Parameters
    ----------
    rows, setup
        The rig's own, as they were before the mirror.
    """
    r = result
    return replace(
        r,
        rows=rows,
        linear=None if r.linear is None else mirror_linear(r.linear),
        convex=None if r.convex is None else mirror_convex(r.convex),
        robust={name: mirror_robust(fit, mirror) for name, fit in r.robust.items()},
        posterior={name: mirror_posterior(p, mirror) for name, p in r.posterior.items()},
        identifiability={name: mirror_identifiability(i) for name, i in r.identifiability.items()},
        calibrated=None if r.calibrated is None else mirror_calibrated(r.calibrated, mirror, setup),
        average=None if r.average is None else mirror_average(r.average, mirror),
        validation=None if r.validation is None else mirror_measured(r.validation),
        diagnosis=None if r.diagnosis is None else mirror_diagnosis(r.diagnosis),
        correction=None if r.correction is None else mirror_correction(r.correction),
        evidence=None if r.evidence is None else mirror_evidence(r.evidence),
    )
