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

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import embed, vector
from calib.rows.observations import Observations

MINIMUM_ROWS = 3

_TOO_FEW = "{} rows cannot determine {} unknowns; add gaze rows"
_UNDETERMINED = (
    "the gaze rows do not determine baseline and encoder zero: all lie at one place; "
    "add targets at other depths and other yaw angles"
)


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
        raise EstimationError(_TOO_FEW.format(len(right), matrix.shape[1]))
    solution, _, rank, _ = np.linalg.lstsq(matrix, right)
    if rank < matrix.shape[1]:
        raise EstimationError(_UNDETERMINED)
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
        Whether Z_a is free. Without it B = A T ties the unknowns, and Gauss-Newton steps from the
        untied solution restore the tie.

    Raises
    ------
    EstimationError
        If the rows do not determine the unknowns.
    """
    count, unknowns = len(rows), 3 if axis_z else 2
    if count < unknowns:
        raise EstimationError(_TOO_FEW.format(count, unknowns))
    solved = Bilinear.of(rows).solve(weights, np.arange(count)[None], axis_z=axis_z)
    if np.isnan(solved).any():
        raise EstimationError(_UNDETERMINED)
    theta: FloatArray = parameters_of(solved)[0]
    return theta


@dataclass(frozen=True)
class Bilinear:
    """Rows as equations that are linear in T, A and B, for many solutions at once.

    Parameters
    ----------
    columns
        What T, A and B are multiplied with, shape (n, 3); times sin(a), which turns the cotangent
        form into the misclosure.
    right
        The right sides, shape (n,), times the same.
    """

    columns: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, rows: Observations) -> Bilinear:
        """Return the equations of rows."""
        c, x, z = _cotangent(rows), rows.x1c, rows.z_mm
        sine = np.sin(rows.alpha2_rad + rows.gaze_residual_rad)
        columns = np.stack([1 - x * c, 1 / z, c / z], axis=1)
        return cls(sine[:, None] * columns, sine * (c + x))

    def solve(self, weights: FloatArray, chosen: IntArray, *, axis_z: bool) -> FloatArray:
        """Return the least-squares solutions (T, L_b, Z_a), shape (k, 3), of some rows each.

        Of rows that do not determine one it is NaN.

        Parameters
        ----------
        weights
            Of all rows, shape (n,).
        chosen
            Places of the rows of each solution, shape (k, m).
        """
        w = weights[chosen]
        matrix, right = w[..., None] * self.columns[chosen], w * self.right[chosen]
        solved = np.zeros((len(chosen), 3))
        if axis_z:
            tangent, a, b = _least_squares(matrix, right).T
            solved[:, 0] = tangent
            solved[:, 1] = (a + b * tangent) / (1 + tangent**2)
            solved[:, 2] = (b - a * tangent) / (1 + tangent**2)
            return solved
        solved[:, :2] = _least_squares(matrix[..., :2], right)
        for _ in range(20):
            # (c + x) = T (1 - x c) + L (1 + c T) / z, linearised in T and L.
            tangent, baseline = solved[:, 0, None], solved[:, 1, None]
            ahead = matrix[..., 1] + tangent * matrix[..., 2]
            miss = right - tangent * matrix[..., 0] - baseline * ahead
            slope = np.stack([matrix[..., 0] + baseline * matrix[..., 2], ahead], axis=-1)
            step = _least_squares(slope, miss)
            solved[:, :2] += step
            if not (np.abs(step) > (1e-13, 1e-10)).any():
                break
        return solved

    def misclosures(self, solved: FloatArray) -> FloatArray:
        """Return the misclosures of all rows by each solution (T, L_b, Z_a), shape (k, n)."""
        tangent, baseline, axis_z = solved.T
        unknowns = np.stack([tangent, baseline - axis_z * tangent, baseline * tangent + axis_z])
        misses: FloatArray = unknowns.T @ self.columns.T - self.right
        misses /= np.sqrt(1 + tangent**2)[:, None]
        return misses


def parameters_of(solved: FloatArray) -> FloatArray:
    """Return full parameter vectors, shape (k, COUNT), of solutions (T, L_b, Z_a)."""
    tangent, baseline, axis_z = solved.T
    free = np.stack([baseline, np.arctan(tangent), axis_z], axis=1)
    return embed(free, ("baseline_mm", "delta2_rad", "axis_z_mm"))


def _least_squares(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return solutions, shape (k, p), of systems (k, m, p), NaN where one has not full rank.

    As `numpy.linalg.lstsq`, which takes one system at a time.
    """
    k, m, p = matrix.shape
    solution = np.full((k, p), np.nan)
    sound = np.isfinite(matrix).all(axis=(1, 2))
    if m < p or not sound.any():
        return solution
    u, s, vt = np.linalg.svd(matrix[sound], full_matrices=False)
    s[s[:, -1] <= m * np.finfo(np.float64).eps * s[:, 0]] = np.nan
    along = np.einsum("kmp,km->kp", u, right[sound]) / s
    solution[sound] = np.einsum("kpq,kp->kq", vt, along)
    return solution
