"""What returns to the first target say, in words: for the capture and for the calibration."""

from __future__ import annotations

import math

import numpy as np

from calib.dataset.encoder import Encoder
from calib.dataset.tables import ReturnTable
from calib.uncertainty.control import Control, Returns, control, lost_full_steps


def control_of(table: ReturnTable, encoder: Encoder | None) -> Control:
    """Return the charts of a table of returns to one target, which has one at least."""
    return control(_returns(table, encoder))


def control_words(table: ReturnTable, encoder: Encoder | None) -> str:
    """Return what the charts show and, where one is outside its limits, what to do."""
    returns = _returns(table, encoder)
    found = control(returns)
    worst = float(np.abs(found.single.statistic).max())
    said = (
        f"{len(table)} return(s) to the target of {table.of[0]}: the zero changed by at most "
        f"{worst:.1f} u (limit {found.single.limit:g}), their moving average by "
        f"{float(np.abs(found.average.statistic).max()):.1f} (limit {found.average.limit:g})"
    )
    alarm = found.first_alarm
    if alarm is None:
        return said
    since = table.of[0] if alarm == 0 else table.after[alarm - 1]
    until = table.after[int(np.flatnonzero(found.outside)[-1])]
    cause = _cause(found, returns.until(found.last_alarm))
    return (
        f"{said}; {cause}: the rows after {since} up to {until} have other zeros than those "
        "before; mend the cause, strike these rows and the returns from "
        f"{table.ids[alarm]} on, or capture into a new folder"
    )


def _cause(found: Control, returns: Returns) -> str:
    change = math.degrees(returns.change_rad[-1])
    # Of a zero that came back the moving average is outside for a while: the last says nothing.
    z = found.single.statistic[: len(returns.change_rad)]
    most = math.degrees(returns.change_rad[int(np.abs(z).argmax())])
    match found.cause:
        case "lost steps":
            steps = lost_full_steps(returns)
            return (
                f"{change:+.4f} deg are {steps:+d} full steps of the motor, which lost them: look "
                "for too high a speed, a stiff cable, a blocked mount"
            )
        case "drift":
            return (
                f"it drifts, by now {change:+.4f} deg: let motor and rig warm up, look for a cable "
                "that pulls"
            )
        case "jump":
            return (
                f"it jumped, by {most:+.4f} deg: look for a bump, a slipped coupling, a new "
                "reference run"
            )
        case _:
            return (
                f"it changed by {most:+.4f} deg, by drift or in one jump: look for heat, a cable "
                "that pulls, a bump, a slipped coupling, a new reference run, or a first target "
                "that was not put back where it stood"
            )


def _returns(table: ReturnTable, encoder: Encoder | None) -> Returns:
    """Return the figures of a table; steps are lost unseen where no encoder on C2's side reads."""
    full = None
    if encoder is not None and encoder.reads == "counts" and encoder.full_step_deg is not None:
        full = math.radians(encoder.full_step_deg)
    return Returns(
        change_rad=table.change_rad,
        u_rad=table.u_change_rad,
        u_first_rad=float(table.u_first_rad[0]),
        full_step_rad=full,
    )
