"""calibration.json: estimates of the parameters, and the comparison of models."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from calib.document.part import Matrix, Part, Vector
from calib.geometry.parameters import PARAMETERS, IdentifiedBy


class Estimate(Part):
    """A value with its standard uncertainty."""

    value: float = Field(description="best estimate")
    std: float = Field(description="standard uncertainty")


class Parameter(Estimate):
    """An estimated parameter."""

    identified_by: IdentifiedBy | None = Field(None, description="what decided it")
    std_over_data_only_std: float | None = Field(None, description="robust fits")
    q2_5: float | None = Field(
        None,
        validation_alias="q2.5",
        serialization_alias="q2.5",
        description="posteriors, as all below",
    )
    q50: float | None = Field(None, description="median")
    q97_5: float | None = Field(
        None, validation_alias="q97.5", serialization_alias="q97.5", description="97.5 % quantile"
    )
    ess: float | None = Field(None, description="effective draws in the bulk")
    ess_tail: float | None = Field(None, description="effective draws in the tails")
    rhat: float | None = Field(None, description="R-hat across ensembles")


class Derived(Estimate):
    """A quantity that follows from the parameters of a fit."""

    q2_5: float | None = Field(
        None,
        validation_alias="q2.5",
        serialization_alias="q2.5",
        description="posteriors, as q97.5",
    )
    q97_5: float | None = Field(
        None, validation_alias="q97.5", serialization_alias="q97.5", description="97.5 % quantile"
    )


_UNITS = ", ".join(f"{p.name} ({p.meaning})" for p in PARAMETERS)


class Importance(Part):
    """Moments of a posterior by importance sampling."""

    k_hat: float | None = Field(None, description="Pareto shape of the upper tail of the weights")
    ess: float | None = Field(None, description="effective draws")
    mean: Vector | None = Field(None, description="of the parameters")
    std: Vector | None = Field(None, description="of the same")
    agreement: float | None = Field(
        None, description="largest difference of the means from the chains', over what is allowed"
    )
    agrees: bool = Field(description="whether it is reliable and confirms means and spreads")


class Fit(Part):
    """A fit; NAME/linear, NAME/convex, NAME/robust, NAME/posterior or NAME/adjustment."""

    parameters: Annotated[dict[str, Parameter], Field(description=_UNITS)]
    names: tuple[str, ...] = Field(description="order of the covariance")
    covariance: Matrix = Field(description="of the parameters, in the order of names")
    derived: dict[str, Derived] | None = Field(None, description="effective_baseline_mm: L_b + e")
    residual_mrad: Vector | None = Field(None, description="angle of each row to its gaze plane")
    sigma_mrad: float | None = Field(
        None, description="standard deviation of the residuals of rows that are no outliers"
    )
    outliers: tuple[str, ...] | None = Field(
        None, description="ids of rows that disagree with the others"
    )
    diagnostics: dict[str, Any] | None = Field(
        None, description="figures of the method that tell whether to believe it"
    )
    converged: bool | None = Field(None, description="posteriors, as all below")
    tau: dict[str, float] | None = Field(None, description="autocorrelation time, steps")
    draws: int | None = Field(None, description="of the posterior that were kept")
    steps: int | None = Field(None, description="of each ensemble, without burn-in")
    acceptance: float | None = Field(None, description="share of proposals accepted")
    importance: Importance | None = Field(
        None, description="the same moments by importance sampling, and whether they agree"
    )


class Score(Part):
    """How well one model predicts."""

    model: str = Field(description="its name")
    loo: float = Field(description="expected log predictive density, leave one out, nats")
    loo_se: float = Field(description="standard error of loo")
    aicc: float | None = Field(
        None, description="Akaike's criterion, corrected; absent with too few rows"
    )
    bic: float = Field(description="Schwarz's criterion")
    cv_depth_rms_rel: float | None = Field(
        None,
        description="rms of relative depth errors, each group of rows predicted without it",
    )
    validation_depth_rms_rel: float | None = Field(
        None, description="the same of the validation rows"
    )
    weight: float = Field(description="stacking")
    averaging_weight: float = Field(description="pseudo-BMA+")
    pareto_k_max: float = Field(description="greatest k-hat of the rows")
    refitted: tuple[str, ...] = Field(
        description="rows predicted by an exact refit, as their k-hat was too high"
    )
    unreliable: tuple[str, ...] = Field(
        description="rows whose refit's own importance weights were poor"
    )
