"""Calibrations of one rig over time: which parameters have changed, and by how much."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from scipy.stats import chi2, norm

from calib.arrays import FloatArray
from calib.errors import InputError, UsageError
from calib.geometry.parameters import INDEX, MODELS, PARAMETERS

FILE = "calibration.json"

FAMILY_RISK = 0.05
"""Chance that any change is called significant where there is none (Holm 1979)."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class _Fit(_Section):
    names: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    parameters: dict[str, dict[str, float | str]]


class _Depth(_Section):
    z_mm: float
    u_mm: float | None = None
    extrapolated: bool = False


class _Score(_Section):
    model: str
    loo: float
    cv_depth_rms_rel: float | None = None
    validation_depth_rms_rel: float | None = None


class _Dataset(_Section):
    name: str
    sha256: str


class _Gate(_Section):
    name: str
    passed: bool


class _Run(_Section):
    format: Literal[1]
    dataset: _Dataset
    fits: dict[str, _Fit]
    selected: str
    depth_uncertainty: tuple[_Depth, ...] = ()
    comparison: tuple[_Score, ...] = ()
    gates: tuple[_Gate, ...] = ()


@dataclass(frozen=True)
class RunSummary:
    """One run as far as it is compared.

    Parameters
    ----------
    label
        Its folder's name.
    dataset
        Name of its dataset.
    selected
        Model that the run selected.
    passed
        Whether all its gates passed.
    values, covariance
        Of the compared model's parameters, `Drift.names`, shapes (p,) and (p, p).
    loo, cv_depth_rms_rel, validation_depth_rms_rel
        Scores of the compared model; None where the run has none.
    depths
        Depth and standard uncertainty of the selected model inside the calibrated range, mm.
    """

    label: str
    dataset: str
    selected: str
    passed: bool
    values: FloatArray
    covariance: FloatArray
    loo: float | None
    cv_depth_rms_rel: float | None
    validation_depth_rms_rel: float | None
    depths: tuple[tuple[float, float], ...]

    @property
    def std(self) -> FloatArray:
        """Standard uncertainties, shape (p,)."""
        std: FloatArray = np.sqrt(np.diag(self.covariance))
        return std


@dataclass(frozen=True)
class Change:
    """Change of one parameter from the first run to another.

    Parameters
    ----------
    run
        Label of the other run.
    name
        The parameter.
    difference, std
        Other less first, and its standard uncertainty, taking the runs as independent.
    significant
        Whether the change is real at a family-wise risk of `FAMILY_RISK`.
    """

    run: str
    name: str
    difference: float
    std: float
    significant: bool

    @property
    def sigmas(self) -> float:
        """The change in units of its uncertainty."""
        return self.difference / self.std


@dataclass(frozen=True)
class Drift:
    """Runs side by side.

    Parameters
    ----------
    model
        The model compared: the richest that all runs have fitted and one has selected.
    names, units
        Its parameters and "effective_baseline_mm" where it has an eccentricity.
    runs
        In the order given.
    changes
        Against the first run.
    joint
        For each further run the probability of changes as large as these, all parameters
        together, where nothing has changed.
    """

    model: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    runs: tuple[RunSummary, ...]
    changes: tuple[Change, ...]
    joint: tuple[float, ...]


def read_runs(paths: Sequence[Path]) -> tuple[tuple[str, _Run], ...]:
    """Return the runs in folders or calibration.json files, each with its label.

    Raises
    ------
    InputError
        With every file that is no calibration with gaze rows.
    UsageError
        If there are fewer than two.
    """
    if len(paths) < 2:
        raise UsageError("compare needs two runs or more: folders in reports/, or calibration.json")
    problems, runs = [], []
    for path in paths:
        file = path / FILE if path.is_dir() else path
        try:
            runs.append((str(path), _Run.model_validate(json.loads(file.read_text("utf-8")))))
        except OSError as error:
            problems.append(_bad(file, f"cannot be read ({error.strerror})"))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            problems.append(_bad(file, f"{where}: {first['msg']}"))
        except (ValueError, RecursionError):
            problems.append(_bad(file, "is no JSON"))
    if problems:
        raise InputError([p for error in problems for p in error.problems])
    return tuple(runs)


