"""What a set of rows can tell of a model, and which combination of parameters it cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.core.unit_diagonal import unit_diagonal
from calib.fit.information import Information, beforehand, kept, row_slopes, slopes
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.robust import DECIDED, RobustFit
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import (
    PARAMETERS,
    STANDOFF,
    AxisPoint,
    AxisTilt,
    Effect,
    EncoderTerm,
    GazeRoll,
    Model,
    PlaneOffset,
    Standoff,
)
from calib.geometry.plane import OBSERVABLE
from calib.rows.observations import Observations

UNDETERMINED = 1.0
"""Standard deviation, in units of `beforehand`, above which the rows leave a combination open."""

PREDICTED_LIMIT_REL = 0.05
"""Relative standard deviation of depth, from the parameters alone, at the rows' own depths. Above
it the calibration is not worth its rows: the paper's own errors are 8 % and less."""

MATTERS = 0.3
"""Share of a row's own uncertainty above which what is uncertain of the standoff matters to it: in
quadrature it adds 4 %. The fraction of a count by which a motor misses stays far below."""

INVOLVED = 0.25
"""Least share of a unit vector's length at which a parameter is named as part of it."""


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space, as the rows see it.

    Parameters
    ----------
    names
        Parameters that make it up, in the order of the model's.
    direction
        Unit vector in units of `beforehand`, shape (p,); its largest part is positive.
    singular_value
        Of the scaled information's root, from the rows alone: 1 / `std`.
    std
        Standard deviation along it, in units of `beforehand`, from the rows alone; infinite if
        they say nothing.
    std_with_sweep
        The same with what was measured by the yaw sweep.
    std_with_priors
        The same with the priors too.
    told_by
        "rows" or "sweep", whichever brings it below `UNDETERMINED`, else "prior".
    remedies
        What would tell it, the likeliest first; empty unless it is left to the prior.
    """

    names: tuple[str, ...]
    direction: FloatArray
    singular_value: float
    std: float
    std_with_sweep: float
    std_with_priors: float
    told_by: str
    remedies: tuple[str, ...]

    @property
    def words(self) -> str:
        """What the rows cannot distinguish and what to do about it; empty where they can."""
        if not self.remedies:
            return ""
        symbols = [_SYMBOLS[name] for name in self.names]
        if len(symbols) == 1:
            told = f"hold hardly any information on {symbols[0]}"
        else:
            told = f"cannot distinguish {', '.join(symbols[:-1])} from {symbols[-1]}"
        return f"these targets {told}: {', or '.join(self.remedies)}"


@dataclass(frozen=True)
class Identifiability:
    """What the rows can tell of one model.

    Errors that all rows share (intrinsics, stereo extrinsics) are left out: they are no matter of
    what the rows can distinguish.

    Parameters
    ----------
    model
        Its name.
    names
        Free parameters, p of them.
    scale
        What is known of each beforehand, shape (p,), units of the parameters.
    combinations
        Singular directions of the scaled information's root, the best known first; p of them.
    correlation
        Of the parameters with sweep and priors, shape (p, p).
    rows_std
        Standard deviations from the rows alone, shape (p,), units of the parameters; infinite
        where they leave a parameter open.
    sweep_std
        The same with what was measured by the yaw sweep.
    std
        The same with the priors too.
    decided_by
        For each parameter "rows", "sweep", "prior" or several of them.
    has_sweep
        Whether a sweep measured any parameter of the model.
    depth_std_rel
        Greatest relative standard deviation of depth, from the parameters alone, over the rows.
    idle
        Parameters left to their priors without any row's depth depending on them noticeably: the
        standoff, where C2 gazes at all targets.
    gate
        Whether that is small enough. Large correlations alone fail nothing.
    """

    model: str
    names: tuple[str, ...]
    scale: FloatArray
    combinations: tuple[Combination, ...]
    correlation: FloatArray
    rows_std: FloatArray
    sweep_std: FloatArray
    std: FloatArray
    decided_by: tuple[str, ...]
    has_sweep: bool
    depth_std_rel: float
    idle: tuple[str, ...]
    gate: Gate

    @property
    def condition(self) -> float:
        """Condition number of the scaled information's root."""
        last = self.combinations[-1].singular_value
        return self.combinations[0].singular_value / last if last > 0 else float("inf")

    @property
    def open(self) -> tuple[Combination, ...]:
        """Combinations that neither rows nor sweep tell, the least known first."""
        return tuple(c for c in reversed(self.combinations) if c.remedies)


