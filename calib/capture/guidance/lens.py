"""Guide of a lens' pictures: the next one is that which leaves its projection least uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from calib.capture.guidance.asked import AskedPose, Role, asked_for
from calib.capture.guidance.poses import in_picture, placed, repeats, seen_whole, thinned
from calib.capture.guidance.solving import (
    NormalPrior,
    PictureKnowledge,
    added_by,
    left_by,
    nothing_known,
    solve,
)
from calib.capture.shutter import WORTH, Shutter, View
from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board
from calib.geometry.camera import Camera, project
from calib.images.intrinsics.calibrate import MIN_VIEWS
from calib.images.intrinsics.gates import COVERAGE_MIN
from calib.images.intrinsics.maps import GRID, Nodes, by_intrinsics, measure_coverage
from calib.images.joint.model import POSE, WARP, BoardImages, JointProblem
from calib.images.pairs import single_view_pose

FIRST_FOCAL: Final = 1.0
"""Focal length over the picture's width to begin with: 53 degrees across."""

FOCAL_STD, CENTRE_STD = 0.3, 0.1
"""Priors: of the focal length in parts, of the principal point in parts of the width."""

LENS_STD: Final = (0.5, 0.5, 0.02, 0.02, 0.5)
"""Of k1, k2, p1, p2, k3. Lenses of up to 100 degrees that are no fisheyes stay within."""

WARP_STD_MM: Final = 1.0
"""Of the board's warp each way."""

ALONE_VIEWS, HELD = 3, 0.1
"""Fewer views leave a valley of lenses; the one to begin with is sought with priors so much
narrower, which are not believed afterwards."""

COEFFICIENTS: Final = len(LENS_STD)


