"""Fits and posteriors, back from the mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.fit.convex import ConvexFit
from calib.fit.identifiability import Combination, Identifiability
from calib.fit.linear import LinearFit
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.mirror import mirror_matrix, signed, signs
from calib.mirror.problem import Mirror


def mirror_linear(fit: LinearFit) -> LinearFit:
    """Return the paper's calibration; the product of its two unknowns is even."""
    sign = signs(fit.names)
    return replace(
        fit,
        values=signed(fit.values, sign),
        covariance=mirror_matrix(fit.covariance, sign),
        residual_mrad=signed(fit.residual_mrad, -1.0),
    )


def mirror_convex(fit: ConvexFit) -> ConvexFit:
    """Return the convex fit."""
    sign = signs(fit.names)
    return replace(
        fit,
        values=signed(fit.values, sign),
        covariance=mirror_matrix(fit.covariance, sign),
        residual_mrad=signed(fit.residual_mrad, -1.0),
    )


def mirror_robust(fit: RobustFit, mirror: Mirror) -> RobustFit:
    """Return a robust fit."""
    sign = signs(fit.names)
    by_shared = np.outer(sign, mirror.columns(len(fit.shared_names)))
    return replace(
        fit,
        values=signed(fit.values, sign),
        covariance=mirror_matrix(fit.covariance, sign),
        by_shared=signed(fit.by_shared, by_shared) if fit.shared_names else fit.by_shared,
        residual_mrad=signed(fit.residual_mrad, -1.0),
        standardised=signed(fit.standardised, -1.0),
    )


def mirror_posterior(posterior: Posterior, mirror: Mirror) -> Posterior:
    """Return a posterior: the same draws, and quantiles in their order."""
    sign = signs(posterior.names)
    quantiles = signed(posterior.quantiles, sign[:, None])
    quantiles[sign < 0] = quantiles[sign < 0, ::-1]
    common = posterior.common
    return replace(
        posterior,
        draws=signed(posterior.draws, sign),
        common=signed(common, mirror.columns(common.shape[-1])) if common.shape[-1] else common,
        mean=signed(posterior.mean, sign),
        covariance=mirror_matrix(posterior.covariance, sign),
        quantiles=quantiles,
        importance_mean=signed(posterior.importance_mean, sign),
    )


def mirror_identifiability(told: Identifiability) -> Identifiability:
    """Return what the rows can tell."""
    return replace(
        told,
        combinations=tuple(_combination(c, told.names) for c in told.combinations),
        correlation=mirror_matrix(told.correlation, signs(told.names)),
    )


def _combination(combination: Combination, names: tuple[str, ...]) -> Combination:
    """Return a direction, its largest part positive again."""
    sign, largest = signs(names), int(np.argmax(np.abs(combination.direction)))
    return replace(combination, direction=signed(combination.direction, sign * sign[largest]))
