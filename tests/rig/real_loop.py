"""Run in a network namespace: gaze at targets through the drivers gige and ximc.

Arguments: seed, number of targets. Lens and parameters are the true ones, so that what is left is
the error of gazing. Prints a JSON list, for each target depth, truth and standard uncertainty, mm,
and moves.
"""

from __future__ import annotations

import json
import os
import sys
import time

import numpy as np
from real_drivers import loopback_rig

from calib.gaze.aim import EpipolarAiming
from calib.gaze.gazing import Gazer, law_of
from calib.gaze.target import BoardCorner
from calib.geometry.camera import normalise
from calib.geometry.plane import Gaze, depth


def depth_of(truth, pixel_c1, pixel_c2, reading):
    """Return the depth that a row gives, mm."""
    x1, y1 = normalise(truth.c1, pixel_c1[None])[0]
    x2 = normalise(truth.c2, pixel_c2[None])[0, 0]
    values = (np.array([v]) for v in (x1, y1, reading, np.arctan(x2)))
    return float(depth(truth.theta, Gaze(*values))[0])


def measured(truth, row):
    """Return depth and standard uncertainty, mm: the counts are exact, the corners are not."""
    reading = row.standstill.reading_rad
    z = depth_of(truth, row.pixel_c1, row.pixel_c2, reading)
    parts = []
    for axis in np.eye(2):
        one = depth_of(truth, row.pixel_c1 + axis, row.pixel_c2, reading) - z
        two = depth_of(truth, row.pixel_c1, row.pixel_c2 + axis, reading) - z
        parts += [one * row.u_c1_px, two * row.u_c2_px]
    return z, float(np.linalg.norm(parts))


def main(seed, count):
    rows = []
    with loopback_rig(seed) as (rig, world, operator, _):
        truth = world.rig
        gazer = Gazer(rig, BoardCorner(world.board), truth.c2, law_of(rig, truth.c2))
        aiming = EpipolarAiming(truth.theta, truth.c1, truth.depth_range_mm)
        for _ in range(count):
            operator.show_gaze()
            row = gazer.gaze(aiming)
            z, u = measured(truth, row)
            stands = float(world.target(time.monotonic_ns())[2])
            rows.append({"z": z, "truth": stands, "u": u, "moves": row.moves})
    sys.stdout.write(json.dumps(rows))
    sys.stdout.flush()
    os._exit(0)  # Aravis's threads have no end


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
