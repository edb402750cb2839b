"""Rows that share the error of one reference depth: what that does to the estimate.

A ruler read once for a board, or one image pair, gives the depth of several targets. Each row's
uncertainty says how far its own depth may be off, and the fits take rows as independent: their
covariance then holds each row's part of such an error, but not that the parts agree. What this adds
is the difference of two variances of one estimate, with rows of a group moved together and one by
one (the middle of a sandwich estimator; Liang and Zeger 1986, doi 10.1093/biomet/73.1.13). It is a
matrix of the parameters' size however many the groups, and nothing where each row has its own.
"""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.rows.observations import Observations

SLIGHT = 1e-9
"""Variance added along a direction, as a share of what is there already, that is rounding."""


def units(rows: Observations) -> IntArray:
    """Return the number of the unit that each row belongs to, shape (n,), from 0.

    Rows that share the error of a reference depth are one unit, all others are their own. Units
    are numbered in the order of their first rows.
    """
    if not rows.has_groups:
        return np.arange(len(rows))
    alone = rows.z_group.max(initial=0) + 1 + np.arange(len(rows))
    label = np.where(rows.u_z_group_mm > 0, rows.z_group, alone)
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number.ravel()]


def added_covariance(by_row: FloatArray, group: IntArray) -> FloatArray:
    """Return what the sharing adds to an estimate's covariance, shape (p, p).

    Along some directions it may be negative: where rows of a group pull the estimate opposite
    ways, their errors cancel if they are one.

    Parameters
    ----------
    by_row
        Change of the estimate by one standard deviation of the group's error in each row alone,
        shape (n, p).
    group
        Rows of one number share the error, shape (n,).
    """
    label = np.unique(group, return_inverse=True)[1].ravel()
    several = np.bincount(label)[label] > 1
    apart = by_row[several]
    together = np.zeros((int(label.max(initial=-1)) + 1, by_row.shape[1]))
    np.add.at(together, label[several], apart)
    added: FloatArray = together.T @ together - apart.T @ apart
    return added


def wider_part(added: FloatArray, own: FloatArray, *, noise_scale: float) -> FloatArray:
    """Return a factor, shape (p, r), of the covariance that is added along r <= p directions.

    Where sharing makes the estimate better that is left aside, which is on the safe side.

    Parameters
    ----------
    added
        As of `added_covariance`, shape (p, p).
    own
        The covariance with rows taken as independent, shape (p, p).
    noise_scale
        By which stated uncertainties are too small. Above 1 it widens this one like all of a
        row's; below 1 it does not narrow it, for it may be the rows' own errors that are smaller.
    """
    root = np.linalg.cholesky(own)
    half = np.linalg.solve(root, max(1.0, noise_scale) ** 2 * added)
    value, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
    wider = value > SLIGHT
    factor = root @ (vectors[:, wider] * np.sqrt(value[wider]))
    largest = factor[np.abs(factor).argmax(axis=0), np.arange(factor.shape[1])]
    signed: FloatArray = factor * np.sign(largest)
    return signed
