"""A calibration written by hand, and rows of what `calib measure` says of it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from math import cos, sin, sqrt
from typing import Any

import numpy as np

NAMES = ["baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm"]


VALUES = [120.0, 0.01, -20.0, 3.0]


COVARIANCE = [
    [1.0, 1e-4, 0.3, -0.8],
    [1e-4, 4e-8, 1e-4, -1e-4],
    [0.3, 1e-4, 2.0, -0.5],
    [-0.8, -1e-4, -0.5, 1.5],
]


U_X1C, STEP, U_ALPHA2, NOISE = 2e-4, 9.8e-4, 1e-4, 1.25


U_X = NOISE * U_X1C


FX, CX, FY, CY = 800.0, 320.5, 810.0, 240.25


DISTORTION = (-0.21, 0.05, 1e-4, -2e-4, 0.01)


def calibration() -> dict[str, Any]:
    """Return a calibration.json with all that measuring needs, and no more."""
    spread = {"normal": 0.0, "width": 0.0}
    return {
        "format": 1,
        "measurement": {
            "model": "axis-offset",
            "names": NAMES,
            "values": VALUES,
            "covariance": COVARIANCE,
            "reading": {
                "x1c": spread,
                "y1c": spread,
                "alpha2_rad": spread,
                "gaze_residual_rad": spread,
            },
            "stated": {"u_x1c": U_X1C, "encoder_step_rad": STEP, "u_alpha2_rad": U_ALPHA2},
            "noise_factor": NOISE,
            "calibrated_depth_mm": [500.0, 1500.0],
            "factor95": 1.96,
        },
        "intrinsics": {
            name: {
                "matrix": [[FX, 0, CX], [0, FY, CY], [0, 0, 1]],
                "distortion": list(DISTORTION),
                "image_size": [640, 480],
            }
            for name in ("c1", "c2")
        },
    }


def law(x: float, reading: float, values: list[float]) -> float:
    """Return z, mm."""
    baseline, delta2, axis_z, eccentricity = values
    a = reading + delta2
    cot = cos(a) / sin(a)
    return (baseline + axis_z * cot + eccentricity / sin(a)) / (x + cot)


def slope(f: Callable[[float], float], at: float, step: float) -> float:
    return (f(at + step) - f(at - step)) / (2 * step)


def gradient(x: float, reading: float) -> tuple[np.ndarray[Any, Any], float, float]:
    """Return dz by the parameters, by x1c and by the reading."""
    by = []
    for i, step in enumerate((1e-3, 1e-6, 1e-3, 1e-3)):
        at = [0.0] * 4
        at[i] = step
        up = [v + s for v, s in zip(VALUES, at, strict=True)]
        down = [v - s for v, s in zip(VALUES, at, strict=True)]
        by.append((law(x, reading, up) - law(x, reading, down)) / (2 * step))
    by_x = slope(lambda v: law(v, reading, VALUES), x, 1e-6)
    by_reading = slope(lambda v: law(x, v, VALUES), reading, 1e-6)
    return np.array(by), by_x, by_reading


def reading_std() -> float:
    return NOISE * sqrt(U_ALPHA2**2 + STEP**2 / 12)


def u_z(x: float, reading: float) -> float:
    by, by_x, by_reading = gradient(x, reading)
    parameters = float(by @ np.array(COVARIANCE) @ by)
    return sqrt(parameters + (by_x * U_X) ** 2 + (by_reading * reading_std()) ** 2)


def distorted(x: float, y: float) -> tuple[float, float]:
    """Return the pixel of a normalised point (Brown's model as OpenCV documents it)."""
    k1, k2, p1, p2, k3 = DISTORTION
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return (
        FX * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + CX,
        FY * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + CY,
    )


def rows_of(text: str) -> dict[str, dict[str, str]]:
    return {row["id"]: row for row in csv.DictReader(io.StringIO(text))}


def numbers(row: Mapping[str, str], *names: str) -> list[float]:
    return [float(row[name]) for name in names]


# The CSV gives 0.1 um; half of it is the rounding.
ROUNDING = 0.51e-4
