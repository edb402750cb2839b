"""The linear calibrations: the paper's, and the weighted exact bilinear one.

With c = cot(alpha2 + residual) and T = tan(delta2) the untilted model reads, exactly,

    (c + x) = T (1 - x c) + A / z + B c / z + E sqrt(1 + c²) / z,
    A = L_b - Z_a T,   B = L_b T + Z_a,   E = e sqrt(1 + T²),

linear in T, A, B (and E). Multiplied by z and with e = 0 these are eqs. (7) and (8) of Xu and Wang
(doi 10.1177/1729881417715984) in one, at alpha2 = 90 deg too. The paper takes A for L_b and B for
L_b T. B - A T, which it would call an inconsistency, is Z_a (1 + T²): the offset of the yaw axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import vector
from calib.rows.observations import Observations

MINIMUM_ROWS = 3


@dataclass(frozen=True)
class LinearFit:
    """The paper's calibration, eqs. (7) and (8).

    Parameters
    ----------
    names
        "baseline_mm", "delta2_rad".
    values
        Shape (2,).
    covariance
        Shape (2, 2), from the residuals of the linear system, as an engineer would state it.
    residual_mrad
        (num / z) - (x1c + cot a), mrad, shape (n,).
    sigma_mrad
        Their standard deviation with n - 2 degrees of freedom.
    product_mm
        The third unknown, L_b tan(delta2), mm.
    inconsistency_mm
        |L_b tan(delta2) - product_mm|, mm.
    implied_axis_z_mm
        What the third unknown says of the yaw axis, Z_a, mm.
    condition
        Condition number of the system's matrix.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    residual_mrad: FloatArray
    sigma_mrad: float
    product_mm: float
    inconsistency_mm: float
    implied_axis_z_mm: float
    condition: float


def _cotangent(rows: Observations) -> FloatArray:
    c: FloatArray = 1 / np.tan(rows.alpha2_rad + rows.gaze_residual_rad)
    return c


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    if len(right) < matrix.shape[1]:
        raise EstimationError(
            f"{len(right)} rows cannot determine {matrix.shape[1]} unknowns; add gaze rows"
        )
    solution, _, rank, _ = np.linalg.lstsq(matrix, right)
    if rank < matrix.shape[1]:
        raise EstimationError(
            "the gaze rows do not determine baseline and encoder zero: all lie at one place; "
            "add targets at other depths and other yaw angles"
        )
    return np.asarray(solution, dtype=np.float64)


def residual_mrad(theta: FloatArray, rows: Observations) -> FloatArray:
    """Return the angle-like residual (num / z) - (x1c + cot a), mrad, shape (n,).

    It is the misclosure over the normal's x component, sin(a) for an untilted axis.
    """
    c = misclosure(theta, rows.gaze, rows.z_mm, parameters=())
    residual: FloatArray = 1e3 * c.value / -c.by_observable[:, 0]
    return residual


def fit_linear(rows: Observations) -> LinearFit:
    """Return the paper's linear calibration: unweighted least squares of eqs. (7) and (8).

    Raises
    ------
    EstimationError
        If the rows do not determine the three unknowns.
    """
    c, x, z = _cotangent(rows), rows.x1c, rows.z_mm
    matrix = np.stack([np.ones_like(c), c, z * (1 - x * c)], axis=1)
    right = z * (c + x)
    baseline, product, tangent = _solve(matrix, right)
    delta2 = np.arctan(tangent)
    values = np.array([baseline, delta2])
    spread = right - matrix @ np.array([baseline, product, tangent])
    freedom = len(z) - 3
    variance = float(spread @ spread) / freedom if freedom > 0 else np.nan
    full = variance * np.linalg.inv(matrix.T @ matrix)
    to_values = np.diag([1.0, np.cos(delta2) ** 2])
    residual = residual_mrad(vector({"baseline_mm": baseline, "delta2_rad": delta2}), rows)
    return LinearFit(
        names=("baseline_mm", "delta2_rad"),
        values=values,
        covariance=to_values @ full[np.ix_([0, 2], [0, 2])] @ to_values,
        residual_mrad=residual,
        sigma_mrad=float(np.sqrt(residual @ residual / max(len(z) - 2, 1))),
        product_mm=float(product),
        inconsistency_mm=float(abs(baseline * tangent - product)),
        implied_axis_z_mm=float((product - baseline * tangent) / (1 + tangent**2)),
        condition=float(np.linalg.cond(matrix)),
    )


def fit_bilinear(rows: Observations, weights: FloatArray, *, axis_z: bool) -> FloatArray:
    """Return the weighted exact bilinear least-squares estimate as a full parameter vector.

    As efficient as maximum likelihood for e = 0 and without outliers, and it needs no start: it
    seeds the nonlinear fits.

    Parameters
    ----------
    weights
        1 / sigma of the misclosure of each row, shape (n,); zero leaves a row out.
    axis_z
        Whether Z_a is free. Without it B = A T ties the unknowns, and one Gauss-Newton step from
        the untied solution restores the tie.

    Raises
    ------
    EstimationError
        If the rows do not determine the unknowns.
    """
    c, x, z = _cotangent(rows), rows.x1c, rows.z_mm
    # sin(a) turns the cotangent form into the misclosure, whose sigma the weights are.
    w = weights * np.sin(rows.alpha2_rad + rows.gaze_residual_rad)
    if axis_z:
        matrix = np.stack([1 - x * c, 1 / z, c / z], axis=1)
        tangent, a, b = _solve(w[:, None] * matrix, w * (c + x))
        baseline = (a + b * tangent) / (1 + tangent**2)
        offset = (b - a * tangent) / (1 + tangent**2)
    else:
        offset = 0.0
        tangent, baseline = _solve(w[:, None] * np.stack([1 - x * c, 1 / z], axis=1), w * (c + x))
        for _ in range(20):
            step = _tied_step(w, c, x, z, tangent=tangent, baseline=baseline)
            tangent, baseline = tangent + step[0], baseline + step[1]
            if abs(step[0]) < 1e-13 and abs(step[1]) < 1e-10:
                break
    return vector(
        {"baseline_mm": baseline, "delta2_rad": float(np.arctan(tangent)), "axis_z_mm": offset}
    )


def _tied_step(
    w: FloatArray, c: FloatArray, x: FloatArray, z: FloatArray, *, tangent: float, baseline: float
) -> FloatArray:
    """Return the Gauss-Newton step of (T, L) for (c + x) = T (1 - x c) + L (1 + c T) / z."""
    miss = (c + x) - tangent * (1 - x * c) - baseline * (1 + c * tangent) / z
    slope = np.stack([(1 - x * c) + baseline * c / z, (1 + c * tangent) / z], axis=1)
    return _solve(w[:, None] * slope, w * miss)
