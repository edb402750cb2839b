"""Boards that moved while a rolling shutter read the picture row by row.

Rows of such a picture are exposed one after the other, so that a board that moves is sheared along
the rows and stretched across them, each picture otherwise; a pose imitates neither, while one lens
serves all pictures. Of a board at rest a rolling shutter leaves no trace, and does no harm. With v
a corner's row, m its middle over the board and a, b the displacement along and across the rows over
the height of the picture, the residuals of a view are

    r_u = a (v - m) / height,    r_v = b (v - m) / height,

less what the six unknowns of its pose take up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import LensFit
from calib.geometry.camera import project_points
from calib.geometry.poses import transform, transformed_by_pose
from calib.images.detection.grid import seen

LEAST_SHARE = 0.5
"""Share of the residuals' squares that shear and stretch must explain. By chance it is the share of
the unknowns, some 2 %; eight sets of real pictures had 3 to 5 %, one with a held board 37 %, a wide
lens 28 %. Less motion is not told from corners that err together, and counts as a contradiction of
views."""

LEAST_VIEWS = 3


class Rolling(NamedTuple):
    """What shear and stretch of single views explain.

    Parameters
    ----------
    share
        Of the squares of all residuals.
    motion_px
        Root mean square over views of the displacement over the height of the picture.
    """

    share: float
    motion_px: float

    @property
    def told(self) -> bool:
        """Whether boards moved before a rolling shutter."""
        return self.share > LEAST_SHARE


def rolling_shutter(fit: LensFit, pixels: FloatArray, points: FloatArray) -> Rolling | None:
    """Return what shear and stretch explain; None of too few views.

    Parameters
    ----------
    pixels
        Corners found, px, shape (views, corners, 2).
    points
        Corners of the board as the fit has it, mm, shape (corners, 3).
    """
    height, used = fit.camera.image_size[1], seen(fit.residuals)
    explained, motions = 0.0, []
    for i in np.flatnonzero(used.any(axis=-1)):
        on_board, row = points[used[i]], pixels[i, used[i], 1]
        projection = project_points(fit.camera, transform(fit.poses[i], on_board))
        pose = projection.by_point @ transformed_by_pose(fit.poses[i], on_board)
        by_pose = pose.reshape(-1, pose.shape[-1])
        by_motion = np.kron(((row - row.mean()) / height)[:, None], np.eye(2))
        basis = np.linalg.qr(by_pose)[0]
        own = by_motion - basis @ (basis.T @ by_motion)
        off = fit.residuals[i, used[i]].ravel()
        motion = np.linalg.lstsq(own, off, rcond=None)[0]
        explained += float(off @ own @ motion)
        motions.append(float(motion @ motion))
    if len(motions) < LEAST_VIEWS:
        return None
    squares = float(np.nansum(fit.residuals**2))
    share = explained / squares if squares > 0 else 0.0
    return Rolling(share, float(np.sqrt(np.mean(motions))))
