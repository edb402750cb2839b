"""How far views contradict each other: the cluster-robust variance of an estimate.

Liang and Zeger (1986, doi 10.1093/biomet/73.1.13). Problems are given whitened and with the poses
eliminated: with A* what of the derivatives by n shared unknowns no pose can imitate, and r the
residuals, `normals` are A*'A* and `scores` A*'r of each view.
"""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.unit_diagonal import Spectrum
from calib.images.bundle import proven
from calib.images.repeats import summed

OPEN = 1e-10
"""Share of the greatest information, unknowns scaled, below which a direction counts as open: its
standard deviation is 100,000 times that of the best."""


def view_factor(
    normals: FloatArray, scores: FloatArray, columns: IntArray, clusters: IntArray
) -> float:
    """Return the variance of `columns` as views show it over that of independent noise.

    Averaged over all directions, the other unknowns eliminated, and less the bias of few views: 1
    on independent noise, more where errors are common to a view (a detector's bias with the light,
    blur, a board that bends as it is held), less where neighbouring corners err against each other,
    as far as the views prove it (`calib.images.bundle.proven`). Directions that the views leave
    open are left out.

    Parameters
    ----------
    normals, scores
        Of each view, shape (v, n, n) and (v, n).
    columns
        Places of the unknowns in question.
    clusters
        Cluster of each view, shape (v,).
    """
    matrix = normals.sum(axis=0)
    others = np.setdiff1d(np.arange(len(matrix)), columns)
    own = np.zeros((len(columns), len(matrix)))
    own[np.arange(len(columns)), columns] = 1.0
    if len(others):
        left = whitener(matrix[np.ix_(others, others)])
        own[:, others] = -matrix[np.ix_(columns, others)] @ left @ left.T
    root = own.T @ whitener(own @ matrix @ own.T)
    spread = whitener(matrix)
    scores, normals = summed(scores, clusters), summed(normals, clusters)
    found = float(((scores @ root) ** 2).sum())
    by_spread = normals @ spread
    share = root.T @ (normals - by_spread @ by_spread.swapaxes(-1, -2)) @ root
    expected = float(np.trace(share, axis1=-2, axis2=-1).sum())
    if expected <= OPEN:  # one view alone
        return 1.0
    return proven(found / expected, freedom=expected**2 / float((share**2).sum()))


def whitener(matrix: FloatArray) -> FloatArray:
    """Return W, shape (n, k), W W' the inverse of a normal matrix but for open directions."""
    return Spectrum.of(matrix).inverse_root(least=OPEN)
