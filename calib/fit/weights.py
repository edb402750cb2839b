"""Weights of models in a mixture, from the densities of left-out rows (Yao et al. 2018).

Two kinds, doi 10.1214/17-BA1091. Stacking finds the mixture that predicts left-out rows best; of
six rows it mostly makes one model's weight 1. Pseudo-BMA+ weighs each model by exp(LOO), averaged
over the Bayesian bootstrap of the rows, so that what few rows cannot decide stays open. Measured
depths are averaged with the second (docs/uncertainty.md has the figures).
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp

from calib.core.arrays import FloatArray

BOOTSTRAPS = 2000
"""Resamplings of the rows: a weight is then known to 0.01."""

CHUNK_ELEMENTS = 4_000_000
"""Resamplings x rows held at a time."""


def stacking_weights(pointwise: FloatArray) -> FloatArray:
    """Return the weights, shape (models,), of the mixture that predicts left-out rows best.

    Maximises sum_i log sum_k w_k exp(pointwise[i, k]) by expectation maximisation, which climbs
    at each step and keeps the weights on the simplex.

    Parameters
    ----------
    pointwise
        LOO log densities, shape (n, models).
    """
    density = np.exp(pointwise - pointwise.max(axis=1, keepdims=True))
    weights: FloatArray = np.full(pointwise.shape[1], 1 / pointwise.shape[1])
    for _ in range(10_000):
        updated: FloatArray = weights * (density.T @ (1 / (density @ weights))) / len(density)
        if np.abs(updated - weights).max() < 1e-10:
            return updated
        weights = updated
    return weights


def averaging_weights(pointwise: FloatArray, rng: Generator) -> FloatArray:
    """Return the pseudo-BMA+ weights, shape (models,).

    Parameters
    ----------
    pointwise
        LOO log densities, shape (n, models).
    """
    n = len(pointwise)
    step = max(1, CHUNK_ELEMENTS // n)
    total = np.zeros(pointwise.shape[1])
    for start in range(0, BOOTSTRAPS, step):
        share = rng.dirichlet(np.ones(n), size=min(step, BOOTSTRAPS - start))
        loo = n * (share @ pointwise)
        total += np.exp(loo - logsumexp(loo, axis=1, keepdims=True)).sum(axis=0)
    weights: FloatArray = total / BOOTSTRAPS
    return weights
