"""What changes between the pictures add to the covariance, as far as these cannot exclude them.

Least squares takes lenses and rig to be the same in all pictures. Changes b, k of them, that move
the shared unknowns of view v by b way_v make its estimate wrong by K b. With N_v and s_v a view's
normal matrix and gradient, poses eliminated, N the sum of N_v, F the views' factor, and b of
covariance S beforehand,

    G = sum way_v N_v,    M = sum way_v N_v way_v' - G N^-1 G',    g = sum way_v s_v,
    V = (M / F + S^-1)^-1,    b = -V g / F,    K = N^-1 G',

and the mean square of the error, which is added to the covariance, is K (b b' + V) K'. The estimate
is left as it is: where pictures show nothing b is 0 and V is what they cannot exclude; what they do
show makes intervals longer before it is enough to fail a gate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.poses import transform
from calib.images.joint.reduced import Reduced
from calib.images.joint.unknowns import LensesAndBoard

BREATHING_STD = 0.001
"""Standard deviation beforehand of the relative change of a focal length per unit of h / d - 1, d
the distance of a board and h the harmonic mean of those at which depths are measured: what gates
let pass (`calib.images.stereo.gates.FOCAL_CHANGE`), 0.12 % over boards from 0.35 to 1.1 m. Depths
of rigs whose C1 breathes by 0.4 % over these are then inside 95 % intervals in nine cases of ten
(docs/uncertainty.md)."""

MEASURED = ("pair", "row")
"""Kinds of pictures at whose distances depths are measured."""


class Along(NamedTuple):
    """What views tell of changes along k ways, under independent residuals.

    G (k, n), the first term of M and M (k, k), g (k,) of the module's docstring.
    """

    mixed: FloatArray
    plain: FloatArray
    information: FloatArray
    gradient: FloatArray


def along(reduced: Reduced, way: FloatArray, spread: FloatArray) -> Along:
    """Return what views tell of changes.

    Parameters
    ----------
    way
        How the shared unknowns of each view change with 1 along each way, shape (k, v, n).
    spread
        `Reduced.spread`, shape (n, n).
    """
    by_view = np.einsum("vij,kvj->kvi", reduced.normals, way)
    mixed = by_view.sum(axis=1)
    plain = np.einsum("kvi,lvi->kl", by_view, way)
    information = plain - mixed @ spread @ mixed.T
    return Along(mixed, plain, information, np.einsum("kvi,vi->k", way, reduced.scores))


@dataclass(frozen=True)
class Allowed:
    """Changes that the pictures leave possible.

    Parameters
    ----------
    response
        K, shape (n, k).
    mean_square
        Of the changes, shape (k, k).
    """

    response: FloatArray
    mean_square: FloatArray

    def covariance(self) -> FloatArray:
        """Return what they add to the covariance of the shared unknowns, shape (n, n)."""
        added: FloatArray = self.response @ self.mean_square @ self.response.T
        return added


def allowed(reduced: Reduced, way: FloatArray, std: FloatArray, factor: float) -> Allowed:
    """Return which changes along ways the pictures leave possible.

    Parameters
    ----------
    way
        As in `along`.
    std
        Standard deviations of the changes beforehand, independent of each other, shape (k,).
    factor
        Variance as the views show it over that of independent residuals.
    """
    spread = reduced.spread()
    told = along(reduced, way, spread)
    # In standard deviations beforehand, so that changes of different units stand side by side.
    information = np.outer(std, std) * told.information / factor + np.eye(len(std))
    variance = np.outer(std, std) * np.linalg.inv(information)
    change = -variance @ told.gradient / factor
    return Allowed(spread @ told.mixed.T, variance + np.outer(change, change))


def board_distances(problem: LensesAndBoard, poses: FloatArray) -> FloatArray:
    """Return how far the middle of the board is from its camera, mm, in each view, shape (v,)."""
    middle = problem.points.mean(axis=0, keepdims=True)
    return np.array([float(np.linalg.norm(transform(pose, middle))) for pose in poses])


def breathing_covariance(
    problem: LensesAndBoard, reduced: Reduced, used: BoolArray, factor: float
) -> FloatArray:
    """Return what focal lengths that change with distance add, shape (n, n).

    The estimate stands for the mean distance of the pictures in which depths are measured; how far
    a lens at their distances differs from that is counted as an error of the lens.

    Parameters
    ----------
    used
        Which images count, shape (i,).
    factor
        As in `allowed`.
    """
    images = problem.pictured
    added = np.zeros((problem.size, problem.size))
    distance = board_distances(problem, reduced.at.own[: images.views])
    ways, focal, square = [], [], []
    for c in (0, 1):
        own, at = used & (images.camera == c), problem.at_lens(c)[:2]
        if not problem.free[c] or not own.any():
            continue
        measured = own & np.isin(images.kinds, MEASURED)
        near = 1 / distance
        at_views = near[images.view[measured if measured.any() else own]]
        nearer = near / at_views.mean() - 1
        way, direction = np.zeros(reduced.scores.shape), np.zeros(problem.size)
        views = np.unique(images.view[own])
        way[np.ix_(views, at)] = nearer[views, None] * reduced.at.shared[at]
        direction[at] = reduced.at.shared[at]
        ways.append(way)
        focal.append(direction)
        square.append(float(np.var(at_views / at_views.mean())))
    if not ways:
        return added
    found = allowed(reduced, np.array(ways), np.full(len(ways), BREATHING_STD), factor)
    added += found.covariance()
    for k, direction in enumerate(focal):
        added += square[k] * found.mean_square[k, k] * np.outer(direction, direction)
    return added
