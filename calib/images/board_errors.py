"""What a board that is not as drawn does to all views alike, and what that is worth.

No view contradicts another by it, so that views cannot tell (`calib.images.disagreement`); what the
corners leave does. Corners are taken to be displaced at random: each by itself and smoothly over
some squares, in the plane (a printer), and smoothly out of it (a plate, besides the warp that is
solved). With E the derivatives of the residuals r by places on the board, Q what the unknowns leave
of them and R_k the correlation of displacements of kind k, variance components follow from moments
(Rao 1971, doi 10.1016/0047-259X(71)90001-7, MINQUE with equal weights),

    E[r' V_j r] = sum_k s_k tr(Q V_j Q V_k),    V_0 = 1, V_k = E R_k E',

and with A* the derivatives by the shared unknowns, poses eliminated, and C = (A*'A*)^-1, they add
sum_k s_k C A*'E R_k E'A* C to the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from calib.core.arrays import FloatArray, IntArray
from calib.core.unit_diagonal import unit_diagonal
from calib.images.disagreement import whitener

SMOOTH_SPACINGS = 2.0
"""Range of smooth displacements, in spacings of corners (squared exponential)."""

PROVEN_SIGMAS = 2.0
"""Standard errors, under corner noise alone, that a kind of displacement must exceed to count."""

POSE = 6


@dataclass(frozen=True)
class Equations:
    """Whitened residuals and derivatives of k images, 0 where a corner is not used.

    Parameters
    ----------
    view
        View that each shows, shape (k,).
    off
        Residuals, shape (k, c, 2).
    by_shared, by_pose, by_place
        Derivatives by the n shared unknowns, (k, c, 2, n), the pose of the view, (k, c, 2, 6), and
        the corner's place on the board, 1/mm, (k, c, 2, 3).
    """

    view: IntArray
    off: FloatArray
    by_shared: FloatArray
    by_pose: FloatArray
    by_place: FloatArray


class BoardSums:
    """Sums over all images from which the board's errors are told.

    Parameters
    ----------
    views, corners, size
        Number of views, of corners of the board, of shared unknowns.
    """

    def __init__(self, views: int, corners: int, size: int) -> None:
        self._poses = np.zeros((views, POSE, POSE))
        self._pose_places = np.zeros((views, POSE, 3 * corners))
        self._pose_shared = np.zeros((views, POSE, size))
        self._places = np.zeros((corners, 3, 3))
        self._shared_places = np.zeros((size, 3 * corners))
        self._shared = np.zeros((size, size))
        self._scores = np.zeros(3 * corners)
        self._squares, self._count = 0.0, 0

    def add(self, images: Equations) -> None:
        """Add images; several of one view may come one after the other."""
        k, c = images.off.shape[:2]
        a = images.by_shared.reshape(k, 2 * c, -1)
        b = images.by_pose.reshape(k, 2 * c, -1).swapaxes(-1, -2)
        e = images.by_place
        pose_places = (images.by_pose.swapaxes(-1, -2) @ e).swapaxes(1, 2).reshape(k, POSE, -1)
        np.add.at(self._poses, images.view, b @ b.swapaxes(-1, -2))
        np.add.at(self._pose_places, images.view, pose_places)
        np.add.at(self._pose_shared, images.view, b @ a)
        by_corner = e.transpose(1, 0, 2, 3).reshape(c, 2 * k, 3)
        shared = images.by_shared.transpose(1, 0, 2, 3).reshape(c, 2 * k, -1)
        mixed = (shared.swapaxes(-1, -2) @ by_corner).transpose(1, 0, 2)
        self._places += by_corner.swapaxes(-1, -2) @ by_corner
        self._shared_places += mixed.reshape(-1, 3 * c)
        rows = images.by_shared.reshape(2 * c * k, -1)
        self._shared += rows.T @ rows
        self._scores += np.einsum("kcje,kcj->ce", e, images.off).ravel()
        self._squares += float(np.sum(images.off**2))
        self._count += 2 * int(e.any(axis=(-1, -2)).sum())

    def add_known(self, information: FloatArray) -> None:
        """Add what is known of the shared unknowns beforehand, shape (n, n)."""
        self._shared += information

    def covariance(self, points: FloatArray) -> FloatArray:
        """Return what the board's errors add to the covariance of the unknowns, shape (n, n).

        Parameters
        ----------
        points
            Corners in the board's frame, mm, shape (c, 3), row by row.
        """
        known = np.diagonal(self._poses, axis1=-2, axis2=-1).all(axis=-1)
        taken = np.linalg.solve(
            self._poses[known],
            np.concatenate([self._pose_places[known], self._pose_shared[known]], axis=-1),
        )
        places = self._pose_places[known].reshape(-1, taken.shape[-1] - len(self._shared))
        shared = self._pose_shared[known].reshape(-1, len(self._shared))
        flat = taken.reshape(-1, taken.shape[-1])
        by_places, by_shared = flat[:, : places.shape[1]], flat[:, places.shape[1] :]
        root = whitener(self._shared - shared.T @ by_shared)
        mixed = root.T @ (self._shared_places - shared.T @ by_places)
        left = _block_diagonal(self._places) - places.T @ by_places - mixed.T @ mixed
        freedom = self._count - POSE * int(known.sum()) - root.shape[1]
        kinds = _correlations(points)
        variances = _components(left, self._scores, self._squares, freedom, kinds)
        moved = sum(
            (v * (mixed @ kind @ mixed.T) for v, kind in zip(variances, kinds, strict=True)),
            start=np.zeros((len(mixed), len(mixed))),
        )
        result: FloatArray = root @ moved @ root.T
        return result


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    count, size = blocks.shape[:2]
    full = np.zeros((count, size, count, size))
    full[np.arange(count), :, np.arange(count), :] = blocks
    return full.reshape(count * size, -1)


def _correlations(points: FloatArray) -> list[FloatArray]:
    """Return the correlations of the kinds of displacements, shape (3 c, 3 c) each."""
    spacing = float(np.linalg.norm(points[1] - points[0]))
    apart = np.linalg.norm(points[:, None] - points, axis=-1) / (SMOOTH_SPACINGS * spacing)
    smooth = np.exp(-(apart**2) / 2)
    plane, out = np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0])
    kinds = (np.eye(len(points)), plane), (smooth, plane), (smooth, out)
    return [np.kron(along, kind) for along, kind in kinds]


def _components(
    left: FloatArray,
    scores: FloatArray,
    squares: float,
    freedom: int,
    kinds: list[FloatArray],
) -> FloatArray:
    """Return the variances of the kinds, mm^2, 0 of those not proven.

    Parameters
    ----------
    left, scores
        E'QE and E'r.
    """
    size = len(kinds) + 1
    matrix, found = np.empty((size, size)), np.empty(size)
    matrix[0, 0], found[0] = freedom, squares
    products = [left @ kind for kind in kinds]
    for j, one in enumerate(products, start=1):
        matrix[0, j] = matrix[j, 0] = np.trace(one)
        found[j] = scores @ kinds[j - 1] @ scores
        for k, two in enumerate(products, start=1):
            matrix[j, k] = np.sum(one * two.T)
    scale, scaled = unit_diagonal(matrix)
    variances = np.zeros(size)
    kept = np.arange(size)
    while len(kept):
        inside = np.ix_(kept, kept)
        variances[:] = 0.0
        variances[kept] = nnls(scaled[inside], (found / scale)[kept])[0] / scale[kept]
        # Of moments of noise alone the covariance is twice the matrix, times its variance squared.
        open_to_chance = np.sqrt(2 * np.diag(np.linalg.pinv(scaled[inside]))) / scale[kept]
        proven = variances[kept] > PROVEN_SIGMAS * variances[0] * open_to_chance
        proven[0] = True
        if proven.all():
            break
        kept = kept[proven]
    return variances[1:]
