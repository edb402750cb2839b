"""A start for the robust fits that one row in five, grossly wrong, does not lead astray."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.fit.linear import Bilinear, fit_bilinear, parameters_of
from calib.fit.noise import log_density, row_noise
from calib.geometry.misclosure import misclosure_value
from calib.geometry.parameters import vector
from calib.rows.observations import Observations

TRIMMED_STARTS = 60
"""Elemental starts of the trimmed search.

With one row in five an outlier, 60 triples all hold one with probability (1 - 0.8³)^60 < 1e-18.
"""

CONCENTRATION_STEPS = 4
"""Refits of each start to the half of the rows that it fits best (Rousseeuw and Van Driessen 2006,
doi 10.1007/s10618-005-0024-4, use two and then iterate the best ten)."""

SEARCH_ROWS = 2000
"""Rows that the search looks at; more do not make a start better."""

SCALE_GRID = np.linspace(-3.0, 6.0, 91)
"""Logarithms of the noise scales among which a start's likelihood is maximised."""


def some_rows(rows: Observations, most: int = SEARCH_ROWS) -> Observations:
    """Return at most so many rows, evenly from all of a longer table."""
    if len(rows) <= most:
        return rows
    return rows.take(np.linspace(0, len(rows) - 1, most).astype(np.int64))


def first_guess(rows: Observations) -> FloatArray:
    """Return a parameter vector good enough to weight rows: the paper's law, median baseline."""
    cot = 1 / np.tan(rows.alpha2_rad + rows.gaze_residual_rad)
    return vector({"baseline_mm": float(np.median(rows.z_mm * (rows.x1c + cot)))})


def _misses(theta: FloatArray, rows: Observations, sigma: FloatArray) -> FloatArray:
    return misclosure_value(theta, rows.gaze, rows.z_mm) / sigma


def _best_log_density(standardised: FloatArray) -> float:
    """Return the log likelihood of residuals at the noise scale that suits them best."""
    density = log_density(standardised[:, None], SCALE_GRID[None, :]).sum(axis=0)
    return float(density.max())


def _trimmed(rows: Observations, sigma: FloatArray, *, axis_z: bool) -> FloatArray | None:
    """Return the least-trimmed-squares estimate, or None where no triple determines one."""
    count = len(rows)
    half = min((count + 4) // 2, count)
    # A fixed design: the same table always gets the same start.
    design = np.random.default_rng(0)
    drawn = [design.choice(count, size=min(3, count), replace=False) for _ in range(TRIMMED_STARTS)]
    # Of few rows there are few triples.
    keep = np.array(list({frozenset(triple.tolist()): triple for triple in drawn}.values()))
    equations = Bilinear.of(rows)
    for _ in range(CONCENTRATION_STEPS):
        solved = equations.solve(1 / sigma, keep, axis_z=axis_z)
        solved = solved[np.isfinite(solved).all(axis=1)]
        square = (equations.misclosures(solved) / sigma) ** 2
        keep = np.argpartition(square, half - 1, axis=1)[:, :half]
    cost = np.take_along_axis(square, keep, axis=1).sum(axis=1)
    return parameters_of(solved)[np.argmin(cost)] if len(cost) else None


def find_start(rows: Observations, *, axis_z: bool) -> FloatArray:
    """Return a full parameter vector, shape (COUNT,), from which a robust fit can start.

    The better, by Student-t likelihood, of weighted least squares on all rows and least trimmed
    squares.

    Raises
    ------
    EstimationError
        If the rows do not determine baseline and encoder zero.
    """
    rows = some_rows(rows)
    sigma = row_noise(first_guess(rows), rows).sigma
    plain = fit_bilinear(rows, 1 / sigma, axis_z=axis_z)
    starts = [plain]
    trimmed = _trimmed(rows, sigma, axis_z=axis_z)
    if trimmed is not None:
        starts.append(trimmed)
    return max(starts, key=lambda theta: _best_log_density(_misses(theta, rows, sigma)))
