"""What has changed in a rig whose check standard is out of control."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.parameters import INDEX
from calib.geometry.plane import gaze_at
from calib.history.standard import Checked, inverse, mean_of, values_of
from calib.uncertainty.position import positions

STEPS = 8
"""Of Gauss and Newton; a change of many uncertainties bends what a length tells of it."""


@dataclass(frozen=True)
class DriftCause:
    """Something that moves what is measured.

    Parameters
    ----------
    name
        In the user's words.
    step
        By which its effect is differentiated.
    parameter
        Of the model that it changes; None for C1's focal length.
    relative
        Whether its size is a fraction of the parameter.
    scale, unit
        What a size of 1 is, as printed.
    """

    name: str
    step: float
    parameter: str | None
    relative: bool
    scale: float
    unit: str


CAUSES = (
    DriftCause(
        "the encoder's zero has slipped", 1e-5, "delta2_rad", False, float(np.rad2deg(1)), "deg"
    ),
    DriftCause("C1 and C2 have moved apart", 1e-5, "baseline_mm", True, 100.0, "% of the baseline"),
    DriftCause("C2 has moved to or fro", 1e-2, "axis_z_mm", False, 1.0, "mm"),
    DriftCause("C1's focal length has changed", 1e-5, None, True, 100.0, "%"),
)


@dataclass(frozen=True)
class Likely:
    """A cause that may explain a change.

    Parameters
    ----------
    name
        Of the cause.
    size, std
        How much of it, in `unit`.
    chi2
        Of what it leaves over, with one degree of freedom fewer than quantities tell.
    """

    name: str
    size: float
    std: float
    unit: str
    chi2: float


def likely_causes(checked: Checked, *, accepted: int, since: int) -> tuple[Likely, ...]:
    """Return the causes by how well each alone explains what changed, the best first.

    Parameters
    ----------
    accepted
        Sessions that make the reference.
    since
        First session of the changed state; its mean with all later ones is compared.
    """
    before, own = mean_of(checked, slice(0, accepted))
    after, later = mean_of(checked, slice(since, None))
    weight, targets = inverse(own + later), checked.targets_mm[:accepted].mean(axis=0)
    found = [_fitted(cause, checked, targets, after - before, weight) for cause in CAUSES]
    return tuple(sorted(found, key=lambda one: one.chi2))


def _fitted(
    cause: DriftCause, checked: Checked, targets: FloatArray, change: FloatArray, weight: FloatArray
) -> Likely:
    """Return how much of a cause explains a change best."""
    size, information = 0.0, 1.0
    for _ in range(STEPS):
        ends = [effect(cause, size + d, checked, targets) for d in (-cause.step, cause.step)]
        slope = (ends[1] - ends[0]) / (2 * cause.step)
        information = float(slope @ weight @ slope)
        if not information > 0:
            # Nothing that is certified depends on it, or the step left what a rig can be.
            return Likely(cause.name, np.nan, np.nan, cause.unit, np.inf)
        size += (
            float(slope @ weight @ (change - effect(cause, size, checked, targets))) / information
        )
    left = change - effect(cause, size, checked, targets)
    return Likely(
        name=cause.name,
        size=cause.scale * size,
        std=cause.scale * information**-0.5,
        unit=cause.unit,
        chi2=float(left @ weight @ left),
    )


def effect(cause: DriftCause, size: float, checked: Checked, targets: FloatArray) -> FloatArray:
    """Return the change of what is measured by so much of a cause, mm, shape (q,).

    The rig has changed, so that it reads other values at the same targets; the calibration by
    which they are measured has not.
    """
    rig, scale = checked.theta.copy(), 1.0
    if cause.parameter is None:
        scale += size
    else:
        at = INDEX[cause.parameter]
        rig[at] += size * (rig[at] if cause.relative else 1.0)
    gaze = gaze_at(rig, targets)
    gaze = replace(gaze, x1c=scale * gaze.x1c, y1c=scale * gaze.y1c)
    place = {name: k for k, name in enumerate(checked.standard.targets)}
    measured = values_of(positions(checked.theta, gaze), checked.standard, place)
    return measured - values_of(targets, checked.standard, place)
