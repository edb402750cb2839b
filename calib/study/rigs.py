"""Rigs, rows and priors of a study's conditions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.fit.priors import NOISE_SCALE, NOISE_SCALE_PRIOR, Priors
from calib.geometry.parameters import PARAMETERS, REFERENCE_OFFSET
from calib.rows.from_table import RowSettings, Setup
from calib.rows.observations import Observations
from calib.simulate.rig import RESOLUTIONS_DEG, Noise, TrueRig, draw_rig
from calib.simulate.tables import draw_targets, observe, row_std
from calib.study.conditions import Condition

INSIDE, BEYOND = "inside", "beyond"

TESTED_DEPTHS = 20
"""Depths measured a rig inside the calibrated range, and as many beyond it."""

EXTRAPOLATION = 1.5
"""Depths beyond the calibrated range reach to so many times its far end."""

BASELINE_PRIOR_MM = (150.0, 20.0)
ZERO_PRIOR_RAD = (0.0, float(np.deg2rad(1.0)))
"""Mean and standard deviation of the proper priors that stand in for the flat ones where truths
are drawn from the priors."""

COARSE = Noise(pixel_px=0.02, encoder_rad=0.0, z_rel=1e-4)
"""Noise far below the paper's microstep of 0.28 mrad rms: pixels of 0.02 mrad, depths of 0.01 mrad
of gaze."""


@dataclass(frozen=True)
class StudiedRig:
    """A rig, what is stated of it, its calibration rows and the depths it is tested on.

    Parameters
    ----------
    rig
        The truth.
    noise_scale
        True over stated standard uncertainties of the rows.
    priors, setup
        As stated.
    rows
        Calibration rows, with stated uncertainties.
    true_std
        Their true standard uncertainties, shape (n, 5).
    true_rows
        The rows without any error.
    tests
        Readings of the test targets by part, `INSIDE` or `BEYOND` the calibrated depths.
    true_depths_mm
        Of the test targets by part.
    """

    rig: TrueRig
    noise_scale: float
    priors: Priors
    setup: Setup
    rows: Observations
    true_std: FloatArray
    true_rows: Observations
    tests: dict[str, Observations]
    true_depths_mm: dict[str, FloatArray]


def set_up(condition: Condition, *, seed: int, number: int) -> StudiedRig:
    """Return the bench of rig `number`.

    The same seed and number give the same draws under every condition, so that conditions differ
    in nothing but what they say.
    """
    for_rig, for_scale, for_targets, for_rows = SeedSequence((seed, number)).spawn(4)
    scale = 1 / condition.stated_factor
    fixed: dict[str, float] = {}
    if condition.from_priors:
        draw = np.random.default_rng(for_scale).standard_normal(3)
        fixed["baseline_mm"] = BASELINE_PRIOR_MM[0] + BASELINE_PRIOR_MM[1] * draw[0]
        fixed["delta2_rad"] = ZERO_PRIOR_RAD[0] + ZERO_PRIOR_RAD[1] * draw[1]
        scale = float(np.exp(NOISE_SCALE_PRIOR[0] + NOISE_SCALE_PRIOR[1] * draw[2]))
    rig = draw_rig(np.random.default_rng(for_rig), model=condition.model, fixed=fixed)
    rig = _with_noise(rig, condition, scale)
    points, parts = _targets(rig, condition.rows, np.random.default_rng(for_targets))
    simulated = observe(
        rig, np.random.default_rng(for_rows), points, outlier_share=condition.outlier_share
    )
    stated = _stated(simulated.observed, condition, scale)
    tests = {part: np.flatnonzero(parts == part) for part in (INSIDE, BEYOND)}
    # A gross error of a test reading says nothing of the calibration.
    tests = {part: index[~simulated.outliers[index]] for part, index in tests.items()}
    own = np.arange(condition.rows)
    true_std = row_std(rig, points[own, 2], residual_measured=False)
    gaze = simulated.true_gaze
    truth = replace(
        simulated.observed.take(own),
        x1c=gaze.x1c[own], y1c=gaze.y1c[own], alpha2_rad=gaze.alpha2[own],
        gaze_residual_rad=gaze.residual[own], z_mm=points[own, 2], std=true_std,
    )  # fmt: skip
    return StudiedRig(
        rig=rig,
        noise_scale=scale,
        priors=_priors(condition),
        setup=_setup(rig, scale),
        rows=stated.take(own),
        true_std=true_std,
        true_rows=truth,
        tests={part: stated.take(index) for part, index in tests.items()},
        true_depths_mm={part: points[index, 2] for part, index in tests.items()},
    )


def _with_noise(rig: TrueRig, condition: Condition, scale: float) -> TrueRig:
    """Return the rig with the errors that the condition wants of it."""
    noise, resolution = rig.noise, rig.resolution_rad
    if condition.coarse:
        noise, resolution = COARSE, float(np.deg2rad(max(RESOLUTIONS_DEG)))
    if condition.z_rel is not None:
        noise = replace(noise, z_rel=condition.z_rel)
    noise = replace(noise, shared_z_rel=condition.shared_z_rel)
    if condition.from_priors:
        noise = replace(
            noise,
            pixel_px=noise.pixel_px * scale,
            encoder_rad=noise.encoder_rad * scale,
            z_rel=noise.z_rel * scale,
        )
        resolution *= scale
    return replace(rig, noise=noise, resolution_rad=resolution)


def _targets(
    rig: TrueRig, rows: int, rng: np.random.Generator
) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.str_]]]:
    """Return calibration and test targets, mm, shape (m, 3), and the part each belongs to."""
    own = draw_targets(rig, rng, count=rows, depth_range_mm=rig.depth_range_mm)
    near, far = float(own[:, 2].min()), float(own[:, 2].max())
    inside = draw_targets(rig, rng, count=TESTED_DEPTHS, depth_range_mm=(near, far))
    reach = (far, EXTRAPOLATION * far)
    beyond = draw_targets(rig, rng, count=TESTED_DEPTHS, depth_range_mm=reach)
    parts = np.repeat(["rows", INSIDE, BEYOND], [rows, TESTED_DEPTHS, TESTED_DEPTHS])
    return np.concatenate([own, inside, beyond]), parts


def _stated(observed: Observations, condition: Condition, scale: float) -> Observations:
    """Return the rows with the uncertainties that are stated of them."""
    rows = replace(observed, std=observed.std / scale)
    if not condition.shared_stated:
        rows = replace(rows, shared=np.zeros((0, 0, 0)), shared_names=())
    return rows


def _setup(rig: TrueRig, scale: float) -> Setup:
    return Setup(
        RowSettings(
            u_x1c=rig.noise.pixel_px / float(rig.c1.matrix[0, 0]) / scale,
            u_z_mm=rig.noise.z_mm / scale,
            u_z_rel=rig.noise.z_rel / scale,
            encoder_step_rad=rig.resolution_rad / scale,
            u_alpha2_rad=rig.noise.encoder_rad / scale,
        )
    )


def _priors(condition: Condition) -> Priors:
    stated = {
        parameter.name: (0.0, condition.prior_factor * parameter.prior_std)
        for parameter in PARAMETERS
        if parameter.prior_std is not None
        and parameter.name != REFERENCE_OFFSET
        and condition.prior_factor != 1
    }
    if condition.from_priors:
        stated |= {
            "baseline_mm": BASELINE_PRIOR_MM,
            "delta2_rad": ZERO_PRIOR_RAD,
            NOISE_SCALE: NOISE_SCALE_PRIOR,
        }
    return Priors(stated)
