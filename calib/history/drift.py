"""Changes between runs of one rig, in units of their joint uncertainty.

Runs are taken as independent: what they share (the same board, the same ruler) cancels in the
difference, so that the true significance is if anything higher. Rows that both were fitted to do so
too, and are counted. Priors that both contain do not cancel: a parameter that prior knowledge
identifies hardly drifts, whatever the rig does. A run whose gates failed gives no verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, ndtri

from calib.core.arrays import FloatArray
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.geometry.plane import Gaze, depth, gaze_at
from calib.instrument.calibration_file import Measuring
from calib.rows.sketch import RowSketch
from calib.uncertainty.measurement import ParameterKnowledge

FAMILY_RISK = 0.05
"""Chance that any change of an unchanged rig is called significant, over one pair of runs."""

DEPTHS = 3
"""Depths at which readings are compared: the ends and the middle of what both runs cover."""

EFFECTIVE = "effective_baseline_mm"


@dataclass(frozen=True)
class ComparedRun:
    """One run as far as it is compared.

    Parameters
    ----------
    name
        Path as given.
    dataset, model
        Names of dataset and selected model.
    measuring
        The instrument.
    identified_by
        By parameter: "data", "prior" or "both".
    scores
        Predictive scores by name, as far as the run has them.
    dataset_sha256
        Fingerprint of the dataset; empty if the run does not say it.
    rows
        By which runs see whether they share rows; None if the run does not say it.
    depth_u
        Depths and standard uncertainties there, mm, shape (n,) each, as the run tabulated them.
    """

    name: str
    dataset: str
    model: str
    measuring: Measuring
    identified_by: Mapping[str, str]
    scores: Mapping[str, float]
    dataset_sha256: str = ""
    rows: RowSketch | None = None
    depth_u: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the gates that failed: the result must not be used."""
        return tuple(gate.name for gate in self.measuring.failed_gates)

    @property
    def of_the_rig(self) -> ParameterKnowledge:
        """The parameters, without the origin of the reference depths: that is of the rows."""
        p = self.measuring.instrument.parameters
        kept = [i for i, name in enumerate(p.names) if name != REFERENCE_OFFSET]
        return ParameterKnowledge(
            names=tuple(p.names[i] for i in kept),
            values=p.values[kept],
            covariance=p.covariance[np.ix_(kept, kept)],
            degrees_of_freedom=p.degrees_of_freedom,
            evaluation=tuple(p.evaluation[i] for i in kept),
        )

    def u_at(self, z_mm: float) -> float | None:
        """Return u(z) at a depth, interpolated in the run's table; None outside of it.

        Both logarithms are taken: u grows as a power of the depth.
        """
        z, u = self.depth_u
        if not z or not min(z) <= z_mm <= max(z):
            return None
        return float(np.exp(np.interp(np.log(z_mm), np.log(z), np.log(u))))

    def estimates(self) -> dict[str, tuple[float, float]]:
        """Return value and standard uncertainty by parameter, L_b + e among them."""
        p = self.of_the_rig
        std = np.sqrt(np.diag(p.covariance))
        found = {n: (float(v), float(s)) for n, v, s in zip(p.names, p.values, std, strict=True)}
        pick = np.array([float(n in ("baseline_mm", "eccentricity_mm")) for n in p.names])
        found[EFFECTIVE] = float(pick @ p.values), float(np.sqrt(pick @ p.covariance @ pick))
        return found


@dataclass(frozen=True)
class Change:
    """A change from the first run to another.

    Parameters
    ----------
    what
        Parameter, or the depth at which readings are compared.
    unit
        Of the change.
    difference, std
        Later less earlier value, and the joint standard uncertainty.
    significant
        Whether it is larger than chance would make any of the pair's changes at `FAMILY_RISK`.
    note
        What to keep in mind; empty if nothing.
    """

    what: str
    unit: str
    difference: float
    std: float
    significant: bool
    note: str

    @property
    def sigmas(self) -> float:
        """The change in units of its standard uncertainty."""
        return self.difference / self.std if self.std > 0 else 0.0


@dataclass(frozen=True)
class Drift:
    """All changes from the first run to another.

    Parameters
    ----------
    first, other
        Names of the runs.
    changes
        Of parameters free in both, and of depths.
    p_value
        Probability of parameters as different as these, together, if nothing has changed; the
        single changes do not see a change along strongly correlated parameters. None without
        parameters free in both.
    failed
        Names of the two runs whose gates failed: they give no verdict.
    notes
        Why the runs are not independent, as far as they are not.
    """

    first: str
    other: str
    changes: tuple[Change, ...]
    p_value: float | None
    failed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """What the comparison comes to, in words."""
        if self.failed:
            return f"no verdict: gates of {' and '.join(self.failed)} failed"
        if self.significant:
            return "a significant change"
        return "no significant change"

    @property
    def significant(self) -> bool:
        """Whether the rig has changed."""
        together = self.p_value is not None and self.p_value < FAMILY_RISK
        return together or any(change.significant for change in self.changes)


