"""Guide of the yaw sweep: the board is put where the sweep leaves depths least uncertain.

By the problem that the chain solves (`calib.images.sweep.model`), the board's pose and the errors
of the readings eliminated. What is asked is how much of a depth hangs on what a sweep measures: the
eccentricity, C2's roll against the axis, the encoder's scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.capture.guidance.asked import AskedPose, Role, asked_for
from calib.capture.guidance.need import Need
from calib.capture.guidance.poses import in_picture, placed, repeats, seen_whole, thinned
from calib.capture.shutter import Shutter, View
from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, project
from calib.geometry.misclosure import depth_jacobian
from calib.geometry.parameters import INDEX, vector
from calib.geometry.plane import gaze_at
from calib.geometry.poses import pose_matrix, pose_vector, rotation
from calib.images.bundle import inverse, sum_blocks
from calib.images.pairs import single_view_pose
from calib.images.sweep.model import AXIS, ENCODER, SweepProblem, blocks_of
from calib.images.sweep.solve import FOOT_STD_MM, SweepReadings, root_of, solve_sweep

PLACEMENTS_MIN: Final = 2
"""One placement is checked by none."""

FILLS: Final = (0.3, 0.5)
"""Shares of the picture that the board spans: it must have room to travel."""

READINGS: Final = 12
"""Pictures of a placement."""

TRIED, TRIED_POSES = 4, 32
"""Pictures by which placements are compared, and about so many placements."""

STEP_RAD: Final = float(np.radians(0.5))
LIMIT_RAD: Final = float(np.radians(40.0))
"""Fineness to which the ends of a sweep are found, and the longest way to either side."""

SPREAD_RAD: Final = float(np.radians(18.0))
"""Middle readings lie by turns so much to either side of 90 degrees: the encoder's scale shows."""

SPAN_MIN_RAD: Final = float(np.radians(12.0))
KEPT: Final = AXIS + len(ENCODER)


