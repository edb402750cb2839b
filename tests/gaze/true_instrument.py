"""A virtual rig that gazes, and the instrument that knows its parameters."""

from __future__ import annotations

import numpy as np

from calib.gaze.aim import EpipolarAiming
from calib.gaze.gazing import Gazer, law_of
from calib.gaze.target import BoardCorner
from calib.geometry.parameters import INDEX, MODELS, STANDOFF
from calib.instrument.calibration_file import Measuring
from calib.rows.from_table import CameraSet, RowSettings, Setup
from calib.uncertainty.measurement import Instrument, ParameterKnowledge, ReadingSpread


def gazer(rig, *, backlash_steps=0.0, settle_s=0.0):
    world = rig.world
    return Gazer(
        rig=rig,
        target=BoardCorner(world.board),
        lens_c2=world.rig.c2,
        law=law_of(rig, world.rig.c2, backlash_steps=backlash_steps),
        settle_s=settle_s,
    )


def aiming(rig):
    near, far = rig.world.rig.depth_range_mm
    return EpipolarAiming(rig.world.rig.theta, rig.world.rig.c1, (0.6 * near, 1.7 * far), 0.02)


def measuring(rig, *, u_alpha2_deg, zero=(0.0, 0.0)):
    """Return the instrument; `zero` is a correction of delta2 and its standard uncertainty, rad."""
    true = rig.world.rig
    names = (*MODELS[true.model].free, STANDOFF)
    values = np.array([true.theta[INDEX[name]] for name in names])
    covariance = np.zeros((len(names), len(names)))
    place = names.index("delta2_rad")
    values[place] += zero[0]
    covariance[place, place] = zero[1] ** 2
    knowledge = ParameterKnowledge(names, values, covariance, None, ("A",) * len(names))
    settings = RowSettings(
        u_x1c=0.0,
        u_z_mm=0.0,
        u_z_rel=0.0,
        encoder_step_rad=true.resolution_rad,
        u_alpha2_rad=float(np.deg2rad(u_alpha2_deg)),
    )
    return Measuring(
        instrument=Instrument(knowledge, ReadingSpread()),
        setup=Setup(settings, CameraSet(true.c1, true.c2)),
        noise_factor=1.0,
        calibrated_mm=true.depth_range_mm,
        factor95=1.96,
    )
