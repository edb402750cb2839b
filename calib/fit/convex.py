"""The linear calibration as a convex programme: Huber loss, bounds, proof of optimality.

It cannot end in a wrong minimum, whatever the rows: the cross-check of the robust fit's start. Its
unknowns are those of eqs. (7) and (8), see `calib.fit.linear`.

The proof needs no trust in the solver. For the loss h(r) = r² within the threshold M and
2 M |r| - M² beyond it, every nu with |nu_i| <= 2 M bounds the minimum from below (weak duality):

    sum_i h(r_i) >= nu . b - |nu|² / 4 - sum_j max(g_j lo_j, g_j hi_j),    g = A^T nu.

At the optimum nu = h'(r) closes the gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.fit.linear import residual_mrad
from calib.fit.noise import is_outlier, row_noise
from calib.fit.start import find_start
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import vector
from calib.rows.observations import Observations

HUBER_THRESHOLD = 1.345
"""In standard deviations: 95 % efficiency on normal rows (Huber 1981)."""

BASELINE_LIMIT_MM = 10_000.0
"""A wider rig is no longer one rig."""

DELTA2_LIMIT_RAD = float(np.deg2rad(20.0))
"""An encoder zero off by more is a wrong reference mark, not an error to calibrate."""

GAP_LIMIT = 1e-6
"""Largest relative duality gap that counts as optimal."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal sample over its median absolute deviation.

Few rows are fitted too closely for it; the factor 1 + 5 / (n - 3) makes up for that (Rousseeuw and
Leroy 1987, section 5.1)."""


@dataclass(frozen=True)
class ConvexFit:
    """The convex fit.

    Parameters
    ----------
    names
        "baseline_mm", "delta2_rad".
    values, covariance
        Shapes (2,) and (2, 2); the covariance is Huber's asymptotic one.
    residual_mrad
        (num / z) - (x1c + cot a), mrad, shape (n,).
    sigma_mrad
        Their standard deviation with n - 2 degrees of freedom.
    outliers
        Rows that disagree with the others, by id.
    implied_axis_z_mm
        What the third unknown says of the yaw axis, mm.
    status
        The solver's own word.
    objective, duality_gap
        Loss at the solution, and how far below it the minimum may lie at most, relative.
    at_bound
        Unknowns that ended on a bound, by name.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    residual_mrad: FloatArray
    sigma_mrad: float
    outliers: tuple[str, ...]
    implied_axis_z_mm: float
    status: str
    objective: float
    duality_gap: float
    at_bound: tuple[str, ...]

    @property
    def optimal(self) -> bool:
        """Whether the duality gap proves the solution optimal."""
        return self.duality_gap < GAP_LIMIT


@dataclass(frozen=True)
class _System:
    """Minimise sum h(right - matrix @ u) over low <= u <= high, all scaled to unit noise."""

    matrix: FloatArray
    right: FloatArray
    low: FloatArray
    high: FloatArray

    def solve(self) -> tuple[FloatArray, str]:
        """Return the minimiser, shape (3,), and the solver's status."""
        # Unknowns of size one in a well-conditioned basis keep the interior-point steps accurate.
        basis, triangle = np.linalg.qr(self.matrix)
        unknown = cvxpy.Variable(3)
        loss = cvxpy.sum(cvxpy.huber(self.right - basis @ unknown, HUBER_THRESHOLD))
        inverse = np.linalg.inv(triangle)
        limits = [inverse @ unknown >= self.low, inverse @ unknown <= self.high]
        problem = cvxpy.Problem(cvxpy.Minimize(loss), limits)
        problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
        if unknown.value is None:
            raise EstimationError(
                f"the convex fit found no solution ({problem.status}): no baseline below "
                f"{BASELINE_LIMIT_MM:.0f} mm suits the rows; check units and the encoder's sign"
            )
        return np.clip(inverse @ unknown.value, self.low, self.high), str(problem.status)

    def loss_and_gap(self, u: FloatArray) -> tuple[float, float]:
        """Return the loss at `u` and the relative duality gap."""
        r = self.right - self.matrix @ u
        size = np.abs(r)
        m = HUBER_THRESHOLD
        loss = float(np.where(size <= m, r**2, 2 * m * size - m**2).sum())
        nu = np.clip(2 * r, -2 * m, 2 * m)
        g = self.matrix.T @ nu
        bound = nu @ self.right - nu @ nu / 4 - np.maximum(g * self.low, g * self.high).sum()
        return loss, float((loss - bound) / max(loss, 1.0))


