"""The fits, as they stand in calibration.json."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.arrays import FloatArray
from calib.document.fits import Derived, Fit, Importance, Parameter
from calib.document.part import matrix, vector
from calib.fit.convex import ConvexFit
from calib.fit.linear import LinearFit
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.parameters import IdentifiedBy
from calib.results.effective_baseline import effective_baseline, effective_interval


def estimates(
    names: Sequence[str], values: FloatArray, covariance: FloatArray
) -> dict[str, Parameter]:
    """Return values with their standard uncertainties, by parameter."""
    std = np.sqrt(np.diag(covariance))
    return {
        name: Parameter(value=float(value), std=float(s))
        for name, value, s in zip(names, values, std, strict=True)
    }


def linear(fit: LinearFit) -> Fit:
    """Return the paper's linear calibration."""
    return Fit(
        parameters=estimates(fit.names, fit.values, fit.covariance),
        names=tuple(fit.names),
        covariance=matrix(fit.covariance),
        residual_mrad=vector(fit.residual_mrad),
        sigma_mrad=fit.sigma_mrad,
        outliers=(),
        diagnostics={
            "product_mm": fit.product_mm,
            "inconsistency_mm": fit.inconsistency_mm,
            "implied_axis_z_mm": fit.implied_axis_z_mm,
            "condition": fit.condition,
        },
    )


def convex(fit: ConvexFit) -> Fit:
    """Return the convex fit, with what its solver says."""
    return Fit(
        parameters=estimates(fit.names, fit.values, fit.covariance),
        names=tuple(fit.names),
        covariance=matrix(fit.covariance),
        residual_mrad=vector(fit.residual_mrad),
        sigma_mrad=fit.sigma_mrad,
        outliers=tuple(fit.outliers),
        diagnostics={
            "status": fit.status,
            "optimal": fit.optimal,
            "objective": fit.objective,
            "duality_gap": fit.duality_gap,
            "at_bound": tuple(fit.at_bound),
            "implied_axis_z_mm": fit.implied_axis_z_mm,
        },
    )


def derived(
    names: Sequence[str],
    values: FloatArray,
    covariance: FloatArray,
    draws: FloatArray | None = None,
) -> dict[str, Derived] | None:
    """Return what follows from the parameters: L_b + e, where both are free."""
    found = effective_baseline(names, values, covariance)
    if found is None:
        return None
    low, high = (None, None) if draws is None else effective_interval(names, draws) or (None, None)
    total = Derived(value=found[0], std=found[1], q2_5=low, q97_5=high)
    return {"effective_baseline_mm": total}


def robust(fit: RobustFit) -> Fit:
    """Return a model's robust fit."""
    return Fit(
        parameters=with_sources(
            estimates(fit.names, fit.values, fit.covariance), fit.identified_by, fit.data_share
        ),
        names=tuple(fit.names),
        covariance=matrix(fit.covariance),
        derived=derived(fit.names, fit.values, fit.covariance),
        residual_mrad=vector(fit.residual_mrad),
        sigma_mrad=fit.sigma_mrad,
        outliers=tuple(fit.outliers),
        diagnostics={
            "noise_scale": fit.noise_scale,
            "data_parameters": fit.data_parameters,
            "standardised_residual": vector(fit.standardised),
            "evaluations": fit.evaluations,
        },
    )


def with_sources(
    parameters: dict[str, Parameter], identified_by: Sequence[IdentifiedBy], data_share: FloatArray
) -> dict[str, Parameter]:
    """Return parameters with what told them: data or prior."""
    told = zip(parameters.items(), identified_by, data_share, strict=True)
    return {
        name: Parameter(
            value=p.value,
            std=p.std,
            identified_by=who,
            std_over_data_only_std=float(share),
        )
        for (name, p), who, share in told
    }


def posterior(p: Posterior) -> Fit:
    """Return a model's posterior, with what tells whether to believe it."""
    std = np.sqrt(np.diag(p.covariance))
    identified = (*p.identified_by, "both")
    free = slice(0, len(p.names) - 1)
    return Fit(
        parameters={
            name: Parameter(
                value=float(p.mean[i]),
                std=float(std[i]),
                identified_by=identified[i],
                q2_5=float(p.quantiles[i][0]),
                q50=float(p.quantiles[i][1]),
                q97_5=float(p.quantiles[i][2]),
                ess=float(p.ess_bulk[i]),
                ess_tail=float(p.ess_tail[i]),
                rhat=float(p.r_hat[i]),
            )
            for i, name in enumerate(p.names)
        },
        names=tuple(p.names),
        covariance=matrix(p.covariance),
        derived=derived(p.names[:-1], p.mean[free], p.covariance[free, free], p.flat),
        converged=p.converged,
        tau=dict(zip(p.names, vector(p.tau), strict=True)),
        draws=len(p.flat),
        steps=p.steps,
        acceptance=p.acceptance,
        importance=Importance(
            k_hat=p.k_hat,
            ess=p.importance_ess,
            mean=vector(p.importance_mean),
            std=vector(p.importance_std),
            agreement=p.agreement,
            agrees=p.agrees,
        ),
    )
