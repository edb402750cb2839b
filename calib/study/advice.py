"""One rig: whether the advice of `calib plan` beats random targets."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.core.errors import CalibError
from calib.fit.information import row_information
from calib.fit.priors import Priors, prior_of
from calib.fit.robust import fit_model
from calib.geometry.parameters import MODELS
from calib.geometry.plane import OBSERVABLE
from calib.plan.advise import advise, regular
from calib.plan.design import Knowledge, RowNoise, depth_vectors, relative_variance
from calib.plan.field import Field, field_of
from calib.rows.observations import Observations
from calib.simulate.rig import TrueRig, draw_rig
from calib.simulate.tables import draw_targets, observe
from calib.study.conditions import ADVICE

MODEL = "axis-offset"

ROWS_SO_FAR, ROWS_MORE = 6, 6

REACH = 1.5
"""The asked depth is drawn between the near end and so many times the far end of the depths at
which targets can be put."""

RANDOM = "random"

Record = dict[str, Any]


def run_advice(*, seed: int, number: int) -> Record:
    """Return what advised and random targets leave uncertain on rig `number`, ready for JSON.

    Six random rows are calibrated; six more are put where the advice says, or anywhere; both sets
    of twelve are simulated and calibrated anew. `u_rel` is the relative standard uncertainty of
    the asked depth from the parameters alone, as these fits state it.
    """
    record: Record = {"condition": ADVICE, "seed": seed, "number": number}
    try:
        return record | _compared(SeedSequence((seed, number, 2)))
    except CalibError as error:
        return record | {"failed": str(error)}


def _compared(seeds: SeedSequence) -> Record:
    for_rig, for_targets, for_advice, for_depth, *for_rows = seeds.spawn(7)
    rig = draw_rig(np.random.default_rng(for_rig), model=MODEL)
    between = rig.depth_range_mm
    targets = np.random.default_rng(for_targets)
    first = draw_targets(rig, targets, count=ROWS_SO_FAR, depth_range_mm=between)
    anywhere = draw_targets(rig, targets, count=ROWS_MORE, depth_range_mm=between)
    depth = float(np.random.default_rng(for_depth).uniform(between[0], REACH * between[1]))
    noise_of = [np.random.default_rng(s) for s in for_rows]
    rows = observe(rig, noise_of[0], first).observed
    fit = fit_model(rows, Priors({}), model=MODEL)
    knowledge = Knowledge(
        MODELS[MODEL],
        fit.theta,
        row_information(rows, fit) + prior_of(MODELS[MODEL], Priors({})).precision,
        fit.noise_scale,
    )
    field = field_of(
        rig.c1, rig.c2, seen_x1c=rows.x1c, seen_y1c=rows.y1c, yaw_rad=rig.yaw_range_rad
    )
    advice = advise(
        knowledge,
        field,
        RowNoise(np.median(rows.std[:, : OBSERVABLE.z], axis=0), rig.noise.z_mm, rig.noise.z_rel),
        np.random.default_rng(for_advice),
        asked_mm=np.array([depth]),
        between_mm=between,
        count=ROWS_MORE,
    )
    more = {RANDOM: anywhere} | {name: t.points_mm for name, t in advice.targets.items()}
    left = {
        name: _left(rig, field, np.concatenate([first, points]), depth, _rng(for_rows[1]))
        for name, points in more.items()
    }
    before = float(advice.before_rel[0])
    return {"depth_mm": round(depth, 3), "before_rel": before, "u_rel": left}


def _rng(seed: SeedSequence) -> np.random.Generator:
    return np.random.default_rng(seed)


def _left(
    rig: TrueRig, field: Field, points: FloatArray, depth: float, rng: np.random.Generator
) -> float:
    """Return the relative standard uncertainty of a depth after calibrating with `points`."""
    rows: Observations = observe(rig, rng, points).observed
    fit = fit_model(rows, Priors({}), model=MODEL)
    information = row_information(rows, fit) + prior_of(MODELS[MODEL], Priors({})).precision
    after = Knowledge(MODELS[MODEL], fit.theta, information)
    asked = depth_vectors(after, field, np.array([depth]))
    covariance = np.asarray(np.linalg.inv(regular(after)), dtype=np.float64)
    return float(np.sqrt(relative_variance(covariance, asked)[0]))