class LensGuide:
    """Chooses the next pose for a camera's own pictures.

    Parameters
    ----------
    role
        Which camera.
    board
        The board.
    image_size
        Of its pictures, px.
    needed_rad
        Standard uncertainty of a ray that is to be reached over the imager, rad.

    Attributes
    ----------
    u
        Standard uncertainty of the projection, px: the root mean square over the imager of the
        length of the error, the camera's rotation taken off, enlarged by what the views contradict
        each other.
    known
        What the pictures say.
    """

    unit: Final = "px"
    noun: Final = "picture"

    def __init__(
        self, role: Role, board: Board, image_size: tuple[int, int], *, needed_rad: float
    ) -> None:
        self.role = role
        self.board = board
        self._size = image_size
        self._needed_rad = needed_rad
        self._points = board.object_points()
        self._thin = thinned(board)
        self._pixels = np.zeros((0, board.corner_count, 2))
        self._refused = self._pixels
        self._shutter = Shutter(board)
        self._prior = _prior(image_size)
        lens = np.zeros(COEFFICIENTS)
        start = Camera(_matrix(self._prior.mean), lens, image_size)
        empty = _problem(start, self._points, self._pixels)
        self._take(nothing_known(empty, self._prior))

    @property
    def camera(self) -> Camera:
        """The camera as far as it is known."""
        return self.known.problem.camera_at(self.known.at.shared, 0)

    @property
    def views(self) -> FloatArray:
        """Corners of the pictures so far, px, shape (v, corners, 2)."""
        return self._pixels

    @property
    def needed(self) -> float:
        """Standard uncertainty of the projection that is to be reached, px."""
        return self._needed_rad * float(self.camera.matrix[0, 0])

    @property
    def coverage(self) -> float:
        """Share of the imager's cells that hold corners."""
        return measure_coverage(self._pixels, self._size).share

    @property
    def is_done(self) -> bool:
        """Whether the lens is known well enough, and the chain will take it."""
        return (
            len(self._pixels) >= MIN_VIEWS
            and self.coverage >= COVERAGE_MIN
            and self.u <= self.needed
        )

    @property
    def count(self) -> int:
        """Pictures so far."""
        return len(self._pixels)

    def take(self, views: Mapping[Role, View]) -> None:
        """Take a picture into account; errors as of `add`."""
        self.add(views[self.role].corners)

    def add(self, *views: FloatArray) -> None:
        """Take pictures into account, their corners px, shape (corners, 2) each.

        Raises
        ------
        EstimationError
            If they contradict the others so much that there is no solution; they are left out.
        """
        if not views:
            return
        pixels = np.concatenate([self._pixels, np.array(views)])
        self._take(self._solved(pixels))
        self._pixels = pixels

    def solve_again(self) -> None:
        """Solve the pictures so far anew, from where the solution is."""
        self._take(self._solved(self._pixels))

    def _take(self, known: PictureKnowledge) -> None:
        """Take what is known now as the ground of what follows."""
        self.known = known
        self._factor = known.factor(known.problem.at_lens(0))
        self._asked = self._asked_of()
        nothing = np.zeros((1, *known.information.shape))
        self.u = float(np.sqrt(self._variance(nothing)[0]))

    def ask(self) -> AskedPose:
        """Return the pose to hold the board at next."""
        poses = self._candidates()
        shown = self._shown(poses)
        variance = self._variance(self._added(poses, shown, self._thin))
        done = np.concatenate([self._pixels, self._refused])
        fresh = ~repeats(shown, done, self.board)
        best = int(np.argmin(np.where(fresh | ~fresh.any(), variance, np.inf)))
        self._gain = self.u**2 - float(variance[best])
        self._shutter.start()
        self._asked_px = shown[best]
        return asked_for(
            self.role, self.camera, self.board, poses[best],
            u=(self.u, float(np.sqrt(variance[best]))), needed=self.needed, unit=self.unit,
            taken=self._pixels,
        )  # fmt: skip

    def refuse(self) -> None:
        """Never ask again for the pose asked for last."""
        self._refused = np.concatenate([self._refused, self._asked_px[None]])

    def fault(self, views: Mapping[Role, View]) -> str:
        """Return why a picture is not to be taken yet; "" if it is to be."""
        view = views[self.role]
        found = self._shutter.fault(view, self._pixels)
        if not found and self.worth(view.corners) < WORTH:
            return "it brings too little: fill the outline"
        return found

    def worth(self, pixels: FloatArray) -> float:
        """Return what a picture brings, over what the pose asked for would, corners (corners, 2).

        In variance of the projection; over 1 where it is the better one.
        """
        pose, _ = single_view_pose(self.camera, points=self._points, pixels=pixels)
        after = self._variance(self._added(pose[None], pixels[None], self._thin))[0]
        return float((self.u**2 - after) / self._gain) if self._gain > 0 else 1.0

    def _candidates(self) -> FloatArray:
        poses = in_picture(self.camera, self.board)
        if len(poses):
            return poses
        # A lens that is hardly known may be far off: one without distortion then serves.
        plain = replace(self.camera, matrix=_matrix(self._prior.mean), distortion=np.zeros(0))
        poses = in_picture(plain, self.board)
        return poses[:1] if not seen_whole(self.camera, self.board, poses).any() else poses

    def _added(self, poses: FloatArray, pixels: FloatArray, chosen: IntArray) -> FloatArray:
        """Return what views would add, by some of the corners for all of them."""
        few = _problem(self.camera, self._points[chosen], pixels[:, chosen])
        return added_by(self.known, few, poses) * (len(self._points) / len(chosen))

    def _shown(self, poses: FloatArray) -> FloatArray:
        """Return where the corners of boards are in the picture, px, shape (n, corners, 2)."""
        points = placed(poses, self._points)
        return project(self.camera, points.reshape(-1, 3)).reshape(len(poses), -1, 2)

    def _variance(self, added: FloatArray) -> FloatArray:
        """Return the variance of the projection, px^2, with more information, (v, n, n): (v,)."""
        result: FloatArray = left_by(self.known, added, self._asked) * self._factor
        return result

    def _asked_of(self) -> FloatArray:
        """Return derivatives of projections all over the imager, both directions as one."""
        width, height = self._size
        grid = np.meshgrid(np.linspace(0, width - 1, GRID[1]), np.linspace(0, height - 1, GRID[0]))
        at = Nodes(np.stack(grid, axis=-1), np.ones(GRID, dtype=np.bool_))
        _, slopes = by_intrinsics(self.camera, at)
        flat = slopes.reshape(-1, slopes.shape[-1])
        asked = np.zeros((len(flat), self.known.problem.size))
        asked[:, self.known.problem.at_lens(0)] = np.sqrt(2.0) * flat
        return asked

    def _solved(self, pixels: FloatArray) -> PictureKnowledge:
        """Return the solution, from where the last one is, or else from the start."""
        known = self.known
        try:
            return self._from(self.camera, known.at.own, pixels)
        except (EstimationError, np.linalg.LinAlgError):
            start = Camera(_matrix(self._prior.mean), np.zeros(COEFFICIENTS), self._size)
            return self._from(start, np.zeros((0, POSE)), pixels)

    def _from(self, camera: Camera, own: FloatArray, pixels: FloatArray) -> PictureKnowledge:
        problem = _problem(camera, self._points, pixels)
        new = [
            single_view_pose(camera, points=self._points, pixels=view)[0]
            for view in pixels[len(own) :]
        ]
        start = problem.start(np.zeros(POSE), np.concatenate([own, np.array(new).reshape(-1, 6)]))
        if len(pixels) >= ALONE_VIEWS:
            return solve(problem, start, self._prior)
        held = NormalPrior(self._prior.mean, self._prior.precision / HELD**2)
        return replace(solve(problem, start, held), prior=self._prior)


def _matrix(mean: FloatArray) -> FloatArray:
    fx, fy, cx, cy = mean[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _prior(image_size: tuple[int, int]) -> NormalPrior:
    width, height = image_size
    focal = FIRST_FOCAL * width
    mean = [focal, focal, (width - 1) / 2, (height - 1) / 2, *np.zeros(COEFFICIENTS)]
    std = [FOCAL_STD * focal, FOCAL_STD * focal, CENTRE_STD * width, CENTRE_STD * width, *LENS_STD]
    # The pose of C2 is none of a single camera's: it is held.
    return NormalPrior(
        np.array([*mean, *np.zeros(POSE + WARP)]),
        np.diag(np.array([*std, *np.ones(POSE), *np.full(WARP, WARP_STD_MM)]) ** -2.0),
    )


def _problem(camera: Camera, points: FloatArray, pixels: FloatArray) -> JointProblem:
    count = len(pixels)
    images = BoardImages(
        names=("",) * count,
        kinds=("lens",) * count,
        camera=np.zeros(count, dtype=np.int64),
        view=np.arange(count),
        in_pair=np.zeros(count, dtype=np.bool_),
        pixels=pixels,
    )
    return JointProblem(images, points, (camera, camera), (True, False))
