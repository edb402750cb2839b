"""One rig: which mistakes of a lab the diagnosis names, and whether it names one where none is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence

from calib.core.arrays import FloatArray
from calib.core.errors import CalibError, EstimationError
from calib.diagnosis.bases import most_evident
from calib.diagnosis.engine import Tried
from calib.diagnosis.independent import diagnose_references
from calib.diagnosis.second import Task
from calib.diagnosis.session import HistoryArrays, RowHistory
from calib.fit.noise import own_sigma
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.misclosure import depth_jacobian, misclosure, misclosure_value
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE, depth
from calib.instrument.calibrated import instrument_from_draws, tabulate_depths
from calib.rows.from_table import ValidationRows
from calib.rows.observations import Observations
from calib.simulate.faults import FAULTS, FULL_STEP_COUNTS, Context, spoil
from calib.study.conditions import CONDITIONS, MISTAKES
from calib.study.rigs import INSIDE, StudiedRig, set_up
from calib.study.scores import HARM

ROW_COUNTS = (14, 24, 60)

PAIR_ROWS, PAIRS = (24, 60), 3
"""Rigs with so many rows have two mistakes at once, in so many ways each."""

MODEL = "axis-offset"
"""Model of the rigs."""

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

VALIDATED = 6
"""Validation depths of rigs that have some."""

DRAWS, GRID = 600, 5
"""Draws and depths of the table against which effects are held."""

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
            "clean_with_depths": _clean_with_depths(seed, number),
            "mistakes": [one for rows in ROW_COUNTS for one in _mistakes(rows, seed, number)],
            "pairs": [one for rows in PAIR_ROWS for one in _pairs(rows, seed, number)],
        }
    except CalibError as error:
        return record | {"failed": str(error)}


def _clean(name: str, seed: int, number: int) -> list[str] | None:
    """Return the names given to a rig without a mistake, None where it cannot be calibrated."""
    bench = set_up(CONDITIONS[name], seed=seed, number=number)
    try:
        fit = _fitted(bench.rows, bench.priors, bench)
    except EstimationError:
        return None
    found, second = _tried(bench.rows, bench.priors, fit, bench)
    return [*_named(found), *_named(second)]


def _clean_with_depths(seed: int, number: int) -> list[list[str]]:
    """Return the names given to sound rigs of all sizes that have validation depths."""
    found = []
    for rows in ROW_COUNTS:
        condition = replace(CONDITIONS["axis-offset-14"], rows=rows)
        bench = set_up(condition, seed=seed, number=number)
        rng = np.random.default_rng((seed, len(FAULTS) + 1, rows, number))
        task = Task(bench.rows, bench.priors, _fitted(bench.rows, bench.priors, bench),
                    _history(bench))  # fmt: skip
        tried = task.tried()
        found.append([] if tried is None else _with_depths(task, tried, bench, {}, rng))
    return found


def _mistakes(rows: int, seed: int, number: int) -> Iterator[Record]:
    """Yield what comes of each mistake on so many rows of a rig."""
    condition = replace(CONDITIONS["axis-offset-14"], rows=rows)
    bench = set_up(condition, seed=seed, number=number)
    silent = _silent(bench.priors)
    told = silent if number % 2 else bench.priors
    clean = {
        is_reference: fit_model(bench.rows, silent if is_reference else told, model=MODEL)
        for is_reference in (False, True)
    }
    for place, fault in enumerate(FAULTS):
        if fault not in NOT_IN_ROWS:
            known = replace(bench, priors=silent if fault == REFERENCE else told)
            rng = np.random.default_rng((seed, place, rows, number))
            yield _mistake(fault, known, clean[fault == REFERENCE], rng)


def _pairs(rows: int, seed: int, number: int) -> Iterator[Record]:
    """Yield what comes of some pairs of mistakes on so many rows of a rig."""
    bench = set_up(replace(CONDITIONS["axis-offset-14"], rows=rows), seed=seed, number=number)
    clean = fit_model(bench.rows, bench.priors, model=MODEL)
    rng = np.random.default_rng((seed, len(FAULTS), rows, number))
    for _ in range(PAIRS):
        yield _pair(bench, clean, rng)


def _mistake(fault: str, bench: StudiedRig, clean: RobustFit, rng: Generator) -> Record:
    """Return what comes of one mistake.

    Parameters
    ----------
    clean
        The fit without it.
    """
    value, wrong, later = spoiled(fault, bench, clean, rng)
    record: Record = {"fault": fault, "rows": len(wrong), "value": value}
    try:
        fit = _fitted(wrong, bench.priors, bench)
    except EstimationError:
        return record | {"effect": None, "gain": None, "named": []}
    found, second = _tried(wrong, bench.priors, fit, bench)
    own = None if found is None else found.outcomes.get(fault)
    effect, with_depths = _effect(clean, fit, bench.rows, later), None
    if found is not None and effect > HARM:
        task = Task(wrong, bench.priors, fit, _history(bench))
        with_depths = _with_depths(task, found, bench, {fault: value}, rng)
    return record | {
        "model": fit.model,
        "effect": effect,
        "gain": None if own is None else own.gain,
        "named": _named(found),
        "beside": _named(second),
        "with_depths": with_depths,
    }


def _with_depths(
    task: Task, tried: Tried, bench: StudiedRig, faults: Mapping[str, float], rng: Generator
) -> list[str]:
    """Return the names given once there are some validation depths, two of either kind at most.

    The depths count from C1's optical centre; readings have the mistakes that are of the rig.
    """
    fit, rows = task.fit, task.rows
    draws = rng.multivariate_normal(fit.values, fit.covariance, DRAWS)
    noise = np.full((DRAWS, 1), np.log(fit.noise_scale))
    nothing = np.zeros((DRAWS, 0))
    calibrated = instrument_from_draws(np.hstack([draws, noise]), nothing, fit, rows, bench.setup)
    low, high = float(rows.z_mm.min()), float(rows.z_mm.max())
    table = tabulate_depths(calibrated, low_mm=low, high_mm=high, seed=SeedSequence(1), points=GRID)
    some = np.arange(min(VALIDATED, len(bench.true_depths_mm[INSIDE])))
    tests = bench.tests[INSIDE].take(some)
    errors = rng.standard_normal(len(some)) * tests.std[:, OBSERVABLE.z]
    context = Context(bench.rig.resolution_rad, rng)
    read = spoil(tests, faults, context, validation=True)
    validation = ValidationRows(
        replace(read, z_mm=bench.true_depths_mm[INSIDE][some] + errors), some, {}
    )
    found = diagnose_references(
        tried.diagnosis(table), calibrated, fit, rows, validation, None, table, task.history
    )
    by_rows = [cause.name for cause in found.causes if cause.seen_in == "rows"]
    others = [cause.name for cause in found.causes if cause.seen_in != "rows"]
    return by_rows[:2] + others[:2]


def _pair(bench: StudiedRig, clean: RobustFit, rng: Generator) -> Record:
    """Return what comes of two different mistakes at once."""
    some = [fault for fault in FAULTS if fault not in (*NOT_IN_ROWS, REFERENCE)]
    pair = [str(name) for name in rng.choice(some, 2, replace=False)]
    record: Record = {"faults": pair, "rows": len(bench.rows), "values": []}
    wrong = later = bench.rows
    for fault in pair:
        value, wrong, later = spoiled(fault, bench, clean, rng, wrong, later)
        record["values"].append(value)
    try:
        fit = _fitted(wrong, bench.priors, bench)
    except EstimationError:
        return record | {"effect": None, "named": [], "beside": []}
    found, second = _tried(wrong, bench.priors, fit, bench)
    return record | {
        "model": fit.model,
        "effect": _effect(clean, fit, bench.rows, later),
        "named": _named(found),
        "beside": _named(second),
    }


def _named(found: Tried | None) -> list[str]:
    return [] if found is None else list(found.named)


def _fitted(rows: Observations, priors: Priors, bench: StudiedRig) -> RobustFit:
    """Return the fit of the model with the greatest evidence.

    The chain selects by left-out density, which takes a sample of each model's posterior.
    """
    usual = fit_model(rows, priors, model=MODEL)
    session = HistoryArrays.of(rows, _history(bench), is_left=False)
    model = most_evident(rows, session, priors, usual)
    return usual if model == MODEL else fit_model(rows, priors, model=model)


def _silent(priors: Priors) -> Priors:
    """Return what is known where nothing is said of the place from which z_mm counts."""
    default = PARAMETERS[INDEX[REFERENCE_OFFSET]].prior_std or 0.0
    return replace(priors, stated={REFERENCE_OFFSET: (0.0, default), **priors.stated})


def spoiled(
    fault: str,
    bench: StudiedRig,
    clean: RobustFit,
    rng: Generator,
    rows: Observations | None = None,
    later: Observations | None = None,
) -> tuple[float, Observations, Observations]:
    """Return the mistake's size in its unit, the rows with it, and as they would be read later.

    Parameters
    ----------
    rows, later
        Rows on which it is made; those of the bench by default.
    """
    step, own = bench.rig.resolution_rad, int(rng.integers(2**63))
    value = FAULTS[fault].value

    def made(on: Observations | None, size: float, *, later: bool = False) -> Observations:
        context = Context(step, np.random.default_rng(own))
        return spoil(bench.rows if on is None else on, {fault: size}, context, validation=later)

    if fault not in UNSIZED:
        wanted = float(np.exp(rng.uniform(*np.log(SIZES))))
        value *= wanted / size_of(made(None, value), bench.rows, clean.theta)
    if fault == "microstep":
        most = MOST_OF_FULL_STEP * FULL_STEP_COUNTS * float(np.rad2deg(step))
        value = float(np.clip(value, -most, most))
    return value, made(rows, value), made(later, value, later=True)


def size_of(wrong: Observations, rows: Observations, theta: FloatArray) -> float:
    """Return by how many standard uncertainties misclosures change, at most."""
    at = misclosure(theta, rows.gaze, rows.z_mm, parameters=())
    change = misclosure_value(theta, wrong.gaze, wrong.z_mm) - at.value
    return float(np.abs(change / own_sigma(at, rows.std)).max())


def _tried(
    rows: Observations, priors: Priors, fit: RobustFit, bench: StudiedRig
) -> tuple[Tried | None, Tried | None]:
    """Return what was tried, and what was beside the first cause that is named."""
    task = Task(rows, priors, fit, _history(bench))
    found = task.tried()
    return (None, None) if found is None else task.with_second(found)


def _history(bench: StudiedRig) -> RowHistory:
    resolution = bench.rig.resolution_rad
    return RowHistory({}, {}, resolution, FULL_STEP_COUNTS * resolution)


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
