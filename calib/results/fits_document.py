"""The fits, as they stand in calibration.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.fit.convex import ConvexFit
from calib.fit.linear import LinearFit
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.parameters import ECCENTRICITY


def estimate(names: Sequence[str], values: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    """Return values with their covariance."""
    std = np.sqrt(np.diag(covariance))
    pairs = zip(names, values, std, strict=True)
    return {
        "parameters": {name: {"value": value, "std": s} for name, value, s in pairs},
        "names": list(names),
        "covariance": covariance,
    }


def linear_document(fit: LinearFit) -> dict[str, Any]:
    """Return the paper's linear calibration."""
    return estimate(fit.names, fit.values, fit.covariance) | {
        "residual_mrad": fit.residual_mrad,
        "sigma_mrad": fit.sigma_mrad,
        "outliers": [],
        "diagnostics": {
            "product_mm": fit.product_mm,
            "inconsistency_mm": fit.inconsistency_mm,
            "implied_axis_z_mm": fit.implied_axis_z_mm,
            "condition": fit.condition,
        },
    }


def convex_document(fit: ConvexFit) -> dict[str, Any]:
    """Return the convex fit, with what its solver says."""
    return estimate(fit.names, fit.values, fit.covariance) | {
        "residual_mrad": fit.residual_mrad,
        "sigma_mrad": fit.sigma_mrad,
        "outliers": list(fit.outliers),
        "diagnostics": {
            "status": fit.status,
            "optimal": fit.optimal,
            "objective": fit.objective,
            "duality_gap": fit.duality_gap,
            "at_bound": list(fit.at_bound),
            "implied_axis_z_mm": fit.implied_axis_z_mm,
        },
    }


def effective_baseline(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> tuple[float, float] | None:
    """Return L_b + e, the baseline seen at 90 deg, with its standard deviation, mm.

    None for models without eccentricity.
    """
    if ECCENTRICITY not in names:
        return None
    pick = np.array([name in ("baseline_mm", ECCENTRICITY) for name in names], dtype=float)
    return float(pick @ values), float(np.sqrt(pick @ covariance @ pick))


def effective_interval(names: Sequence[str], draws: FloatArray) -> tuple[float, float] | None:
    """Return the 95 % interval of L_b + e, mm, with equal tails.

    None for models without eccentricity.

    Parameters
    ----------
    draws
        Of the parameters `names`, shape (m, k) or more columns.
    """
    if ECCENTRICITY not in names:
        return None
    total = draws[:, names.index("baseline_mm")] + draws[:, names.index(ECCENTRICITY)]
    low, high = np.quantile(total, [0.025, 0.975])
    return float(low), float(high)


def derived(
    names: Sequence[str],
    values: FloatArray,
    covariance: FloatArray,
    draws: FloatArray | None = None,
) -> dict[str, Any]:
    """Return what follows from the parameters: L_b + e, where both are free."""
    found = effective_baseline(names, values, covariance)
    if found is None:
        return {}
    total = {"value": found[0], "std": found[1]}
    if draws is not None and (ends := effective_interval(names, draws)) is not None:
        total |= {"q2.5": ends[0], "q97.5": ends[1]}
    return {"derived": {"effective_baseline_mm": total}}


def robust_document(fit: RobustFit) -> dict[str, Any]:
    """Return a model's robust fit."""
    document = estimate(fit.names, fit.values, fit.covariance)
    for name, who, share in zip(fit.names, fit.identified_by, fit.data_share, strict=True):
        document["parameters"][name] |= {"identified_by": who, "std_over_data_only_std": share}
    return (
        document
        | derived(fit.names, fit.values, fit.covariance)
        | {
            "residual_mrad": fit.residual_mrad,
            "sigma_mrad": fit.sigma_mrad,
            "outliers": list(fit.outliers),
            "diagnostics": {
                "noise_scale": fit.noise_scale,
                "data_parameters": fit.data_parameters,
                "standardised_residual": fit.standardised,
                "evaluations": fit.evaluations,
            },
        }
    )


def posterior_document(p: Posterior) -> dict[str, Any]:
    """Return a model's posterior, with what tells whether to believe it."""
    document = estimate(p.names, p.mean, p.covariance)
    identified = (*p.identified_by, "both")
    for i, name in enumerate(p.names):
        low, middle, high = p.quantiles[i]
        document["parameters"][name] |= {
            "q2.5": low,
            "q50": middle,
            "q97.5": high,
            "ess": p.ess_bulk[i],
            "ess_tail": p.ess_tail[i],
            "rhat": p.r_hat[i],
            "identified_by": identified[i],
        }
    free = slice(0, len(p.names) - 1)
    return (
        document
        | derived(p.names[:-1], p.mean[free], p.covariance[free, free], p.flat)
        | {
            "converged": p.converged,
            "tau": dict(zip(p.names, p.tau, strict=True)),
            "draws": len(p.flat),
            "steps": p.steps,
            "acceptance": p.acceptance,
            "importance": {
                "k_hat": p.k_hat,
                "ess": p.importance_ess,
                "mean": p.importance_mean,
                "std": p.importance_std,
                "agreement": p.agreement,
                "agrees": p.agrees,
            },
        }
    )
