"""Evidence for small mistakes, on which a prior as wide as typical mistakes are costs too much.

Typical mistakes of labs are large where rows are accurate. A prior as wide as that costs more than
a small mistake can gain, though it may matter. So each mistake has a second prior of some standard
uncertainties of a row's misclosure, in the manner of a unit information prior (Kass and Wasserman
1995, doi 10.1080/01621459.1995.10476592); the better of both counts, less the logarithm of their
number.
"""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.refit import Linear, Refit

SMALL = 10.0
"""Standard deviation of small mistakes, in standard uncertainties of a row's misclosure."""


def by_small_prior(
    refit: Refit, loadings: FloatArray, typical: FloatArray, linear: Linear, scale: float
) -> float:
    """Return what the second prior adds to the evidence, nats; by Laplace's method.

    Parameters
    ----------
    refit
        With the mistake as parameters under the typical prior.
    loadings
        Error of each observable per unit of each parameter, shape (n, 5, k).
    typical
        Standard deviation of the typical prior, shape (k,).
    linear, scale
        The fit without the mistake, and its noise scale.
    """
    push = np.einsum("nq,nqk->nk", linear.by_observable, loadings)
    hit = np.abs(push).max(axis=1) > 0
    size = float(np.sqrt((push[hit] ** 2).sum(axis=1).mean())) if hit.any() else 0.0
    small = SMALL * max(1.0, scale) / size if size > 0 else np.inf
    cost = float(np.log(2))
    if small >= typical.min():
        return -cost
    precision = np.linalg.inv(refit.covariance)
    likelihood, shift = precision - np.diag(typical**-2.0), precision @ refit.added

    def log(std: FloatArray) -> float:
        known = likelihood + np.diag(std**-2.0)
        volume = float(np.linalg.slogdet(known)[1]) + 2 * float(np.log(std).sum())
        return 0.5 * float(shift @ np.linalg.solve(known, shift)) - 0.5 * volume

    better = log(np.full(len(typical), small)) - log(typical)
    return max(better, 0.0) - cost