def identifiability(rows: Observations, fit: RobustFit, priors: Priors) -> Identifiability:
    """Return what `rows` can tell of the model of `fit`, at its estimate."""
    model = fit.structure
    unit = beforehand(model)
    own = row_slopes(rows, fit) * unit
    measured = measured_of(model, priors).root()[0] * unit
    prior = prior_of(model, priors).root()[0] * unit
    levels = _Levels(
        rows=Information.of(own),
        sweep=Information.of(own, measured),
        priors=Information.of(own, measured, prior),
        has_sweep=bool(len(measured)),
    )
    covariance = levels.priors.covariance
    std, correlation = unit_diagonal(covariance)
    worst = _depth_std_rel(rows, fit, covariance * np.outer(unit, unit))
    idle = _idle(rows, fit, std * unit)
    combinations = tuple(_combination(levels, k, rows, fit, idle) for k in range(len(unit)))
    each = np.eye(len(unit))
    return Identifiability(
        model=model.name,
        names=model.free,
        scale=unit,
        combinations=combinations,
        correlation=correlation,
        rows_std=levels.rows.std(each) * unit,
        sweep_std=levels.sweep.std(each) * unit,
        std=levels.priors.std(each) * unit,
        decided_by=_decided_by(fit, levels, priors),
        has_sweep=levels.has_sweep,
        depth_std_rel=worst,
        idle=idle,
        gate=_gate(model, worst, combinations),
    )


@dataclass(frozen=True)
class _Levels:
    """What is known: from the rows, with the sweep, with the priors."""

    rows: Information
    sweep: Information
    priors: Information
    has_sweep: bool


def _idle(rows: Observations, fit: RobustFit, std: FloatArray) -> tuple[str, ...]:
    """Return `Identifiability.idle`, from the standard deviations with priors, shape (p,)."""
    if STANDOFF not in fit.names:
        return ()
    slope = np.abs(slopes(rows, fit)[:, fit.names.index(STANDOFF)])
    return (STANDOFF,) if slope.max() * std[fit.names.index(STANDOFF)] < MATTERS else ()


def _combination(
    levels: _Levels, k: int, rows: Observations, fit: RobustFit, idle: tuple[str, ...]
) -> Combination:
    direction = levels.rows.directions[k]
    singular = float(levels.rows.value[k])
    alone = 1 / singular if singular > 0 else float("inf")
    swept, known = (float(x.std(direction[None])[0]) for x in (levels.sweep, levels.priors))
    names = tuple(n for n, d in zip(fit.names, direction, strict=True) if abs(d) > INVOLVED)
    told_by = "rows" if alone <= UNDETERMINED else "sweep" if swept <= UNDETERMINED else "prior"
    named = tuple(name for name in names if name not in idle)
    asks = told_by == "prior" and len(named) > 0
    names = named or names
    remedies = _remedies(names, rows, fit, swept=levels.has_sweep) if asks else ()
    return Combination(names, direction, singular, alone, swept, known, told_by, remedies)


