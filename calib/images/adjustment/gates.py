"""What must hold before the adjustment is used."""

from __future__ import annotations

import numpy as np

from calib.core.gate import Gate
from calib.images.adjustment.solve import AdjustmentSolution
from calib.images.adjustment.steadiness import turn_of_c1
from calib.images.bundle import finite
from calib.images.checks import fit_gate, gate
from calib.images.joint.changes import focal_changes
from calib.images.joint.drifts import CHANCE, centre_shifts
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.stereo.gates import lens_gates, steady_gates
from calib.images.sweep.yaw_axis import READING_LIMIT, SMALL_READING_ERROR_RAD

LEFT_OUT_LIMIT = 0.1
"""Pictures left out whole; of real pictures one or two in a hundred are (a board that moved)."""

NAMED = 10
"""Pictures named at most."""

FACTOR_LIMIT = 100.0
"""By which views may contradict each other in the rig, in variances of corner noise: corners of
real boards reach 2 to 20 (light, blur, a board not quite a parabola). At 100 something moved."""


STEADY = "c1-steady"
"""Name of the gate on C1 keeping its place: of the rig, whatever its depths are taken from."""


def adjustment_gates(found: AdjustmentSolution, stated_rad: float) -> tuple[Gate, ...]:
    """Return the gates.

    Parameters
    ----------
    stated_rad
        Standard uncertainty that is stated for a reading.
    """
    left = left_out(found)
    rejected = found.rejected.sum(axis=1)
    rejected[left] = 0
    count = len(found.problem.pictures.names)
    return (
        fit_gate(
            "adjustment-fit",
            found.residuals,
            int(rejected.sum()),
            remedy="check that each board was at rest, the readings, and the counts of [board]",
        ),
        _pictures_gate(found, left, count),
        _views_gate(found),
        _readings_gate(found, stated_rad),
        *_steady_gates(found),
    )


def rig_gates(gates: tuple[Gate, ...]) -> tuple[Gate, ...]:
    """Return those of the gates that are of cameras and rig, whatever the instrument is by."""
    return tuple(gate for gate in gates if not gate.name.startswith("adjustment-"))


def _steady_gates(found: AdjustmentSolution) -> tuple[Gate, ...]:
    """Gates on lenses and C1 staying as they are; on lenses where no pairs have their own."""
    gates: tuple[Gate, ...] = ()
    if "pair" not in found.problem.pictures.kinds:
        gates = (*lens_gates(focal_changes(found)), *steady_gates(centre_shifts(found), None))
    turn = turn_of_c1(found, found.problem, found.rig, found.reading_errors_rad)
    if turn is None:
        return gates
    x, y, z = 1e3 * turn.turn_rad
    steady = gate(
        STEADY,
        not turn.found,
        f"from the first gaze row to the last C1 turns against the rig by ({x:z.2f}, {y:z.2f}, "
        f"{z:z.2f}) mrad +- ({', '.join(f'{1e3 * u:.2f}' for u in turn.std)}), chi2 "
        f"{turn.chi2:.1f} of 3 (limit {turn.limit:.3g}); errors of readings grow by "
        f"{1e3 * turn.trend_rad:z.2f} mrad (p = {turn.trend_probability:.1g} by chance, limit "
        f"{CHANCE:g})",
        remedy="C1 or its mount creeps (a loose screw, a cable that pulls, a tripod that warms "
        "up), or the zero of the encoder does: fasten it, wait, and take the rows again",
    )
    return (*gates, steady)


def left_out(found: AdjustmentSolution) -> list[int]:
    """Return places of the pictures that were left out whole."""
    kept = finite(found.residuals).sum(axis=-1)
    return [int(i) for i in np.flatnonzero(kept < MIN_CORNERS)]


def _pictures_gate(found: AdjustmentSolution, left: list[int], count: int) -> Gate:
    names = [found.problem.pictures.names[i] for i in left]
    more = ", ..." if len(names) > NAMED else ""
    named = f" and were left out: {', '.join(names[:NAMED])}{more}" if names else ""
    return gate(
        "adjustment-pictures",
        len(left) <= LEFT_OUT_LIMIT * count,
        f"{len(left)} of {count} pictures contradict the others{named}",
        remedy="check that these boards were at rest and their readings",
    )


def _views_gate(found: AdjustmentSolution) -> Gate:
    factor = found.factors[2]
    return gate(
        "adjustment-views",
        factor <= FACTOR_LIMIT,
        f"views contradict each other in the rig by {np.sqrt(factor):.2f} times what corner noise "
        f"explains (limit {np.sqrt(FACTOR_LIMIT):g}); its uncertainties contain that",
        remedy="check that the cameras kept their places and lenses between the pictures",
    )


def _readings_gate(found: AdjustmentSolution, stated_rad: float) -> Gate:
    errors = np.abs(found.reading_errors_rad)
    worst = int(np.argmax(errors))
    pictures = found.problem.pictures
    name = pictures.names[int(np.argmax(pictures.exposure == worst))]
    limit = max(READING_LIMIT * stated_rad, SMALL_READING_ERROR_RAD)
    return gate(
        "adjustment-readings",
        float(errors[worst]) <= limit,
        f"readings differ by {np.degrees(errors[worst]):.3f} deg at most from where C2 stands in "
        f"the pictures, in {name} (limit {np.degrees(limit):.3f})",
        remedy="check alpha2_deg of this picture first, or state u_alpha2_deg in [encoder]",
    )
