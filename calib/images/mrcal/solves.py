"""mrcal as a backend: corners in, lens and poses out, solved in a process of its own.

The solve itself is `mrcal_worker`'s; here its arrays are put together and taken apart.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera, camera_from_vector, normalise
from calib.images.bundle import finite
from calib.images.mrcal.call import call_worker

MIN_CORNERS = 8
"""A view with fewer corners is left out: six numbers of pose would use up most of it."""

MIN_VIEWS = 3
"""Views below which focal length and lens cannot be told from the poses."""

LENS_MODELS: Mapping[int, str] = {
    0: "LENSMODEL_PINHOLE",
    4: "LENSMODEL_OPENCV4",
    5: "LENSMODEL_OPENCV5",
    8: "LENSMODEL_OPENCV8",
    12: "LENSMODEL_OPENCV12",
}
"""mrcal's names of OpenCV's lens models, by the number of distortion coefficients."""

SPLINE_MARGIN = 1.15
"""Field of view of a splined model over that of the pinhole camera: barrel distortion sees more."""

SPLINE_KNOTS = 10
"""Knots of a splined model along the longer side: some 60 px apart on VGA, wider than a square."""

WIDEST_DEG = 180.0
"""Field of view of a lens that sees more than rays in front of it."""

_STEREOGRAPHIC = 2.0


@dataclass(frozen=True)
class StartingPoint:
    """Intrinsics, and where to start the poses.

    Parameters
    ----------
    intrinsics
        fx, fy, cx, cy and distortion of each camera, px and 1, shape (cameras, p).
    camera_from_first
        Rotation vector, rad, and translation, mm, from the first camera's frame to each further
        camera's, shape (cameras - 1, 6).
    poses
        First camera from board, shape (views, 6).
    """

    intrinsics: FloatArray
    camera_from_first: FloatArray
    poses: FloatArray


@dataclass(frozen=True)
class LensGrid:
    """What a lens model says of a grid of pixels, whatever its parameters.

    Parameters
    ----------
    pixels
        Shape (rows, columns, 2), px, from the first pixel of the imager to the last.
    rays
        Unit vectors in the camera's frame, shape (rows, columns, 3).
    std_px
        Standard deviation, in the worst direction, of the projection of a point on the ray that is
        as far away as the boards were, px, shape (rows, columns).
    """

    pixels: FloatArray
    rays: FloatArray
    std_px: FloatArray


@dataclass(frozen=True)
class MrcalSolution:
    """A calibration of one camera or two by mrcal.

    Parameters
    ----------
    lens_model
        mrcal's name.
    intrinsics
        fx, fy, cx, cy and the lens, px and 1, shape (cameras, p).
    camera_from_first
        Rotation vector, rad, and translation, mm, from the first camera's frame to each further
        camera's, shape (cameras - 1, 6).
    covariance
        Of the free ones of these, in this order: intrinsics of each camera, then the second
        camera's pose; px, 1, rad and mm. None for a splined lens, whose parameters mean nothing
        one by one.
    poses
        First camera from board, rad and mm, shape (views, 6); NaN for a view left out.
    residuals
        Observed minus projected, px, shape (cameras, views, corners, 2); NaN where a corner was
        missing or rejected.
    rejected
        Corners discarded as outliers, shape (cameras, views, corners).
    rms_px
        Root mean square of the residual per coordinate over inliers.
    sigma_px
        The same per degree of freedom: the standard deviation of a corner coordinate.
    board_warp_mm
        Solved deformation of the board along x and along y: how far its middle stands back, mm.
    grids
        One a camera; empty where the intrinsics were held.
    model_files
        Text of mrcal's ``.cameramodel`` of each camera; empty where the intrinsics were held.
    version
        Of mrcal, "unknown" before it tells.
    """

    lens_model: str
    intrinsics: FloatArray
    camera_from_first: FloatArray
    covariance: FloatArray | None
    poses: FloatArray
    residuals: FloatArray
    rejected: BoolArray
    rms_px: float
    sigma_px: float
    board_warp_mm: tuple[float, float] | None
    grids: tuple[LensGrid, ...]
    model_files: tuple[str, ...]
    version: str


def solve(
    cameras: Sequence[Corners],
    board: Board,
    *,
    lens_model: str,
    seed: int,
    focal_px: Sequence[float] | None = None,
    held: StartingPoint | None = None,
    start: StartingPoint | None = None,
    warp: bool = True,
    grid: tuple[int, int] = (12, 16),
) -> MrcalSolution:
    """Calibrate one camera, or two that see the same boards, with mrcal.

    Parameters
    ----------
    cameras
        Corners of each; view i of one shows the board where view i of the other does.
    lens_model
        ``LENSMODEL_...``; see `LENS_MODELS` and `splined_lens`.
    seed
        Of mrcal's random numbers: the start of the distortion.
    focal_px
        First guess for each camera, good to a factor of two; by default from the homographies.
    held
        Known intrinsics: only poses, and the deformation of the board, are solved.
    start
        Where to start in place of mrcal's own estimate.
    warp
        Whether the board may be bowed.
    grid
        Rows and columns of `MrcalSolution.grids`.

    Raises
    ------
    MrcalMissingError
        If this machine has no mrcal.
    EstimationError
        If there are too few views, or mrcal fails, crashes or hangs.
    """
    request = _Request.build(cameras, board)
    header = {
        "lens_model": lens_model,
        "hold_intrinsics": held is not None,
        "focal_px": list(focal_px or (focal_start(c, board) for c in cameras)),
        "square_mm": board.square_mm,
        "warp": warp,
        "seed": seed,
        "grid": list(grid),
    }
    arrays = request.arrays()
    begin = held or start
    if begin is not None:
        arrays["start_intrinsics"] = begin.intrinsics
        arrays["start_cameras"] = begin.camera_from_first
        arrays["start_frames"] = begin.poses[request.views]
    arrays["header"] = np.array(json.dumps(header))
    return request.solution(call_worker(arrays), lens_model)


def splined_lens(corners: Corners, *, focal_px: float) -> str:
    """Return the name of a splined lens model that covers the imager of one pinhole camera."""
    half_x, half_y = (np.arctan(side / 2 / focal_px) for side in corners.image_size)
    return splined_field(2 * float(np.degrees(half_x)), 2 * float(np.degrees(half_y)))


def splined_field(across_deg: float, down_deg: float) -> str:
    """Return the name of a splined lens model that covers a field of view."""
    # The knots lie in a stereographic projection, u = 2 tan(theta / 2).
    u_x, u_y = (
        _STEREOGRAPHIC * np.tan(SPLINE_MARGIN * np.radians(field / 2) / 2)
        for field in (across_deg, down_deg)
    )
    knots_y = max(4, round(SPLINE_KNOTS * float(u_y / u_x)))
    return (
        f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={SPLINE_KNOTS}_Ny={knots_y}"
        f"_fov_x_deg={round(SPLINE_MARGIN * across_deg)}"
    )


def field_of(camera: Camera) -> tuple[float, float]:
    """Return the field of view of a camera across and down through its centre, deg.

    `WIDEST_DEG` where it has no rays at the rim.
    """
    width, height = camera.image_size
    cx, cy = camera.matrix[:2, 2]
    rim = np.array([[0, cy], [width - 1, cy], [cx, 0], [cx, height - 1]])
    angle = np.degrees(np.arctan(np.hypot(*normalise(camera, rim, strict=False).T)))
    left, right, top, bottom = np.where(np.isfinite(angle), angle, WIDEST_DEG / 2)
    return float(2 * max(left, right)), float(2 * max(top, bottom))


def wide_focal(corners: Corners, across_deg: float) -> float:
    """Return the focal length, px, of a stereographic camera with a field of view across."""
    return float(corners.image_size[0] / (2 * _STEREOGRAPHIC * np.tan(np.radians(across_deg) / 4)))


def lens_fits(solution: MrcalSolution, cameras: Sequence[Corners]) -> tuple[LensFit, ...]:
    """Return the cameras of a solution with free OpenCV intrinsics, one by one.

    Raises
    ------
    ValueError
        If the lens is splined or was held.
    """
    count = solution.intrinsics.shape[1]
    if solution.covariance is None or not solution.grids:
        raise ValueError(f"{solution.lens_model} has no free parameters to tell")
    fits = []
    for i, corners in enumerate(cameras):
        residuals = solution.residuals[i]
        block = slice(i * count, (i + 1) * count)
        fits.append(
            LensFit(
                backend="mrcal",
                lens_model=solution.lens_model,
                camera=camera_from_vector(solution.intrinsics[i], corners.image_size),
                covariance=solution.covariance[block, block],
                rms_px=float(np.sqrt(np.nanmean(residuals**2))),
                residuals=residuals,
                poses=_in_camera(solution, i),
                rejected=int(solution.rejected[i].sum()),
                board_warp_mm=solution.board_warp_mm,
            )
        )
    return tuple(fits)


def focal_start(corners: Corners, board: Board) -> float:
    """Return a first guess of the focal length, px, from the homographies of the views.

    Views near parallel to the imager say nothing of it; a guess off any real lens is replaced by
    the width of the imager, which starts lenses of 30 to 100 degrees.
    """
    flat = board.object_points()
    seen = finite(corners.pixels)
    views = np.flatnonzero(seen.sum(axis=-1) >= MIN_CORNERS)
    width = float(corners.image_size[0])
    if not len(views):
        return width
    guess = cv2.initCameraMatrix2D(
        [flat[seen[i]].astype(np.float32) for i in views],
        [corners.pixels[i][seen[i]].astype(np.float32) for i in views],
        corners.image_size,
    )[0, 0]
    return float(guess) if width / 4 < guess < 10 * width else width


@dataclass(frozen=True)
class _Request:
    """Observations in mrcal's form, and where they come from.

    `views` are the views kept, shape (frames,); `owners` the camera and view of each observation,
    shape (observations, 2); `observations` x, y, weight, (observations, rows, columns, 3).
    """

    shape: tuple[int, int, int]
    image_sizes: tuple[tuple[int, int], ...]
    views: NDArray[np.intp]
    owners: NDArray[np.intp]
    observations: FloatArray

    @classmethod
    def build(cls, cameras: Sequence[Corners], board: Board) -> _Request:
        """Collect the boards with enough corners, by view and then by camera, as mrcal wants."""
        pixels = np.stack([corners.pixels for corners in cameras])
        seen = finite(pixels)
        view, camera = np.nonzero((seen.sum(axis=-1) >= MIN_CORNERS).T)
        if len(np.unique(view)) < MIN_VIEWS:
            raise EstimationError(
                f"mrcal: {len(np.unique(view))} views show {MIN_CORNERS} corners or more and "
                f"{MIN_VIEWS} are needed; take more board images"
            )
        weight = np.where(seen, 1.0, -1.0)[..., None]
        # mrcal's seed skips a missing corner only if its pixel is NaN.
        marked = np.concatenate([np.where(seen[..., None], pixels, np.nan), weight], axis=-1)
        observations = marked[camera, view].reshape(-1, board.rows, board.columns, 3)
        return cls(
            pixels.shape[:3],
            tuple(corners.image_size for corners in cameras),
            np.unique(view),
            np.stack([camera, view], axis=-1),
            np.ascontiguousarray(observations),
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what the worker reads; frames are numbered without gaps."""
        frame = np.searchsorted(self.views, self.owners[:, 1])
        return {
            "observations": self.observations,
            "indices": np.stack([frame, self.owners[:, 0]], axis=-1).astype(np.int32),
            "image_sizes": np.array(self.image_sizes, dtype=np.int32),
        }

    def solution(self, reply: Mapping[str, NDArray[Any]], lens_model: str) -> MrcalSolution:
        """Return the worker's answer, by the caller's cameras and views."""
        cameras, views, corners = self.shape
        camera, view = self.owners.T
        residuals = np.full((cameras, views, corners, 2), np.nan)
        residuals[camera, view] = reply["residuals"].reshape(-1, corners, 2)
        rejected = np.zeros((cameras, views, corners), dtype=np.bool_)
        rejected[camera, view] = reply["rejected"].reshape(-1, corners)
        poses = np.full((views, 6), np.nan)
        poses[self.views] = reply["frames"]
        warp = reply["warp"]
        grids = zip(
            *(reply.get(f"grid_{name}", ()) for name in ("pixels", "rays", "std")), strict=True
        )
        return MrcalSolution(
            lens_model=lens_model,
            intrinsics=reply["intrinsics"],
            camera_from_first=reply["cameras"],
            covariance=reply.get("covariance"),
            poses=poses,
            residuals=residuals,
            rejected=rejected,
            rms_px=float(np.sqrt(np.nanmean(residuals**2))),
            sigma_px=float(reply["sigma_px"]),
            board_warp_mm=(float(warp[0]), float(warp[1])) if len(warp) else None,
            grids=tuple(LensGrid(*grid) for grid in grids),
            model_files=tuple(str(text) for text in reply.get("models", ())),
            version=str(reply["version"]),
        )


def _in_camera(solution: MrcalSolution, index: int) -> FloatArray:
    """Return the board poses in the frame of one camera, shape (views, 6)."""
    if index == 0:
        return solution.poses
    turn = solution.camera_from_first[index - 1]
    poses = np.full_like(solution.poses, np.nan)
    for i in np.flatnonzero(finite(solution.poses)):
        pose = solution.poses[i]
        rotation, translation = cv2.composeRT(pose[:3], pose[3:], turn[:3], turn[3:])[:2]
        poses[i] = np.concatenate([rotation.ravel(), translation.ravel()])
    return poses


def lens_model(cameras: tuple[Camera, Camera]) -> tuple[str, int]:
    """Return mrcal's lens model that holds both cameras, and its number of coefficients.

    Raises
    ------
    EstimationError
        If mrcal has none.
    """
    if any(camera.projection != "perspective" for camera in cameras):
        raise EstimationError("mrcal has no equidistant (fisheye) lens model")
    count = max(len(camera.distortion) for camera in cameras)
    if count not in LENS_MODELS:
        raise EstimationError(f"mrcal has no lens model with OpenCV's {count} coefficients")
    return LENS_MODELS[count], count