def accepted(run: ComparedRun) -> ComparedRun:
    """Return a run whose failed gates its user accepts."""
    return replace(run, measuring=replace(run.measuring, failed_gates=()))


def drift(first: ComparedRun, other: ComparedRun) -> Drift:
    """Return the changes from one run to another."""
    earlier, later = first.estimates(), other.estimates()
    shared = [name for name in later if name in earlier]
    if first.model != other.model:
        # Under another model L_b and the rest mean something else; L_b + e and depths do not.
        shared = [EFFECTIVE]
    depths = _depth_changes(first, other)
    limit = float(-ndtri(FAMILY_RISK / 2 / (len(shared) + len(depths))))
    changes = []
    for name in shared:
        (a, u), (b, v) = earlier[name], later[name]
        changes.append(_change(name, _unit(name), b - a, np.hypot(u, v), limit, _note(
            name, first, other)))  # fmt: skip
    for z, difference, std in depths:
        changes.append(_change(f"reading of {z:.0f} mm", "mm", difference, std, limit, ""))
    return Drift(
        first.name, other.name, tuple(changes), _together(first, other),
        failed=tuple(run.name for run in (first, other) if run.failed),
        notes=_common(first, other),
    )  # fmt: skip


def _common(first: ComparedRun, other: ComparedRun) -> tuple[str, ...]:
    """Return what two runs have in common, so that they are not independent."""
    if first.dataset_sha256 and first.dataset_sha256 == other.dataset_sha256:
        return ("the same dataset: differences come from settings, seed or version, not the rig",)
    if first.rows is None or other.rows is None:
        return ()
    shared = first.rows.shared_with(other.rows)
    if not shared:
        return ()
    return (
        f"{shared} of {other.rows.count} gaze rows are those of the first run: their errors "
        "cancel, the stated u of a change is too large, and a change may hide",
    )


def _change(what: str, unit: str, difference: float, std: float, limit: float, note: str) -> Change:
    significant = bool(abs(difference) > limit * std)
    return Change(what, unit, float(difference), float(std), significant, note)


def _unit(name: str) -> str:
    return "mm" if name == EFFECTIVE else PARAMETERS[INDEX[name]].unit


def _note(name: str, first: ComparedRun, other: ComparedRun) -> str:
    decided = [run.identified_by.get(name) for run in (first, other)]
    return "identified by prior knowledge" if "prior" in decided else ""


def _together(first: ComparedRun, other: ComparedRun) -> float | None:
    """Return the chi-squared p of all parameters' differences, for runs of one model."""
    a, b = first.of_the_rig, other.of_the_rig
    if first.model != other.model or a.names != b.names:
        return None
    difference = b.values - a.values
    unit = np.array([PARAMETERS[INDEX[name]].scale for name in a.names])
    joint = (a.covariance + b.covariance) / np.outer(unit, unit)
    square = float(difference / unit @ np.linalg.pinv(joint, hermitian=True) @ (difference / unit))
    return float(chdtrc(len(unit), square))


def _depth_changes(first: ComparedRun, other: ComparedRun) -> list[tuple[float, float, float]]:
    """Return depth, change of what a reading there says, and its uncertainty, mm.

    From the parameters alone: the reading is the same.
    """
    ranges = first.measuring.calibrated_mm, other.measuring.calibrated_mm
    low, high = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if low >= high:
        return []
    z = np.linspace(low, high, DEPTHS)
    points = np.column_stack([np.zeros((DEPTHS, 2)), z])
    gaze = gaze_at(first.measuring.instrument.theta, points)
    # Both by the same steps: of equal runs the difference is 0, without errors of rounding.
    before, after = (depth(run.measuring.instrument.theta, gaze) for run in (first, other))
    variance = sum((_depth_variance(run, gaze) for run in (first, other)), np.zeros(DEPTHS))
    return [
        (float(at), float(difference), float(np.sqrt(v)))
        for at, difference, v in zip(z, after - before, variance, strict=True)
    ]


def _depth_variance(run: ComparedRun, gaze: Gaze) -> FloatArray:
    p = run.measuring.instrument.parameters
    slope = depth_jacobian(run.measuring.instrument.theta, gaze).by_theta
    chosen = slope[:, [INDEX[name] for name in p.names]]
    variance: FloatArray = np.einsum("ni,ij,nj->n", chosen, p.covariance, chosen)
    return variance


def drifts(runs: Sequence[ComparedRun]) -> tuple[Drift, ...]:
    """Return the changes from the first run to each of the others."""
    return tuple(drift(runs[0], other) for other in runs[1:])
