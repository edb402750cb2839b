"""Rows for the tests of the estimators: the paper's Table 1, and simulated rigs."""

from __future__ import annotations

import numpy as np

from calib.fit.priors import Priors
from calib.geometry.parameters import vector
from calib.geometry.plane import OBSERVABLE, gaze_at
from calib.rows.observations import Observations

NO_PRIORS = Priors({})

# Table 1 of Xu and Wang, doi 10.1177/1729881417715984: z mm, tan(alpha1), ctan(alpha2).
TABLE_1 = np.array(
    [
        [485.9, 0.1018, 0.0673],
        [486.5, 0.2635, -0.0876],
        [796.4, 0.2353, -0.1219],
        [805.9, 0.0229, 0.0838],
        [1008.5, 0.0162, 0.0724],
        [998.5, 0.1624, -0.0705],
    ]
)
STEP_RAD = float(np.deg2rad(0.05625))


def table_1() -> Observations:
    """Table 1 with 0.1 px in x1c, the paper's motor step and 0.2 % in z."""
    z, x, c = TABLE_1.T
    std = np.zeros((6, 5))
    std[:, OBSERVABLE.x1c] = 2.4e-4
    std[:, OBSERVABLE.alpha2] = STEP_RAD / np.sqrt(12)
    std[:, OBSERVABLE.z] = 0.002 * z
    ids = tuple("123456")
    still = np.zeros(6)
    return Observations(ids, ids, x, still, np.arctan2(1, c), still, z, std, has_height=False)


def simulated(
    rng: np.random.Generator,
    *,
    count: int,
    noise: float = 1.0,
    outliers: int = 0,
    **parameters: float,
) -> tuple[Observations, np.ndarray]:
    """Return rows of a rig with normal noise, and its parameter vector.

    Outliers have 20 to 60 standard deviations of the reading.
    """
    theta = vector({"baseline_mm": 120.0, "delta2_rad": 0.01} | parameters)
    z = rng.uniform(500, 1500, count)
    x, y = rng.uniform(-0.3, 0.4, count), rng.uniform(-0.25, 0.25, count)
    gaze = gaze_at(theta, np.stack([x * z, y * z, z], axis=1))
    std = np.zeros((count, 5))
    std[:, OBSERVABLE.x1c] = std[:, OBSERVABLE.y1c] = 2e-4
    std[:, OBSERVABLE.alpha2] = 3e-4
    std[:, OBSERVABLE.z] = 0.001 * z
    error = noise * std * rng.standard_normal(std.shape)
    hit = rng.choice(count, outliers, replace=False)
    error[hit, OBSERVABLE.alpha2] += rng.choice([-1, 1], outliers) * rng.uniform(
        0.006, 0.018, outliers
    )
    ids = tuple(f"r{i}" for i in range(count))
    rows = Observations(
        ids,
        ids,
        gaze.x1c + error[:, OBSERVABLE.x1c],
        gaze.y1c + error[:, OBSERVABLE.y1c],
        gaze.alpha2 + error[:, OBSERVABLE.alpha2],
        np.zeros(count),
        z + error[:, OBSERVABLE.z],
        std,
    )
    return rows, theta