def _system(rows: Observations) -> _System:
    """Return the weighted linear system of eqs. (7) and (8)."""
    start = find_start(rows, axis_z=True)
    sigma = row_noise(start, rows).sigma
    standardised = misclosure_value(start, rows.gaze, rows.z_mm) / sigma
    few = 1 + 5 / max(len(rows) - 3, 1)
    scale = max(MAD_TO_SIGMA * few * float(np.median(np.abs(standardised))), 1e-6)
    angle = rows.alpha2_rad + rows.gaze_residual_rad
    c, x, z = 1 / np.tan(angle), rows.x1c, rows.z_mm
    w = np.sin(angle) / (sigma * scale)
    tangent = np.tan(DELTA2_LIMIT_RAD)
    return _System(
        matrix=w[:, None] * np.stack([1 / z, c / z, 1 - x * c], axis=1),
        right=w * (c + x),
        low=np.array([0.0, -BASELINE_LIMIT_MM, -tangent]),
        high=np.array([BASELINE_LIMIT_MM, BASELINE_LIMIT_MM, tangent]),
    )


def fit_convex(rows: Observations) -> ConvexFit:
    """Return the convex fit.

    Raises
    ------
    EstimationError
        If the rows do not determine the unknowns or no solution lies within the bounds.
    """
    system = _system(rows)
    u, status = system.solve()
    loss, gap = system.loss_and_gap(u)
    baseline, product, tangent = u
    delta2 = float(np.arctan(tangent))
    values = np.array([baseline, delta2])
    miss = system.right - system.matrix @ u
    residual = residual_mrad(vector({"baseline_mm": baseline, "delta2_rad": delta2}), rows)
    span = system.high - system.low
    bound = (u - system.low < 1e-6 * span) | (system.high - u < 1e-6 * span)
    unknowns = ("baseline_mm", "product_mm", "tan_delta2")
    return ConvexFit(
        names=("baseline_mm", "delta2_rad"),
        values=values,
        covariance=_covariance(system.matrix, miss, delta2),
        residual_mrad=residual,
        sigma_mrad=float(np.sqrt(residual @ residual / max(len(rows) - 2, 1))),
        outliers=tuple(i for i, bad in zip(rows.ids, is_outlier(miss, 1.0), strict=True) if bad),
        implied_axis_z_mm=float((product - baseline * tangent) / (1 + tangent**2)),
        status=status,
        objective=loss,
        duality_gap=gap,
        at_bound=tuple(name for name, at in zip(unknowns, bound, strict=True) if at),
    )


def _covariance(matrix: FloatArray, miss: FloatArray, delta2: float) -> FloatArray:
    """Return Huber's asymptotic covariance of baseline and delta2, shape (2, 2)."""
    count = len(miss)
    psi = np.clip(miss, -HUBER_THRESHOLD, HUBER_THRESHOLD)
    inside = float(np.mean(np.abs(miss) <= HUBER_THRESHOLD))
    factor = float(psi @ psi) / max(count - 3, 1) / max(inside, 1 / count) ** 2
    full = factor * np.linalg.inv(matrix.T @ matrix)
    to_values = np.diag([1.0, np.cos(delta2) ** 2])
    covariance: FloatArray = to_values @ full[np.ix_([0, 2], [0, 2])] @ to_values
    return covariance