def _decided_by(fit: RobustFit, levels: _Levels, priors: Priors) -> tuple[str, ...]:
    """Return who decided each parameter: `RobustFit.identified_by`, its data taken apart."""
    each = np.eye(len(fit.names))
    alone, swept = levels.rows.std(each), levels.sweep.std(each)
    measured = () if priors.measured is None else priors.measured.names
    found: list[str] = []
    for i, (name, who) in enumerate(zip(fit.names, fit.identified_by, strict=True)):
        if who == "prior":
            found.append(who)
            continue
        # An infinity that the sweep leaves is no word of the sweep's.
        by_rows = swept[i] > DECIDED * alone[i] or np.isinf(swept[i])
        by_sweep = name in measured and swept[i] < (1 - DECIDED) * alone[i]
        parts = ["rows"] if by_rows else ["sweep"] if by_sweep else ["rows", "sweep"]
        parts += ["prior"] if who == "both" else []
        found.append(" and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]])))
    return tuple(found)


def _depth_std_rel(rows: Observations, fit: RobustFit, covariance: FloatArray) -> float:
    """Return the greatest relative standard deviation of depth over the rows.

    At their reference depths: those of rows that agree, so that no outlier's gaze decides it.
    """
    c = misclosure(fit.theta, rows.gaze, rows.z_mm, parameters=fit.structure.indices)
    # F(theta, q, z) = 0 defines z, so dz = -F_theta dtheta / F_z.
    slope = c.by_theta / (c.by_observable[:, OBSERVABLE.z] * rows.z_mm)[:, None]
    relative = np.sqrt(np.einsum("ni,ij,nj->n", slope, covariance, slope))
    return float(relative[kept(rows, fit)].max())


_SYMBOLS: Mapping[str, str] = MappingProxyType({p.name: p.symbol for p in PARAMETERS})


def _of(*effects: type[Effect]) -> frozenset[str]:
    """Return the parameters of these effects, but for the two that every row shows."""
    named = (p.name for p in PARAMETERS if isinstance(p.effect, effects))
    return frozenset(named) - {"baseline_mm", "delta2_rad"}


_BY_TURNING = _of(AxisPoint, PlaneOffset, EncoderTerm)
"""Parameters whose effect changes with the reading: a wider range of it identifies them."""

_BY_SWEEP = _of(PlaneOffset, GazeRoll, EncoderTerm, Standoff)
"""Parameters that a yaw sweep identifies."""

_BY_HEIGHT = _of(AxisTilt, GazeRoll)
"""Parameters that targets above and below C1's axis identify."""

HALF_WIDTHS_DEG = (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 55.0, 60.0)
"""Readings to either side of 90 deg that are tried as a remedy; C1 sees none beyond."""


def _remedies(
    names: tuple[str, ...], rows: Observations, fit: RobustFit, *, swept: bool
) -> tuple[str, ...]:
    """Return what would tell a combination, the likeliest first."""
    found = []
    if _BY_TURNING.intersection(names):
        found += _wider(names, rows, fit)
    if _BY_HEIGHT.intersection(names):
        span = float(np.ptp(rows.y1c))
        found.append(f"place targets higher and lower (y1c spans {span:.2f} now)")
    if "delta2_rad" in names:
        near, far = rows.z_mm.min(), rows.z_mm.max()
        found.append(f"place targets nearer and farther than {near:.0f} to {far:.0f} mm")
    if _BY_SWEEP.intersection(names):
        found.append(f"take a {'wider ' if swept else ''}yaw sweep ([sweep] in dataset.toml)")
    # Of several parameters the last in the table is the one that a drawing tells best.
    prior = next(p.name for p in reversed(PARAMETERS) if p.name in names)
    found.append(f"state a prior of {prior} in dataset.toml")
    return tuple(found)


def _wider(names: tuple[str, ...], rows: Observations, fit: RobustFit) -> list[str]:
    """Return over which readings as many targets would tell all of `names` by themselves."""
    low, high = np.rad2deg([rows.alpha2_rad.min(), rows.alpha2_rad.max()])
    model = fit.structure
    unit, wanted = beforehand(model), [model.free.index(name) for name in names]
    each = np.eye(len(unit))[wanted]
    for half in HALF_WIDTHS_DEG:
        if 90 - half > low and 90 + half < high:
            continue
        stretched = _stretched(rows, fit, half_rad=float(np.deg2rad(half)))
        known = Information.of(slopes(stretched, fit) * unit)
        if known.std(each).max() <= UNDETERMINED:
            return [
                f"spread them over readings from {90 - half:.0f} to {90 + half:.0f} deg "
                f"(now {low:.0f} to {high:.0f})"
            ]
    return []


def _stretched(rows: Observations, fit: RobustFit, *, half_rad: float) -> Observations:
    """Return the rows at the same depths with their readings spread to 90 deg +- `half_rad`."""
    reading = rows.alpha2_rad
    low, span = float(reading.min()), float(np.ptp(reading))
    share = (reading - low) / span if span > 0 else np.linspace(0, 1, len(rows))
    turned = replace(
        rows,
        alpha2_rad=np.pi / 2 + half_rad * (2 * share - 1),
        gaze_residual_rad=np.zeros(len(rows)),
    )
    # The misclosure is linear in x1c: where it is nought C1 sees the target.
    c = misclosure(fit.theta, turned.gaze, rows.z_mm, parameters=())
    return replace(turned, x1c=rows.x1c - c.value / c.by_observable[:, OBSERVABLE.x1c])


def _gate(model: Model, worst: float, combinations: tuple[Combination, ...]) -> Gate:
    passed = worst <= PREDICTED_LIMIT_REL
    detail = (
        f"the parameters of {model.name} leave the rows' depths uncertain by {100 * worst:.2g} % "
        f"at most (limit {100 * PREDICTED_LIMIT_REL:.0f} %)"
    )
    words = list(dict.fromkeys(c.words for c in reversed(combinations) if c.words))
    if not passed:
        detail += "; " + ("; ".join(words) or "add targets, or state their depths more exactly")
    return Gate("identified", passed=passed, detail=detail)