def _bad(path: Path, what: str) -> InputError:
    remedy = "give the folder of a finished run with gaze rows; calibrate it again"
    return InputError.single(where=str(path), what=what, remedy=remedy)


def compare_runs(paths: Sequence[Path]) -> Drift:
    """Return the drift between runs of one rig, the first one being the reference.

    Raises
    ------
    InputError, UsageError
        If they cannot be read, or no model was fitted in all of them.
    """
    read = read_runs(paths)
    model = _common_model([run for _, run in read])
    names = MODELS[model].free
    derived = "eccentricity_mm" in names
    runs = tuple(_summary(label, run, model, derived=derived) for label, run in read)
    shown = (*names, "effective_baseline_mm") if derived else names
    units = tuple(PARAMETERS[INDEX[n]].unit if n in INDEX else "mm" for n in shown)
    changes = [
        (run.label, name, *_difference(runs[0], run, i))
        for run in runs[1:]
        for i, name in enumerate(shown)
    ]
    real = _holm([2 * float(norm.sf(abs(d / s))) for _, _, d, s in changes])
    return Drift(
        model=model,
        names=shown,
        units=units,
        runs=runs,
        changes=tuple(
            Change(label, name, d, s, yes)
            for (label, name, d, s), yes in zip(changes, real, strict=True)
        ),
        joint=tuple(_joint(runs[0], run, len(names)) for run in runs[1:]),
    )


def _common_model(runs: Sequence[_Run]) -> str:
    fitted = set.intersection(
        *({key.split("/")[0] for key in run.fits if key.endswith("/posterior")} for run in runs)
    )
    fitted &= set(MODELS)
    if not fitted:
        raise UsageError("the runs have no fitted model in common; calibrate them again")
    wanted = {run.selected for run in runs} & fitted or fitted
    return max(wanted, key=lambda name: len(MODELS[name].free))


def _summary(label: str, run: _Run, model: str, *, derived: bool) -> RunSummary:
    fit, free = run.fits[f"{model}/posterior"], MODELS[model].free
    try:
        place = [fit.names.index(name) for name in free]
        values = np.array([float(fit.parameters[name]["value"]) for name in free])
        covariance = np.array(fit.covariance, dtype=np.float64)[np.ix_(place, place)]
    except (KeyError, ValueError, IndexError):
        raise _bad(Path(label), f"fits, {model}/posterior: is damaged") from None
    if derived:
        pick = np.array([n in ("baseline_mm", "eccentricity_mm") for n in free], dtype=float)
        extend = np.vstack([np.eye(len(free)), pick])
        values, covariance = extend @ values, extend @ covariance @ extend.T
    score = next((s for s in run.comparison if s.model == model), None)
    return RunSummary(
        label=label,
        dataset=run.dataset.name,
        selected=run.selected,
        passed=all(gate.passed for gate in run.gates),
        values=values,
        covariance=covariance,
        loo=None if score is None else score.loo,
        cv_depth_rms_rel=None if score is None else score.cv_depth_rms_rel,
        validation_depth_rms_rel=None if score is None else score.validation_depth_rms_rel,
        depths=tuple(
            (d.z_mm, d.u_mm)
            for d in run.depth_uncertainty
            if d.u_mm is not None and not d.extrapolated
        ),
    )


def _difference(first: RunSummary, other: RunSummary, i: int) -> tuple[float, float]:
    return float(other.values[i] - first.values[i]), float(np.hypot(other.std[i], first.std[i]))


def _holm(probabilities: Sequence[float]) -> list[bool]:
    """Return which hypotheses of no change fall, at a family-wise risk of `FAMILY_RISK`."""
    order = np.argsort(probabilities)
    falls = [False] * len(probabilities)
    for rank, i in enumerate(order):
        if probabilities[i] > FAMILY_RISK / (len(probabilities) - rank):
            break
        falls[i] = True
    return falls


def _joint(first: RunSummary, other: RunSummary, free: int) -> float:
    """Return the probability of a joint change as large, by chi squared on the free parameters."""
    change = (other.values - first.values)[:free]
    covariance = (other.covariance + first.covariance)[:free, :free]
    unit = np.sqrt(np.diag(covariance))
    white = change / unit
    distance = white @ np.linalg.solve(covariance / np.outer(unit, unit), white)
    return float(chi2.sf(distance, free))
