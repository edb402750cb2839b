"""Rigs whose rows come in poses of the board, with one reference depth a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.fit.importance import ImportanceSample, sample_importance
from calib.fit.posterior import laplace, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit
from calib.geometry.plane import OBSERVABLE
from calib.instrument.calibrated import CalibratedInstrument, instrument_from_draws
from calib.rows.from_table import RowSettings, Setup
from calib.rows.observations import Observations, depth_groups
from calib.simulate.rig import TrueRig, draw_rig
from calib.simulate.tables import draw_targets, observe

DRAWS = 4000
BOARD_DEPTH = 0.03
"""Targets of a pose are this near its depth, relatively: a tilted board."""

TESTS = 20


@dataclass(frozen=True)
class Bench:
    """A rig, its rows, test readings inside the range of the rows and their true depths."""

    rig: TrueRig
    rows: Observations
    tests: Observations
    true_depths_mm: np.ndarray


def bench(
    seed: int, *, model: str, poses: int, targets: int, u_own: float, u_group: float
) -> Bench:
    """Return a bench whose reference depths err by `u_own` a row and `u_group` a pose, relative.

    Of the poses nothing is stated yet: see `stated`.
    """
    rng = np.random.default_rng((seed, poses, targets))
    rig = draw_rig(rng, model=model, fixed={})
    rig = replace(rig, noise=replace(rig.noise, z_rel=u_own, z_mm=0.0))
    depths = rng.uniform(*rig.depth_range_mm, poses)
    points = [
        draw_targets(
            rig, rng, count=targets, depth_range_mm=((1 - BOARD_DEPTH) * z, (1 + BOARD_DEPTH) * z)
        )
        for z in depths
    ]
    own = np.concatenate(points)
    near, far = float(own[:, 2].min()), float(own[:, 2].max())
    tests = draw_targets(rig, rng, count=TESTS, depth_range_mm=(near, far))
    seen = observe(rig, rng, np.concatenate([own, tests])).observed
    pose = np.repeat(np.arange(poses), targets)
    rows = seen.take(np.arange(len(own)))
    error = 1 + u_group * rng.standard_normal(poses)[pose]
    rows = replace(rows, z_mm=rows.z_mm * error, groups=tuple(f"pose {k}" for k in pose.tolist()))
    return Bench(rig, rows, seen.take(np.arange(len(own), len(seen))), tests[:, 2])


def stated(rows: Observations, u_group: float) -> Observations:
    """Return rows that say of their poses what `rows.from_table` would make of `u_z_group_rel`."""
    u = u_group * rows.z_mm
    std = rows.std.copy()
    std[:, OBSERVABLE.z] = np.hypot(std[:, OBSERVABLE.z], u)
    group, u = depth_groups(rows.groups, u)
    return replace(rows, std=std, z_group=group, u_z_group_mm=u)


def sampled(fit: RobustFit, rows: Observations, seed: int) -> ImportanceSample:
    """Return the posterior by importance sampling, a hundred times faster than by chains."""
    target = posterior_of(fit, rows, Priors({}))
    return sample_importance(target, *laplace(fit, target), np.random.default_rng(seed))


def instrument(
    fit: RobustFit, sample: ImportanceSample, one: Bench, rows: Observations, seed: int
) -> CalibratedInstrument:
    """Return the instrument as the fit's model describes it."""
    rng = np.random.default_rng((seed, 1))
    draws = sample.equally_weighted(DRAWS, rng)
    common = rng.standard_normal((DRAWS, fit.by_shared.shape[1]))
    draws[:, :-1] += common @ fit.by_shared.T
    noise = one.rig.noise
    settings = RowSettings(
        u_x1c=noise.pixel_px / float(one.rig.c1.matrix[0, 0]),
        u_z_mm=noise.z_mm,
        u_z_rel=noise.z_rel,
        encoder_step_rad=one.rig.resolution_rad,
        u_alpha2_rad=noise.encoder_rad,
    )
    return instrument_from_draws(draws, common, fit, rows, Setup(settings))