class SweepGuide:
    """Chooses where to put the board up before a sweep.

    Parameters
    ----------
    board, camera, covariance
        The board; C2's lens and the covariance of its intrinsics.
    range_rad
        Of the axis.
    resolution_rad, u_alpha2_rad
        A count, and what else is uncertain of a reading.
    need
        Tolerance and depths.
    """

    unit: Final = "%"
    noun: Final = "placement"

    def __init__(
        self,
        board: Board,
        camera: Camera,
        covariance: FloatArray,
        *,
        range_rad: tuple[float, float],
        resolution_rad: float,
        u_alpha2_rad: float,
        need: Need,
    ) -> None:
        self.board = board
        self.camera = camera
        self._covariance = covariance
        self._range = range_rad
        self._resolution, self._u_alpha2 = resolution_rad, u_alpha2_rad
        self._points, self._thin = board.object_points(), thinned(board)
        self._shutter = Shutter(board)
        self._need = need
        self._asked = _depth_by(need)
        self._shown = np.zeros((0, board.corner_count, 2))
        self._poses = in_picture(camera, board, fills=FILLS)
        self._poses = self._poses[:: max(1, len(self._poses) // TRIED_POSES)]
        self._information = self._prior()
        self.count = 0
        self.u = self._u_of(self._information)

    @property
    def needed(self) -> float:
        """Standard uncertainty of depth by the axis that is to be reached, in per cent of it."""
        return 100 * self._need.depth_share

    @property
    def is_done(self) -> bool:
        """Whether the axis is known well enough."""
        return self.count >= PLACEMENTS_MIN and self.u <= self.needed

    @property
    def middle_rad(self) -> float:
        """Reading at which the board is to be held next."""
        side = (-1.0, 1.0, 0.0)[self.count % 3]
        low, high = self._range
        return float(np.clip(np.pi / 2 + side * SPREAD_RAD, low, high))

    def ask(self) -> AskedPose:
        """Return the pose to put the board up at, in C2's picture at `middle_rad`."""
        fresh = ~repeats(self._images(self._poses), self._shown, self.board)
        value = np.array([
            self._u_of(self._information + self._adds(pose)) if new else np.inf
            for pose, new in zip(self._poses, fresh, strict=True)
        ])  # fmt: skip
        best = int(np.argmin(value))
        if not np.isfinite(value[best]):
            raise EstimationError("there is no further place for the board before the sweep")
        self._shutter.start()
        self._asked_px = self._images(self._poses[best : best + 1])
        return asked_for(
            "c2", self.camera, self.board, self._poses[best], u=(self.u, float(value[best])),
            needed=self.needed, unit="% of depth by the axis",
            taken=self._shown,
        )  # fmt: skip

    def refuse(self) -> None:
        """Never ask again for the pose asked for last."""
        self._shown = np.concatenate([self._shown, self._asked_px])

    def fault(self, views: Mapping[Role, View]) -> str:
        """Return why the sweep is not to begin yet; "" if it is to."""
        found = self._shutter.fault(views["c2"], self._shown)
        if not found and np.ptp(self.readings(views["c2"].corners)) < SPAN_MIN_RAD:
            return "too near or too far to a side: it soon leaves the picture"
        return found

    def take(self, views: Mapping[Role, View]) -> None:
        """Remember where the board is; what its sweep says comes by `solve`."""
        self._shown = np.concatenate([self._shown, views["c2"].corners[None]])

    def readings(self, corners: FloatArray) -> FloatArray:
        """Return the readings of a sweep before the board as it is seen now, rad, (READINGS,)."""
        pose, _ = single_view_pose(self.camera, points=self._points, pixels=corners)
        turns = self._span(pose)
        first, last = np.clip(self.middle_rad + turns[[0, -1]], *self._range)
        return np.linspace(float(first), float(last), READINGS)

    def solve(
        self, pixels: FloatArray, readings_rad: FloatArray, placements: tuple[str, ...]
    ) -> None:
        """Take all pictures so far into account: corners, px, (n, corners, 2), and readings.

        Raises
        ------
        EstimationError
            If no axis fits them.
        """
        names = tuple(str(i) for i in range(len(pixels)))
        found = solve_sweep(
            Corners(names, pixels, ("",) * len(pixels), self.camera.image_size),
            SweepReadings(readings_rad, placements, self._resolution, self._u_alpha2),
            self.board,
            camera=self.camera,
            covariance=self._covariance,
            warp_mm=None,
            priors={},
        )
        spread = max(1.0, found.dispersion) * found.spread[:KEPT, :KEPT]
        self._information = inverse(spread)
        self.count = len(set(placements))
        self.u = self._u_of(self._information)

    def _prior(self) -> FloatArray:
        """Return what is known of axis and encoder beforehand, shape (KEPT, KEPT)."""
        std = [p.prior_std or 1.0 for p, _ in ENCODER]
        axis = [0.1, 0.1, FOOT_STD_MM, FOOT_STD_MM]
        return np.diag(np.array([*axis, *std]) ** -2.0)

    def _u_of(self, information: FloatArray) -> float:
        spread = inverse(information)
        mean = np.einsum("mi,ij,mj->m", self._asked, spread, self._asked).mean()
        return 100 * float(np.sqrt(mean))

    def _images(self, poses: FloatArray) -> FloatArray:
        points = placed(poses, self._points)
        return project(self.camera, points.reshape(-1, 3)).reshape(len(poses), -1, 2)

    def _span(self, pose: FloatArray) -> FloatArray:
        """Return turns about a pose through which the whole board stays in view, rad, sorted."""
        turns = np.arange(-LIMIT_RAD, LIMIT_RAD + STEP_RAD / 2, STEP_RAD)
        seen = seen_whole(self.camera, self.board, _turned(pose, turns))
        middle = len(turns) // 2
        if not seen[middle]:
            return np.zeros(2)
        first = middle - int(np.argmin(np.r_[seen[middle::-1], False])) + 1
        last = middle + int(np.argmin(np.r_[seen[middle:], False])) - 1
        return turns[first : last + 1]

    def _adds(self, pose: FloatArray) -> FloatArray:
        """Return what a sweep before a board says of axis and encoder, shape (KEPT, KEPT)."""
        span = self._span(pose)
        readings = self.middle_rad + np.linspace(span[0], span[-1], TRIED)
        at_90 = _turned(pose, np.array([np.pi / 2 - self.middle_rad]))[0]
        seen: BoolArray = np.ones((TRIED, len(self._thin), 2), dtype=np.bool_)
        problem = SweepProblem(
            points=self._points[self._thin],
            pixels=np.where(seen, 0.0, np.nan),
            readings_rad=readings,
            placement=np.zeros(TRIED, dtype=np.int64),
            camera=self.camera,
            intrinsics_root=root_of(self._covariance),
            turn_std_rad=float(np.hypot(self._resolution / np.sqrt(12), self._u_alpha2)),
            sigma_px=0.1 * float(np.sqrt(len(self._thin) / len(self._points) * TRIED / READINGS)),
            foot_std_mm=FOOT_STD_MM,
            encoder_prior=tuple((0.0, p.prior_std or 1.0) for p, _ in ENCODER),
        )
        x = np.zeros(problem.size)
        x[problem.at_pose(0)] = at_90
        normal = sum_blocks(blocks_of(problem, x), problem.size).matrix
        other = normal[KEPT:, KEPT:]
        mixed = normal[:KEPT, KEPT:]
        alone: FloatArray = normal[:KEPT, :KEPT] - mixed @ np.linalg.solve(other, mixed.T)
        return alone - self._prior_of(problem)

    def _prior_of(self, problem: SweepProblem) -> FloatArray:
        """Return the priors that a problem holds of what is kept: they count once."""
        std = np.array([std for _, std in problem.encoder_prior])
        foot = 1 / problem.foot_std_mm
        return np.diag(np.array([0.0, 0.0, foot, foot, *(1 / std)]) ** 2)


def _turned(pose: FloatArray, turns: FloatArray) -> FloatArray:
    """Return a board's poses, shape (n, 6), as C2 turns by angles about its own centre, rad."""
    matrix = pose_matrix(pose)
    back = np.tile(np.eye(4), (len(turns), 1, 1))
    back[:, :3, :3] = np.array([rotation(np.array([0.0, -turn, 0.0])) for turn in turns])
    return np.array([pose_vector(m) for m in back @ matrix])


def _depth_by(need: Need) -> FloatArray:
    """Return derivatives of depths, in parts of them, by axis and encoder, shape (m, KEPT).

    The eccentricity is -f_x, the roll d_x (`calib.images.sweep.yaw_axis`), C1 and axis level.
    """
    theta = vector({"baseline_mm": need.baseline_mm})
    near, far = need.depths_mm
    x, y, z = np.meshgrid([-0.2, 0.0, 0.2], [-0.15, 0.15], [near, 2 / (1 / near + 1 / far), far])
    points = np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3)
    slopes = depth_jacobian(theta, gaze_at(theta, points))
    relative = slopes.by_theta / slopes.z[:, None]
    asked = np.zeros((len(points), KEPT))
    asked[:, 0] = relative[:, INDEX["gaze_roll_rad"]]
    asked[:, 2] = -relative[:, INDEX["eccentricity_mm"]]
    for i, (parameter, _) in enumerate(ENCODER):
        if parameter.name == "encoder_scale":
            asked[:, AXIS + i] = relative[:, INDEX[parameter.name]]
    return asked
