"""Intrinsics of one camera by this program's own least squares, poses of the views eliminated.

For lens models that mrcal lacks. Unknowns are the intrinsics, the board deformation along x and y
where it is free, and the pose of each view; derivatives are analytic, steps those of Levenberg and
Marquardt (`calib.images.joint.reduced`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Corners, LensFit
from calib.geometry.camera import Camera, intrinsic_vector, project_points, with_intrinsics
from calib.geometry.poses import rotation, transform, transformed_by_pose
from calib.images.bundle import deformed, warp_shapes
from calib.images.detection.grid import seen
from calib.images.intrinsics.covariance import view_scores
from calib.images.intrinsics.inliers import without_outliers
from calib.images.joint.reduced import Unknowns, ViewNormals, minimise_views
from calib.images.mrcal.solves import MIN_CORNERS, MIN_VIEWS
from calib.images.pairs import single_view_pose
from calib.images.wide_view import first_pose

POSE = 6

HALF_FIELDS_DEG = (35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 95.0)
"""Angles off the axis at which the corner of the imager is tried to look: one of them is near
enough to any lens to start from."""

START_VIEWS = 12
"""Views by which these are judged: a pose of one board tells a factor of two in f."""

_DONE_PX2 = 1e-11
_ROUNDS = 12


@dataclass(frozen=True)
class Views:
    """A least-squares problem of one lens.

    Parameters
    ----------
    camera
        To start from.
    points
        Corners in the board's frame, mm, shape (corners, 3).
    pixels
        Corners found, px, shape (views, corners, 2).
    used
        Which of them count, shape (views, corners).
    warp
        Whether the board deformation is an unknown.
    """

    camera: Camera
    points: FloatArray
    pixels: FloatArray
    used: BoolArray
    warp: bool

    @property
    def lens(self) -> int:
        """Number of intrinsics."""
        return 4 + len(self.camera.distortion)

    def camera_at(self, at: Unknowns) -> Camera:
        """Return the camera of the unknowns."""
        return with_intrinsics(self.camera, at.shared[: self.lens])

    def warp_at(self, at: Unknowns) -> tuple[float, float] | None:
        """Return the warp of the unknowns, mm; None where it is no unknown."""
        if not self.warp:
            return None
        x, y = (float(v) for v in at.shared[self.lens :])
        return x, y

    def residuals_at(self, at: Unknowns) -> FloatArray:
        """Return observed minus projected, px, shape (views, corners, 2); NaN where not used."""
        camera, points = self.camera_at(at), deformed(self.points, self.warp_at(at))
        residuals = np.full_like(self.pixels, np.nan)
        for i in np.flatnonzero(self.used.any(axis=-1)):
            seen_there = project_points(camera, transform(at.own[i], points)).pixels
            residuals[i] = np.where(self.used[i, :, None], self.pixels[i] - seen_there, np.nan)
        return residuals

    def normals_at(self, at: Unknowns) -> ViewNormals:
        """Return the normal equations of the views."""
        camera, points = self.camera_at(at), deformed(self.points, self.warp_at(at))
        count, size = len(self.pixels), len(at.shared)
        sums = ViewNormals(
            np.zeros((count, size, size)),
            np.zeros((count, size, POSE)),
            np.zeros((count, POSE, POSE)),
            np.zeros((count, size)),
            np.zeros((count, POSE)),
            0.0,
        )
        shapes, cost = warp_shapes(self.points), 0.0
        for i in np.flatnonzero(self.used.any(axis=-1)):
            own = self.used[i]
            view = project_points(camera, transform(at.own[i], points[own]))
            a = view.by_intrinsics
            if self.warp:
                lift = view.by_point @ rotation(at.own[i, :3])[:, 2]
                a = np.concatenate([a, lift[..., None] * shapes[own, None, :]], axis=-1)
            a = a.reshape(-1, size)
            b = (view.by_point @ transformed_by_pose(at.own[i], points[own])).reshape(-1, POSE)
            r = (view.pixels - self.pixels[i, own]).ravel()
            sums.shared[i], sums.mixed[i], sums.own[i] = a.T @ a, a.T @ b, b.T @ b
            sums.shared_gradient[i], sums.own_gradient[i] = a.T @ r, b.T @ r
            cost += float(r @ r)
        return sums._replace(cost=cost)


def fit_views(
    corners: Corners, points: FloatArray, *, start: Camera, lens: str, warp: bool
) -> LensFit:
    """Return intrinsics of the lens model of `start`, outliers rejected.

    Parameters
    ----------
    points
        Corners in the board's frame, mm, shape (corners, 3).
    lens
        Name of the lens model.
    warp
        Whether the board deformation is an unknown.

    Raises
    ------
    EstimationError
        If there are too few views, no minimum is reached, or the views leave a parameter open.
    """
    used = seen(corners.pixels)
    used[used.sum(axis=-1) < MIN_CORNERS] = False
    camera = start
    for _ in range(_ROUNDS):
        problem = Views(camera, points, corners.pixels, used, warp)
        at = solve(problem)
        residuals = problem.residuals_at(at)
        camera, kept = problem.camera_at(at), without_outliers(residuals, used)
        if np.array_equal(kept, used):
            break
        used = kept
    residuals[~used] = np.nan
    solved_mm = problem.warp_at(at)
    shaped = deformed(points, solved_mm)
    scores = view_scores(camera, at.own, residuals, shaped, warp=warp)
    found = seen(corners.pixels)
    rejected = found & ~used
    rejected[found.sum(axis=-1) < MIN_CORNERS] = False
    return LensFit(
        backend="joint",
        lens_model=lens,
        camera=camera,
        covariance=scores.covariance(),
        rms_px=float(np.sqrt(np.nanmean(residuals**2))),
        residuals=residuals,
        poses=at.own,
        rejected=int(rejected.sum()),
        board_warp_mm=solved_mm,
    )


def solve(problem: Views) -> Unknowns:
    """Return the unknowns at the minimum; poses of views that are not used are NaN.

    Raises
    ------
    EstimationError
        If there are too few views, or no minimum is reached.
    """
    views = np.flatnonzero(problem.used.any(axis=-1))
    if len(views) < MIN_VIEWS:
        raise EstimationError(
            f"{len(views)} usable views and {MIN_VIEWS} are needed; take more board images"
        )
    poses = np.zeros((len(problem.pixels), POSE))
    for i in views:
        pixels = np.where(problem.used[i, :, None], problem.pixels[i], np.nan)
        poses[i] = single_view_pose(problem.camera, points=problem.points, pixels=pixels)[0]
    warp = np.zeros(2 if problem.warp else 0)
    start = Unknowns(np.concatenate([intrinsic_vector(problem.camera), warp]), poses)
    at = minimise_views(problem.normals_at, start, done=_DONE_PX2).at
    own = at.own.copy()
    own[~problem.used.any(axis=-1)] = np.nan
    return Unknowns(at.shared, own)


def equidistant_start(corners: Corners, points: FloatArray) -> Camera:
    """Return an equidistant camera to start from: the focal length by which boards are boards.

    Of lenses without coefficients, from 35 to 95 degrees at the imager's corner, the one that fits
    single views best in the median.

    Raises
    ------
    EstimationError
        If none has rays for the boards.
    """
    enough = np.flatnonzero(seen(corners.pixels).sum(axis=-1) >= MIN_CORNERS)
    chosen = enough[np.linspace(0, len(enough) - 1, min(START_VIEWS, len(enough))).astype(int)]
    size = np.array(corners.image_size)
    middle, diagonal = (size - 1) / 2, float(np.hypot(*size)) / 2
    best, least = None, np.inf
    for half in np.deg2rad(HALF_FIELDS_DEG):
        matrix = np.diag([diagonal / half, diagonal / half, 1.0])
        matrix[:2, 2] = middle
        camera = Camera(matrix, np.zeros(4), corners.image_size, "equidistant")
        missed = [_missed(camera, points, corners.pixels[i]) for i in chosen]
        if (rms := float(np.median(missed))) < least:
            best, least = camera, rms
    if best is None:
        raise EstimationError("no equidistant lens sees boards in these pictures")
    return best


def _missed(camera: Camera, points: FloatArray, pixels: FloatArray) -> float:
    """Return the rms of a view, px, at the first pose that comes to hand."""
    found = seen(pixels)
    points, pixels = points[found], pixels[found]
    try:
        pose = first_pose(camera, points=points, pixels=pixels)
    except EstimationError:
        return np.inf
    off = project_points(camera, transform(pose, points)).pixels - pixels
    return float(np.sqrt(np.mean(off**2)))
