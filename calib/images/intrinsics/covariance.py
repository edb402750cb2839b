"""What the residuals of board views say of the intrinsics: covariance, and whether views agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.camera import Camera, project_points
from calib.geometry.poses import rotation, transform, transformed_by_pose
from calib.images.board_errors import BoardSums, Equations
from calib.images.bundle import inverse, warp_shapes
from calib.images.detection.grid import seen
from calib.images.disagreement import view_factor


@dataclass(frozen=True)
class ViewScores:
    """The least-squares problem of the intrinsics, view by view, poses eliminated.

    With A, B the derivatives of a view's pixels by intrinsics and pose, A* is what of A no pose can
    imitate, A - B (B'B)^-1 B'A (Schur's complement). Where board deformation was solved too, its
    two unknowns follow the p intrinsics: n = p + 2, or p.

    Parameters
    ----------
    lens
        Number of intrinsics, p.
    normals
        A*'A* of each view, shape (views, n, n).
    scores
        A*'r of each view, r its residuals, shape (views, n).
    sums, points
        What tells errors of the board, and its corners, mm, shape (corners, 3).
    squares
        Sum of squared residuals, px^2.
    freedom
        Coordinates less parameters, poses included.
    """

    lens: int
    normals: FloatArray
    scores: FloatArray
    sums: BoardSums
    points: FloatArray
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
                f"{len(self.normals)} views do not overdetermine {self.lens} "
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
        spread = inverse(self.normals.sum(axis=0)) * self.variance
        return spread[: self.lens, : self.lens]

    def dispersion(self, clusters: IntArray | None = None) -> float:
        """Return the variance that views show over that which independent corner noise explains.

        See `calib.images.disagreement.view_factor`.

        Parameters
        ----------
        clusters
            Of each view in use, shape (views,): views that count as one; each its own by default.
        """
        if clusters is None:
            clusters = np.arange(len(self.normals))
        own = np.unique(clusters, return_inverse=True)[1]
        scores = self.scores / self.variance
        return view_factor(
            self.normals / self.variance, scores, columns=np.arange(self.lens), clusters=own
        )

    def board_covariance(self) -> FloatArray:
        """Return what errors of the board add to the covariance, shape (p, p).

        See `calib.images.board_errors`.
        """
        return self.sums.covariance(self.points)[: self.lens, : self.lens]


def view_scores(
    camera: Camera,
    poses: FloatArray,
    residuals: FloatArray,
    points: FloatArray,
    *,
    warp: bool = False,
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
    warp
        Whether the board deformation was solved too.
    """
    used = seen(residuals)
    lens, extra = 4 + len(camera.distortion), 2 if warp else 0
    bows = warp_shapes(points)
    size = lens + extra
    sums = BoardSums(len(residuals), len(points), size)
    normals, scores = [], []
    for i in np.flatnonzero(used.any(axis=-1)):
        on_board = points[used[i]]
        projection = project_points(camera, transform(poses[i], on_board))
        by_lens = projection.by_intrinsics
        by_pose = projection.by_point @ transformed_by_pose(poses[i], on_board)
        by_place = projection.by_point @ rotation(poses[i][:3])
        if warp:
            by_warp = by_place[..., 2, None] * bows[used[i], None, :]
            by_lens = np.concatenate([by_lens, by_warp], axis=-1)
        off = residuals[i, used[i]]
        here = np.array([i])
        sums.add(Equations(here, *(_padded(v, used[i]) for v in (off, by_lens, by_pose, by_place))))
        by_lens, by_pose = by_lens.reshape(-1, size), by_pose.reshape(-1, 6)
        own = by_lens - by_pose @ np.linalg.lstsq(by_pose, by_lens, rcond=None)[0]
        normals.append(own.T @ own)
        scores.append(own.T @ off.ravel())
    return ViewScores(
        lens=lens,
        normals=np.stack(normals),
        scores=np.stack(scores),
        sums=sums,
        points=points,
        squares=float(np.nansum(residuals**2)),
        freedom=2 * int(used.sum()) - size - 6 * len(normals),
    )


def _padded(values: FloatArray, used: BoolArray) -> FloatArray:
    """Return rows of some corners as an image of all, shape (1, corners, ...), 0 elsewhere."""
    full = np.zeros((1, len(used), *values.shape[1:]))
    full[0, used] = values
    return full
