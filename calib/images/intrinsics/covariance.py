"""What the residuals of board views say of the intrinsics: covariance, and whether views agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.camera import Camera
from calib.geometry.poses import transform, transformed_by_pose
from calib.images.bundle import inverse, project_points, proven
from calib.images.detection.grid import seen
from calib.images.repeats import summed

OPEN = 1e-10
"""Share of the greatest information, unknowns scaled, below which a direction counts as open: its
standard deviation is 100,000 times that of the best."""


@dataclass(frozen=True)
class ViewScores:
    """The least-squares problem of the intrinsics, view by view, poses eliminated.

    With A, B the derivatives of a view's pixels by intrinsics and pose, A* is what of A no pose can
    imitate, A - B (B'B)^-1 B'A (Schur's complement).

    Parameters
    ----------
    normals
        A*'A* of each view, shape (views, p, p).
    scores
        A*'r of each view, r its residuals, shape (views, p).
    squares
        Sum of squared residuals, px^2.
    freedom
        Coordinates less parameters, poses included.
    """

    normals: FloatArray
    scores: FloatArray
    squares: float
    freedom: int

    @property
    def variance(self) -> float:
        """Variance of a corner coordinate, px^2.

        Raises
        ------
        EstimationError
            If there are not more coordinates than parameters.
        """
        if self.freedom <= 0:
            raise EstimationError(
                f"{len(self.normals)} views do not overdetermine {self.scores.shape[1]} "
                "intrinsics and their poses; take more board images"
            )
        return self.squares / self.freedom

    def covariance(self) -> FloatArray:
        """Return the covariance of the intrinsics, (p, p), under independent noise of corners.

        Raises
        ------
        EstimationError
            If the views leave a parameter open.
        """
        return inverse(self.normals.sum(axis=0)) * self.variance

    def dispersion(self, clusters: IntArray | None = None) -> float:
        """Return the variance that views show over that which independent corner noise explains.

        The sum over views of s' N^-1 s (s the score, N the normal matrix of all views), over its
        expectation under independent noise, sigma^2 (p - sum tr (N^-1 N_v)^2): the variance of the
        estimate as the views show it over that of `covariance`, averaged over all directions (a
        cluster-robust covariance, Liang and Zeger 1986, doi 10.1093/biomet/73.1.13, as one number).
        1 on independent noise, more where errors are common to a view: a board that is not quite
        flat, a detector's bias with the light, blur; less where neighbouring corners err against
        each other, as far as the views prove it (`calib.images.bundle.proven`).

        Parameters
        ----------
        clusters
            Of each view in use, shape (views,): views that count as one; each its own by default.
        """
        normals, scores = self.normals, self.scores
        if clusters is not None:
            clusters = np.unique(clusters, return_inverse=True)[1]
            normals, scores = summed(normals, clusters), summed(scores, clusters)
        normal = self.normals.sum(axis=0)
        scale = np.sqrt(np.diag(normal))
        value, vector = np.linalg.eigh(normal / np.outer(scale, scale))
        # Directions that the views leave open hold no score to be judged.
        shown = value > OPEN * value[-1]
        root = vector[:, shown] / np.sqrt(value[shown]) / scale[:, None]
        share = root.T @ normals @ root
        alike = float((share**2).sum())
        expected = float(shown.sum()) - alike
        if expected <= OPEN:  # one view alone
            return 1.0
        found = float(((scores @ root) ** 2).sum())
        return proven(found / (self.variance * expected), freedom=expected**2 / alike)


def view_scores(
    camera: Camera, poses: FloatArray, residuals: FloatArray, points: FloatArray
) -> ViewScores:
    """Return normal matrices and scores of the intrinsics, in the order of `intrinsic_names`.

    Parameters
    ----------
    poses
        Camera from board, rad and mm, shape (views, 6).
    residuals
        Observed minus projected, px, shape (views, corners, 2); NaN where not used.
    points
        Corners in the board's frame, mm, shape (corners, 3).
    """
    used = seen(residuals)
    normals, scores = [], []
    for i in np.flatnonzero(used.any(axis=-1)):
        on_board = points[used[i]]
        projection = project_points(camera, transform(poses[i], on_board))
        by_lens = projection.by_intrinsics.reshape(2 * len(on_board), -1)
        by_pose = (projection.by_point @ transformed_by_pose(poses[i], on_board)).reshape(-1, 6)
        own = by_lens - by_pose @ np.linalg.lstsq(by_pose, by_lens, rcond=None)[0]
        normals.append(own.T @ own)
        scores.append(own.T @ residuals[i, used[i]].ravel())
    count = 4 + len(camera.distortion)
    return ViewScores(
        normals=np.stack(normals),
        scores=np.stack(scores),
        squares=float(np.nansum(residuals**2)),
        freedom=2 * int(used.sum()) - count - 6 * len(normals),
    )
