"""One rig: which mistakes of a lab the diagnosis names, and whether it names one where none is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from calib.core.arrays import FloatArray
from calib.core.errors import CalibError, EstimationError
from calib.diagnosis.engine import Tried
from calib.diagnosis.session import RowHistory
from calib.fit.noise import own_sigma
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.misclosure import depth_jacobian, misclosure, misclosure_value
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE, depth
from calib.rows.observations import Observations
from calib.simulate.faults import FAULTS, FULL_STEP_COUNTS, Context, spoil
from calib.study.conditions import CONDITIONS, MISTAKES
from calib.study.rigs import Bench, set_up

ROW_COUNTS = (14, 24, 60)

MODEL = "axis-offset"

SIZES = (3.0, 20.0)
"""A mistake moves the misclosure of some row by so many of its standard uncertainties."""

UNSIZED = ("range-not-depth", "rows-exchanged", "unit")
"""Mistakes that are made or not."""

NOT_IN_ROWS = ("reference-scale", "x-mirrored", "y-mirrored")
"""Mistakes that rows alone cannot show, and those that `calib check` refuses before."""

REFERENCE = "reference-offset"
"""The mistake of those who say nothing of where z_mm counts from."""

MOST_OF_FULL_STEP = 0.1
"""A motor's errors within a full step, over it: with larger ones its shaft would turn back."""

Record = dict[str, Any]


def run_faults(*, seed: int, number: int) -> Record:
    """Return what the diagnosis makes of rig `number`, with and without mistakes, ready for JSON.

    Without a mistake the rig is calibrated under all conditions of the study. With one it has
    14, 24 and 60 rows; the mistake's size is drawn anew each time. Every other rig says nothing of
    where `z_mm` counts from, as tables that name an unknown reference do.
    """
    record: Record = {"condition": MISTAKES, "seed": seed, "number": number}
    try:
        return record | {
            "clean": {name: _clean(name, seed, number) for name in CONDITIONS},
            "mistakes": [
                _mistake(fault, place, rows, seed, number)
                for place, fault in enumerate(FAULTS)
                for rows in ROW_COUNTS
                if fault not in NOT_IN_ROWS
            ],
        }
    except CalibError as error:
        return record | {"failed": str(error)}


def _clean(name: str, seed: int, number: int) -> list[str] | None:
    """Return the names given to a rig without a mistake, None where it cannot be calibrated."""
    condition = CONDITIONS[name]
    bench = set_up(condition, seed=seed, number=number)
    model = "base" if condition.model == "base" else MODEL
    try:
        fit = fit_model(bench.rows, bench.priors, model=model)
    except EstimationError:
        return None
    found = _tried(bench.rows, bench.priors, fit, bench)
    return [] if found is None else list(found.named)


def _mistake(fault: str, place: int, rows: int, seed: int, number: int) -> Record:
    """Return what comes of one mistake on so many rows of a rig."""
    condition = replace(CONDITIONS["axis-offset-14"], rows=rows)
    bench = set_up(condition, seed=seed, number=number)
    priors = _silent(bench.priors) if number % 2 or fault == REFERENCE else bench.priors
    rng = np.random.default_rng((seed, place, rows, number))
    clean = fit_model(bench.rows, priors, model=MODEL)
    value, wrong, later = spoiled(fault, bench, clean, rng)
    record: Record = {"fault": fault, "rows": rows, "value": value}
    try:
        fit = fit_model(wrong, priors, model=MODEL)
    except EstimationError:
        return record | {"effect": None, "gain": None, "named": []}
    found = _tried(wrong, priors, fit, bench)
    own = None if found is None else found.outcomes.get(fault)
    return record | {
        "effect": _effect(clean, fit, bench.rows, later),
        "gain": None if own is None else own.gain,
        "named": [] if found is None else list(found.named),
    }


def _silent(priors: Priors) -> Priors:
    """Return what is known where nothing is said of the place from which z_mm counts."""
    default = PARAMETERS[INDEX[REFERENCE_OFFSET]].prior_std or 0.0
    return replace(priors, stated={REFERENCE_OFFSET: (0.0, default), **priors.stated})


def spoiled(
    fault: str, bench: Bench, clean: RobustFit, rng: Generator
) -> tuple[float, Observations, Observations]:
    """Return the mistake's size in its unit, the rows with it, and as they would be read later."""
    step, own = bench.rig.resolution_rad, int(rng.integers(2**63))
    value = FAULTS[fault].value

    def rows_with(size: float, *, later: bool = False) -> Observations:
        context = Context(step, np.random.default_rng(own))
        return spoil(bench.rows, {fault: size}, context, validation=later)

    if fault not in UNSIZED:
        wanted = float(np.exp(rng.uniform(*np.log(SIZES))))
        value *= wanted / size_of(rows_with(value), bench.rows, clean.theta)
    if fault == "microstep":
        most = MOST_OF_FULL_STEP * FULL_STEP_COUNTS * float(np.rad2deg(step))
        value = float(np.clip(value, -most, most))
    return value, rows_with(value), rows_with(value, later=True)


def size_of(wrong: Observations, rows: Observations, theta: FloatArray) -> float:
    """Return by how many standard uncertainties misclosures change, at most."""
    at = misclosure(theta, rows.gaze, rows.z_mm, parameters=())
    change = misclosure_value(theta, wrong.gaze, wrong.z_mm) - at.value
    return float(np.abs(change / own_sigma(at, rows.std)).max())


def _tried(rows: Observations, priors: Priors, fit: RobustFit, bench: Bench) -> Tried | None:
    resolution = bench.rig.resolution_rad
    history = RowHistory({}, {}, resolution, FULL_STEP_COUNTS * resolution)
    return Tried.of(rows, priors, fit, history, is_left=False)


def _effect(clean: RobustFit, spoiled: RobustFit, rows: Observations, later: Observations) -> float:
    """Return by how many of the u that is stated a mistake moves a depth of the rows, at most."""
    at = depth_jacobian(spoiled.theta, later.gaze)
    own = [INDEX[name] for name in spoiled.names]
    by_theta = at.by_theta[:, own]
    variance = np.einsum("ni,ij,nj->n", by_theta, spoiled.covariance, by_theta)
    readings = at.by_observable * later.std[:, : OBSERVABLE.z] * max(1.0, spoiled.noise_scale)
    u = np.sqrt(variance + (readings**2).sum(axis=1))
    change = np.abs(at.z - depth(clean.theta, rows.gaze)) / u
    return float(np.max(change[np.isfinite(change)], initial=0.0))
